"""MJCF files, through MuJoCo's own compiler: geometry, limits, loops and which joints are driven.

Masses, shapes and meshes are left aside; a model reads without the files of its meshes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gtau.errors import GtauError
from gtau.robots.geometry import compose, pose_of, rounded, turn
from gtau.robots.parts import NAMED, hold_joints
from gtau.robots.readers.idle_joints import without_idle_pins
from gtau.robots.readers.mjcf_file import MjcfFile, compile_mjcf
from gtau.robots.readers.source import Base
from gtau.robots.readers.urdf import turning
from gtau.robots.readers.xml_document import read_xml
from gtau.robots.robot import (
    GROUND,
    ROTATIONS,
    TRANSLATIONS,
    Attachment,
    Closure,
    Coupling,
    Joint,
    Limits,
    Platform,
    Pose,
    Robot,
)

if TYPE_CHECKING:
    import mujoco

HOME = "home"
"""Name of the keyframe that gives home; without one, MuJoCo's reference configuration does."""
FLOAT = "robot: {file: ..., base: fixed}"


def read_mjcf(path: str | Path, base: Base | None = None) -> Robot:
    """Read a robot from an MJCF file.

    Hinges and slides are joints; a ball becomes three revolute ones, about x, y and z, with massless links in between,
    and a free body that closures hold a platform. Bodies without joints become part of those that carry them.
    The equalities ``connect``, ``weld`` and ``joint`` (linear) become closures and couplings; a joint with an actuator
    is actuated, and where there are no actuators, every joint that is not coupled. Joints that a fixed tendon pulls
    are held. A joint with a stiffness has a spring.

    Parameters
    ----------
    path : str or Path
    base : Base, optional
        Fixes free bodies that carry joints: as in the file, or, if its ``rpy`` is given, with the axes of the world.

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


def _robot(file: MjcfFile, path: Path, base: Base | None) -> Robot:
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
    joints: list[Joint] = []
    platforms: list[Platform] = []
    for body in range(1, model.nbody):
        before = carried[int(model.body_parentid[body])]
        placement = compose(before.placement, _pose(model.body_pos[body], model.body_quat[body]))
        at = Attachment(before.body, placement)
        own = range(int(model.body_jntadr[body]), int(model.body_jntadr[body]) + int(model.body_jntnum[body]))
        for number in own:
            last = number == own[-1]
            if mujoco.mjtJoint(int(model.jnt_type[number])) == mujoco.mjtJoint.mjJNT_FREE:
                name, start = _name(model, "body", body), int(model.jnt_qposadr[number])
                pose = _pose(qpos[start : start + 3], qpos[start + 3 : start + 7])
                if body not in carriers:
                    at = Attachment(name)
                    platforms.append(Platform(name, TRANSLATIONS + ROTATIONS, pose))
                    continue
                if base is None:
                    raise GtauError(
                        f"body '{name}' floats and carries joints, and a floating base is not identified; if the robot "
                        f"is hung up or bolted down, fix it: write '{FLOAT}' in the experiment file, or --base fixed."
                    )
                at = Attachment(before.body, pose if base.rpy is None else Pose())
                notes.append(f"body '{name}' floats in the file and was fixed")
            else:
                made, at = _joints(model, number, at, qpos, last)
                joints += made
        carried[body] = at
    closures, couplings, held = _equalities(model, carried)
    tied = {end.body for closure in closures for end in (closure.a, closure.b)}
    if loose := [platform.name for platform in platforms if platform.name not in tied]:
        notes.append(f"nothing holds the free {'bodies' if len(loose) > 1 else 'body'} {_listed(loose)}: left out")
    driven, pulled = _actuated(file, notes)
    slaves = {coupling.joint for coupling in couplings}
    actuated = driven if file.actuators else {joint.name for joint in joints} - slaves
    notes += _simulated_alone(model)
    if not joints:
        raise GtauError("it has no joints of a robot, but for those of free bodies; give the file of a robot.")
    if not actuated.intersection(joint.name for joint in joints):
        raise GtauError("no actuator drives a joint (joint=...), so none is known to be actuated; add actuators.")
    robot = Robot(
        path.stem,
        tuple(replace(joint, actuated=joint.name in actuated) for joint in joints),
        tuple(platform for platform in platforms if platform.name in tied),
        tuple(closures),
        tuple(couplings),
        tuple(float(rounded(g)) for g in model.opt.gravity),  # type: ignore[arg-type]
        path.name,
        tuple(notes),
        home_given=home_given,
    )
    if held:
        robot = hold_joints(robot, held, "by an equality with a constant")
    homes = {joint.name: joint.home for joint in robot.joints if joint.name in pulled - driven}
    return hold_joints(robot, homes, "since a tendon pulls them, which is not modelled") if homes else robot


def _carriers(model: mujoco.MjModel) -> set[int]:
    """The bodies that carry joints, their own not counted."""
    found = set()
    for body in range(1, model.nbody):
        if model.body_jntnum[body]:
            while body := int(model.body_parentid[body]):
                found.add(body)
    return found


def _simulated_alone(model: mujoco.MjModel) -> Iterator[str]:
    """Notes on what acts in the simulator and is not modelled."""
    if model.opt.density or model.opt.viscosity:
        yield "drag of the fluid around the robot (density, viscosity) acts in the simulator and is not modelled"
    if floating := [_name(model, "body", k) for k in range(1, model.nbody) if model.body_gravcomp[k]]:
        yield f"gravity compensation (gravcomp) acts in the simulator and is not modelled: body {_listed(floating)}"
    balls = [k for k in range(model.njnt) if model.jnt_type[k] == 1 and np.any(model.jnt_stiffness[k])]
    if balls:
        names = _listed([_name(model, "joint", k) for k in balls])
        yield f"springs of balls act in the simulator and are not modelled: joint {names}"


def _listed(names: Sequence[str]) -> str:
    return ", ".join(f"'{name}'" for name in names[:NAMED]) + (
        f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    )


def _joints(
    model: mujoco.MjModel, number: int, at: Attachment, qpos: np.ndarray, last: bool
) -> tuple[list[Joint], Attachment]:
    """A joint of a body whose frame, not yet moved by it, is at `at`; and where the frame is after it."""
    import mujoco

    name, start = _name(model, "joint", number), int(model.jnt_qposadr[number])
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


def _equalities(
    model: mujoco.MjModel, carried: dict[int, Attachment]
) -> tuple[list[Closure], list[Coupling], dict[str, float]]:
    """Closures, couplings, and the positions of joints that an equality holds."""
    import mujoco

    closures, couplings, held = [], [], {}
    for number in range(model.neq):
        name, kind = _name(model, "equality", number), mujoco.mjtEq(int(model.eq_type[number]))
        ends, data = (int(model.eq_obj1id[number]), int(model.eq_obj2id[number])), model.eq_data[number]
        if kind in (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD):
            if int(model.eq_objtype[number]) == int(mujoco.mjtObj.mjOBJ_SITE):
                bodies = [int(model.site_bodyid[site]) for site in ends]
                poses = [_pose(model.site_pos[site], model.site_quat[site]) for site in ends]
            elif kind == mujoco.mjtEq.mjEQ_CONNECT:
                bodies, poses = list(ends), [pose_of(np.eye(3), data[k : k + 3]) for k in (0, 3)]
            else:
                bodies, poses = list(ends), [_pose(data[3:6], data[6:10]), pose_of(np.eye(3), data[:3])]
            a, b = (
                Attachment(carried[body].body, compose(carried[body].placement, pose))
                for body, pose in zip(bodies, poses, strict=True)
            )
            if a.body != b.body:
                closures.append(Closure("connect" if kind == mujoco.mjtEq.mjEQ_CONNECT else "weld", a, b))
        elif kind == mujoco.mjtEq.mjEQ_JOINT and not (ends[1] >= 0 and np.any(data[2:5])):
            zeros = [float(model.qpos0[model.jnt_qposadr[end]]) for end in ends if end >= 0]
            slave = _name(model, "joint", ends[0])
            if ends[1] < 0:
                held[slave] = zeros[0] + float(data[0])
                continue
            offset, ratio = zeros[0] + float(data[0]) - float(data[1]) * zeros[1], float(data[1])
            if ratio:
                couplings.append(Coupling(slave, ((_name(model, "joint", ends[1]), ratio),), offset))
            else:
                held[slave] = offset
        else:
            raise GtauError(
                f"equality '{name}' is none of connect, weld and a linear joint coupling of two joints; remove it, or "
                "describe the mechanism by these."
            )
    return closures, couplings, held


def _actuated(file: MjcfFile, notes: list[str]) -> tuple[set[str], set[str]]:
    """Names of the joints that actuators drive, and of those that they pull by fixed tendons; adds notes."""
    import mujoco

    model, driven, pulled, others = file.model, set(), set(), []
    turning_or_sliding = {
        _name(model, "joint", k)
        for k in range(model.njnt)
        if mujoco.mjtJoint(int(model.jnt_type[k])) in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
    }
    tendons = {
        tendon.get("name", ""): {joint.get("joint", "") for joint in tendon.iter("joint")}
        for root in file.elements
        for tendon in root.iter("fixed")
    }
    for name, transmission, target, gear in file.actuators:
        of_joint = transmission in (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
        if of_joint and target in turning_or_sliding:
            driven.add(target)
            if gear != 1.0:
                notes.append(
                    f"actuator of joint '{target}' has a gear of {gear:g} in the file; positions are those of the "
                    "joint, and a drive gain is in N m (or N) at the joint per unit of the logged signal, gear included"
                )
        elif transmission == mujoco.mjtTrn.mjTRN_TENDON and target in tendons:
            pulled |= tendons[target]
        else:
            others.append(name or target)
    if others:
        s = "s" * (len(others) > 1)
        notes.append(f"actuator{s} {_listed(others)} of no hinge, slide or fixed tendon: left out")
    return driven, pulled


def _pose(position: np.ndarray, quaternion: np.ndarray) -> Pose:
    from scipy.spatial.transform import Rotation

    return pose_of(Rotation.from_quat(quaternion, scalar_first=True).as_matrix(), position)


def _name(model: mujoco.MjModel, kind: str, number: int) -> str:
    element: Any = getattr(model, kind)(number)
    return element.name or f"{kind} {number + 1}"
