"""MJCF files, through MuJoCo's own compiler: geometry, limits, loops and which joints are driven.

Masses, shapes and meshes are left aside; a model reads without the files of its meshes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gtau.errors import GtauError
from gtau.robots.floating import base_joints
from gtau.robots.geometry import compose, pose_of, rounded, turn
from gtau.robots.parts import hold_joints, listed
from gtau.robots.readers.idle_joints import without_idle_pins
from gtau.robots.readers.inertias import mjcf_masses
from gtau.robots.readers.mjcf_angles import angle_notes
from gtau.robots.readers.mjcf_file import MjcfFile, compile_mjcf
from gtau.robots.readers.mjcf_idle import moving_base, scenery, with_linkages
from gtau.robots.readers.mjcf_ties import (
    actuated_joints,
    equalities,
    fixed_tendons,
    name_in,
    pose_in,
    site_springs,
    tendon_coupling,
    tendon_motors,
)
from gtau.robots.readers.source import BASE_ADVICE, FLOATING, Base, BaseChoice
from gtau.robots.readers.urdf import turning
from gtau.robots.readers.xml_document import read_xml
from gtau.robots.robot import (
    GROUND,
    ROTATIONS,
    TRANSLATIONS,
    Attachment,
    Joint,
    Limits,
    Platform,
    Pose,
    Robot,
    base_rows,
)

if TYPE_CHECKING:
    import mujoco

HOME = "home"
"""Name of the keyframe that gives home; without one, MuJoCo's reference configuration does."""


def read_mjcf(path: str | Path, base: BaseChoice = None) -> Robot:
    """Read a robot from an MJCF file.

    Hinges and slides are joints; a ball becomes three revolute ones, about x, y and z, with massless links in between,
    and a free body that closures hold a platform. Bodies without joints become part of those that carry them.
    The equalities ``connect``, ``weld`` and ``joint`` (linear) become closures and couplings; a joint with an actuator
    is actuated, and where there are no actuators, every joint that is not coupled. Joints that a fixed tendon pulls
    are held. A joint with a stiffness has a spring; so do the bodies of two sites with a tendon straight between them.

    Parameters
    ----------
    path : str or Path
    base : Base, optional
        Fixes free bodies that carry joints: as in the file, or, if its ``rpy`` is given, with the axes of the world;
        ``"floating"`` makes the one there is a floating base.

    Returns
    -------
    Robot
        Joint coordinates are MuJoCo's ``qpos``. Notes say what was left out or acts in the simulator alone.

    Raises
    ------
    GtauError
        MuJoCo is not installed or refuses the file, or it holds what a robot of gtau cannot be.
    """
    path = Path(path)
    try:
        if (root := read_xml(path)).tag != "mujoco":
            raise GtauError(f"the outermost element is <{root.tag}>, not <mujoco>; give an MJCF file.")
        file = compile_mjcf(root, path)
        robot = replace(_robot(file, path, base), name=root.get("model") or path.stem)
        return without_idle_pins(robot)
    except GtauError as error:
        raise GtauError(f"{path}: {error}") from None


def _robot(file: MjcfFile, path: Path, base: BaseChoice) -> Robot:
    import mujoco

    model, notes = file.model, list(file.notes)
    qpos, home_given = model.qpos0, False
    if HOME in file.keys:
        if home_given := file.keys[HOME].size == model.nq:
            qpos = file.keys[HOME]
        else:
            notes.append(f"keyframe '{HOME}' has {file.keys[HOME].size} positions for {model.nq} and was left out")
    carriers = _carriers(model)
    carried: dict[int, Attachment] = {0: Attachment(GROUND)}
    floating = ""  # the body that is a floating base
    joints: list[Joint] = []
    platforms: list[Platform] = []
    for body in range(1, model.nbody):
        before = carried[int(model.body_parentid[body])]
        placement = compose(before.placement, pose_in(model.body_pos[body], model.body_quat[body]))
        at = Attachment(before.body, placement)
        own = range(int(model.body_jntadr[body]), int(model.body_jntadr[body]) + int(model.body_jntnum[body]))
        for number in own:
            last = number == own[-1]
            if mujoco.mjtJoint(int(model.jnt_type[number])) == mujoco.mjtJoint.mjJNT_FREE:
                name, start = name_in(model, "body", body), int(model.jnt_qposadr[number])
                pose = pose_in(qpos[start : start + 3], qpos[start + 3 : start + 7])
                if body not in carriers:
                    at = Attachment(name)
                    platforms.append(Platform(name, TRANSLATIONS + ROTATIONS, pose))
                    continue
                if base is None:
                    raise GtauError(f"body '{name}' floats and carries joints; {BASE_ADVICE}.")
                if base == FLOATING:
                    if floating:
                        raise GtauError(f"the bodies '{floating}' and '{name}' float; give the file of one robot.")
                    floating = name
                    joints += base_joints(name)
                    at = Attachment(name)
                    continue
                at = Attachment(before.body, pose if base.rpy is None else Pose())
                notes.append(f"body '{name}' floats in the file and was fixed")
            else:
                made, at = _joints(model, number, at, qpos, last)
                joints += made
        carried[body] = at
    closures, couplings, held = equalities(model, carried)
    tendons = fixed_tendons(file)
    for each in file.tied_tendons:
        coupling = tendon_coupling(model, tendons, each)
        if coupling.ratios:
            couplings.append(coupling)
        else:
            held[coupling.joint] = coupling.offset
    springs = site_springs(file, carried)
    tied = {end.body for closure in closures for end in (closure.a, closure.b)}
    if loose := [platform.name for platform in platforms if platform.name not in tied]:
        notes.append(f"free {'bodies' if len(loose) > 1 else 'body'} {listed(loose)} attached to nothing: left out")
    driven, pulled = actuated_joints(file, tendons, notes)
    if pulled and not driven:  # a gripper alone
        for motor, coupling in tendon_motors(file, tendons, {joint.name: joint.kind for joint in joints}):
            joints.append(motor)
            couplings.append(coupling)
            driven.add(motor.name)
            notes.append(
                f"'{motor.name}' is the motor that pulls {listed([name for name, _ in coupling.ratios])} by a fixed "
                "tendon; its position is the tendon's length"
            )
        pulled = set()
    slaves = {coupling.joint for coupling in couplings}
    actuated = driven.union(base_rows(floating)) if file.actuators else {joint.name for joint in joints} - slaves
    if closures and not file.actuators:
        raise GtauError("it has loops and no actuators, so it is not known which joints have motors; add actuators.")
    weightless = bool(model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    if weightless:
        notes.append("gravity is switched off in the file, and here; where it acts, write it in a saved robot file")
    notes += (*_simulated_alone(model), *mjcf_masses(file.elements), *angle_notes(file.elements))
    joints.sort(key=lambda joint: joint.name not in base_rows(floating))  # those of the base stand first
    if not joints:
        raise GtauError("it has no joints except those of free bodies; give the file of a robot.")
    if not actuated.intersection(joint.name for joint in joints).difference(base_rows(floating)):
        raise GtauError("no actuator drives a joint (joint=...), so none is known to be actuated; add actuators.")
    robot = Robot(
        path.stem,
        tuple(replace(joint, actuated=joint.name in actuated) for joint in joints),
        tuple(platform for platform in platforms if platform.name in tied),
        tuple(closures),
        tuple(couplings),
        (0.0, 0.0, 0.0) if weightless else tuple(float(rounded(g)) for g in model.opt.gravity),  # type: ignore[arg-type]
        path.name,
        tuple(notes),
        floating=floating,
        home_given=home_given,
        springs=tuple(each for each in springs if {each.a.body, each.b.body}.isdisjoint(loose)),
    )
    for names, why in (
        (held.keys(), "by an equality with a constant"),
        (with_linkages(robot, pulled - driven), "since a tendon pulls them, which is not modelled"),
        (scenery(robot), "since they carry no motor and nothing ties them to one that does"),
        (moving_base(robot) if isinstance(base, Base) else set(), "with the base"),
    ):
        if here := {joint.name: held.get(joint.name, joint.home) for joint in robot.joints if joint.name in names}:
            robot = hold_joints(robot, here, why)
    return robot


def _carriers(model: mujoco.MjModel) -> set[int]:
    """Find the bodies that carry joints, their own not counted."""
    found = set()
    for body in range(1, model.nbody):
        if model.body_jntnum[body]:
            while body := int(model.body_parentid[body]):
                found.add(body)
    return found


def _simulated_alone(model: mujoco.MjModel) -> Iterator[str]:
    """Note what acts in the simulator and is not modelled."""
    if model.opt.density or model.opt.viscosity:
        yield "drag of the fluid around the robot (density, viscosity) acts in the simulator and is not modelled"
    if floating := [name_in(model, "body", k) for k in range(1, model.nbody) if model.body_gravcomp[k]]:
        yield f"gravity compensation (gravcomp) acts in the simulator and is not modelled: body {listed(floating)}"
    balls = [k for k in range(model.njnt) if model.jnt_type[k] == 1 and np.any(model.jnt_stiffness[k])]
    if balls:
        names = listed([name_in(model, "joint", k) for k in balls])
        yield f"springs of balls act in the simulator and are not modelled: joint {names}"


def _joints(
    model: mujoco.MjModel, number: int, at: Attachment, qpos: np.ndarray, last: bool
) -> tuple[list[Joint], Attachment]:
    """Make the joint of a body whose frame, not yet moved by it, is at `at`; and where the frame is after it."""
    import mujoco

    name, start = name_in(model, "joint", number), int(model.jnt_qposadr[number])
    kind, axis = mujoco.mjtJoint(int(model.jnt_type[number])), model.jnt_axis[number]
    if kind == mujoco.mjtJoint.mjJNT_SLIDE:
        anchor, reference = np.zeros(3), pose_of(np.eye(3), -axis * model.qpos0[start])
    elif kind == mujoco.mjtJoint.mjJNT_HINGE:
        anchor, reference = model.jnt_pos[number], pose_of(turn(axis, -model.qpos0[start]), np.zeros(3))
    else:
        anchor, reference = model.jnt_pos[number], Pose()
    placement = compose(compose(at.placement, pose_of(np.eye(3), anchor)), reference)
    after = Attachment(name, pose_of(np.eye(3), -anchor))
    if kind == mujoco.mjtJoint.mjJNT_BALL:
        from scipy.spatial.transform import Rotation

        angles = Rotation.from_quat(qpos[start : start + 4], scalar_first=True).as_euler("XYZ")
        chain = turning(name, at.body, placement, "xyz")
        chain = [replace(joint, home=float(angle)) for joint, angle in zip(chain, angles, strict=True)]
        return [*chain[:-1], chain[-1] if last else replace(chain[-1], parameters="none")], after
    low, high = model.jnt_range[number]
    stop = bool(model.jnt_limited[number]) and low < high
    joint = Joint(
        name,
        at.body,
        "prismatic" if kind == mujoco.mjtJoint.mjJNT_SLIDE else "revolute",
        placement,
        tuple(rounded(component) for component in axis),  # type: ignore[arg-type]
        home=rounded(qpos[start]),
        limits=Limits((float(low), float(high)) if stop else None),
        # the joints of one body have no links between them
        parameters="all" if last else "drive",
        spring=rounded(model.qpos_spring[start]) if np.any(model.jnt_stiffness[number]) else None,
    )
    return [joint], after
