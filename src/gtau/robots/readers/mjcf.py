"""MJCF files, through MuJoCo's own compiler: geometry, limits, loops and which joints are driven.

Shapes and meshes are ignored; mesh files need not exist. Joints with an actuator have motors; in a lone gripper the
shafts that pull tendons do. Joints that no motor moves are held: in scenery, rolling bases, and grippers that tendons
pull.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gtau.errors import GtauError
from gtau.robots.parts import hold_joints, listed, without_idle_pins
from gtau.robots.placement import rounded
from gtau.robots.readers.inertias import mjcf_inertias
from gtau.robots.readers.mjcf_bodies import read_bodies, read_equalities
from gtau.robots.readers.mjcf_file import MjcfFile, angle_notes, compile_mjcf, mjcf_rounding, name_in
from gtau.robots.readers.mjcf_tendons import (
    actuators,
    efforts,
    fixed_tendons,
    limited_tendons,
    site_springs,
    tied_tendons,
)
from gtau.robots.readers.source import Base, BaseChoice
from gtau.robots.readers.xml_document import read_xml
from gtau.robots.robot import GROUND, Coupling, Joint, JointKind, Robot, RobotFile, base_rows

if TYPE_CHECKING:
    import mujoco

HOME = "home"
"""Name of the keyframe with the home pose; the default is MuJoCo's reference configuration."""


def read_mjcf(path: str | Path, base: BaseChoice = None) -> Robot:
    """Read a robot from an MJCF file.

    Hinges and slides are joints; a ball becomes three revolute joints, about x, y and z, with massless links in
    between; a free body held by closures becomes a platform. Bodies without joints become part of their carriers. The
    equalities ``connect``, ``weld`` and ``joint`` (linear) become closures and couplings, as do narrow limits of fixed
    tendons. Joints with an actuator are actuated, or, without actuators, all joints that are not coupled. Joints that a
    fixed tendon pulls are held. A joint with a stiffness has a spring, as do the bodies of two sites with a straight
    tendon between them. A ``base`` fixes free bodies that carry joints, as in the file, or, with ``rpy``, along the
    axes of the world; ``"floating"`` makes the one free body a floating base.

    Joint coordinates are MuJoCo's ``qpos``. Notes list omitted elements and effects of the simulator alone.
    """
    path = Path(path)
    try:
        if (root := read_xml(path)).tag != "mujoco":
            raise GtauError(f"the outermost element is <{root.tag}>, not <mujoco>; give an MJCF file.")
        file = compile_mjcf(root, path)
        robot = replace(as_written(file, path, base), name=root.get("model") or path.stem)
        return without_idle_pins(robot)
    except GtauError as error:
        raise type(error)(f"{path}: {error}") from None


def as_written(file: MjcfFile, path: Path, base: BaseChoice) -> Robot:
    """Make the robot of a compiled file, with its idle pins."""
    model, qpos, left_out = file.model, file.model.qpos0, list[str]()
    homes = [np.array(key.qpos) for key in file.spec.keys if key.name == HOME]
    if home_given := bool(homes) and homes[0].size == model.nq:
        qpos = homes[0]
    elif homes:
        left_out.append(f"keyframe '{HOME}' has {homes[0].size} positions for {model.nq} and was left out")
    bodies = read_bodies(model, qpos, base)
    closures, ties = read_equalities(model, bodies.carried)
    ties += tied_tendons(file)
    held = {tie.joint: tie.offset for tie in ties if not tie.ratios}
    kinds = {joint.name: joint.kind for joint in bodies.joints}
    limited = list(limited_tendons(file, kinds, {tie.joint for tie in ties}))
    motors, forces = read_motors(file, kinds), efforts(file.spec)
    joints = tuple(
        replace(joint, limits=replace(joint.limits, effort=forces.get(joint.name)))
        for joint in (*bodies.joints, *motors.shafts)
    )
    couplings = [tie for tie in ties if tie.ratios] + [tie for tie, _ in limited] + motors.couplings
    rows, has_motors = set(base_rows(bodies.floating)), bool(actuators(file.spec))
    driven = motors.driven if has_motors else {joint.name for joint in joints} - {tie.joint for tie in couplings}
    _check_motors(joints, driven - rows, bool(closures and not has_motors))
    tied = {end.body for closure in closures for end in (closure.a, closure.b)}
    loose = [platform.name for platform in bodies.platforms if platform.name not in tied]
    springs, notes = site_springs(file, bodies.carried)
    notes += [*file.notes, *left_out, *bodies.notes]
    if loose:
        notes.append(f"free {'bodies' if len(loose) > 1 else 'body'} {listed(loose)} attached to nothing: left out")
    notes += [note for _, note in limited] + motors.notes + [*_simulated_alone(file, bodies.floating)]
    robot = Robot(
        path.stem,
        tuple(replace(joint, actuated=joint.name in driven | rows) for joint in joints),
        tuple(platform for platform in bodies.platforms if platform.name in tied),
        tuple(closures),
        tuple(couplings),
        _gravity(model),
        tuple(spring for spring in springs if {spring.a.body, spring.b.body}.isdisjoint(loose)),
        bodies.floating,
        file=RobotFile(
            path.name,
            tuple(notes),
            home_given,
            inertias=mjcf_inertias(file, bodies.carried),
            rounding=mjcf_rounding(file.elements),
        ),
    )
    return _without_idle_joints(robot, held, motors.pulled, base)


def _check_motors(joints: Sequence[Joint], actuated: AbstractSet[str], loops_alone: bool) -> None:
    if loops_alone:
        raise GtauError("it has loops but no actuators, so the actuated joints are unknown; add actuators.")
    if not joints:
        raise GtauError("it has no joints except joints of free bodies; give the file of a robot.")
    if actuated.isdisjoint(joint.name for joint in joints):
        raise GtauError("no actuator drives a joint (joint=...), so the actuated joints are unknown; add actuators.")


def _gravity(model: mujoco.MjModel) -> tuple[float, float, float]:
    x, y, z = map(rounded, model.opt.gravity.tolist())
    return (0.0, 0.0, 0.0) if _weightless(model) else (x, y, z)


def _weightless(model: mujoco.MjModel) -> bool:
    import mujoco

    return bool(model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY)


def _without_idle_joints(robot: Robot, held: Mapping[str, float], pulled: AbstractSet[str], base: BaseChoice) -> Robot:
    """Hold the joints that no modelled element moves."""
    for names, why in (
        (held.keys(), "by an equality with a constant"),
        (with_linkages(robot, pulled), "since a tendon pulls them, which is not modelled"),
        (scenery(robot), "since they carry no motor and nothing ties them to one that does"),
        (moving_base(robot) if isinstance(base, Base) else set(), "with the base"),
    ):
        if here := {joint.name: held.get(joint.name, joint.home) for joint in robot.joints if joint.name in names}:
            robot = hold_joints(robot, here, why)
    return robot


def _simulated_alone(file: MjcfFile, floating: str) -> Iterator[str]:
    """Note simulated effects that are not modelled, and likely errors of the file."""
    model = file.model
    if _weightless(model):
        yield "gravity is switched off in the file, and here; where it acts, write it in a saved robot file"
    if model.opt.density or model.opt.viscosity:
        yield "drag of the fluid around the robot (density, viscosity) acts in the simulator and is not modelled"
    if light := [name_in(model, "body", k) for k in range(1, model.nbody) if model.body_gravcomp[k]]:
        yield f"gravity compensation (gravcomp) acts in the simulator and is not modelled: body {listed(light)}"
    sprung = [k for k in range(model.njnt) if model.jnt_type[k] == 1 and np.any(model.jnt_stiffness[k])]
    balls = [name_in(model, "joint", k) for k in sprung]
    if balls:
        yield f"springs of balls act in the simulator and are not modelled: joint {listed(balls)}"
    if floating and _is_braked(model, int(model.body(floating).jntadr[0])):
        yield f"damping, friction or armature of the floating '{floating}' acts in the simulator and is not modelled"
    yield from angle_notes(file.elements)


def _is_braked(model: mujoco.MjModel, free: int) -> bool:
    """Return whether damping, friction or armature act on a free joint, for instance by defaults of its class."""
    start = int(model.jnt_dofadr[free])
    effects = [model.dof_damping, model.dof_frictionloss, model.dof_armature]
    return bool(np.any(model.jnt_stiffness[free])) or any(np.any(effect[start : start + 6]) for effect in effects)


@dataclass(frozen=True)
class Motors:
    """Joints and tendons driven by the actuators of a file.

    ``driven`` joints, shafts included, have a motor; ``pulled`` joints are pulled by fixed tendons, which are not
    modelled. ``shafts`` are motors of tendons, as joints on the ground, and ``couplings`` tie joints to them.
    """

    driven: set[str]
    pulled: set[str]
    shafts: list[Joint]
    couplings: list[Coupling]
    notes: list[str]


def read_motors(file: MjcfFile, kinds: Mapping[str, JointKind]) -> Motors:
    """Read the actuators; tendon actuators become motors only if no other actuator drives a joint.

    Such a motor is a shaft on the ground whose position is the tendon's length: the force along a tendon acts on a
    joint by the joint's coefficient in this length. ``kinds`` maps joint names to kinds.
    """
    import mujoco

    tendons, others, pulling = fixed_tendons(file.spec), [], []
    motors = Motors(set(), set(), [], [], [])
    joint_types = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
    movable = _hinges_and_slides(file.model)
    for number, actuator in enumerate(actuators(file.spec), start=1):
        target, gear = actuator.target, float(actuator.gear[0])
        if actuator.trntype in joint_types and target in movable:
            motors.driven.add(target)
            if gear != 1.0:
                motors.notes.append(
                    f"actuator of joint '{target}' has a gear of {gear:g} in the file; positions are measured at the "
                    "joint, and a drive gain is in N m (or N) at the joint per unit of the logged signal, gear included"
                )
        elif actuator.trntype == mujoco.mjtTrn.mjTRN_TENDON and target in tendons:
            pulling.append((number, actuator.name, tendons[target]))
            motors.pulled.update(tendons[target])
        else:
            others.append(actuator.name or target)
    if others:
        s = "s" * (len(others) > 1)
        motors.notes.append(f"actuator{s} {listed(others)} on no hinge, slide or fixed tendon: left out")
    if motors.driven:
        motors.pulled.difference_update(motors.driven)
        return motors
    for number, name, terms in pulling:
        ratios = tuple((joint, factor) for joint, factor in terms.items() if factor)
        shaft = name if name and name not in kinds else f"motor {number}"
        motors.shafts.append(Joint(shaft, GROUND, kinds[ratios[0][0]], parameters="drive"))
        motors.couplings.append(Coupling(shaft, ratios))
        motors.notes.append(
            f"'{shaft}' is the motor that pulls {listed([joint for joint, _ in ratios])} by a fixed tendon; its "
            "position is the tendon's length"
        )
        motors.driven.add(shaft)
    motors.pulled.clear()
    return motors


def _hinges_and_slides(model: mujoco.MjModel) -> set[str]:
    import mujoco

    types = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
    return {name_in(model, "joint", k) for k, kind in enumerate(model.jnt_type.tolist()) if kind in types}


def scenery(robot: Robot) -> set[str]:
    """List the joints of trees from the ground without any motor, such as doors and targets."""
    moved = _moved(robot)
    return set().union(*(tree for tree in _trees(robot) if tree.isdisjoint(moved)))


def moving_base(robot: Robot) -> set[str]:
    """List unactuated joints that carry all actuated joints of their tree, as in a base that rolls or slides."""
    carriers, moved = _carriers(robot), _moved(robot)
    moved_trees = (tree & moved for tree in _trees(robot) if tree & moved)
    shared = (set.intersection(*(carriers[name] for name in names)) for names in moved_trees)
    return set().union(*shared) - moved - {GROUND}


def with_linkages(robot: Robot, pulled: AbstractSet[str]) -> set[str]:
    """List the joints that tendons pull, and the joints of their loops, if no motor moves them."""
    pulled_alone = (group for group in _groups(robot) if group & pulled and group.isdisjoint(robot.actuated))
    return set(pulled).union(*pulled_alone) & {joint.name for joint in robot.joints}


def _carriers(robot: Robot) -> dict[str, set[str]]:
    carriers: dict[str, set[str]] = {GROUND: set()}
    for joint in robot.joints:
        carriers[joint.name] = carriers[joint.antecedent] | {joint.antecedent}
    return carriers


def _trees(robot: Robot) -> list[set[str]]:
    trees: dict[str, set[str]] = {}
    for joint in robot.joints:
        trees[joint.name] = trees.get(joint.antecedent, set())
        trees[joint.name].add(joint.name)
    return [trees[joint.name] for joint in robot.joints if joint.antecedent == GROUND]


def _moved(robot: Robot) -> set[str]:
    """List the joints with motors, and those that loops and couplings tie to them."""
    driven = set(robot.actuated)
    return driven.union(*(group for group in _groups(robot) if group & driven))


def _groups(robot: Robot) -> list[set[str]]:
    """Group the joints (and platforms) that loops and couplings tie to each other."""
    carriers = _carriers(robot) | {platform.name: {platform.name} for platform in robot.platforms}
    ties = [set(coupling.terms) for coupling in robot.couplings]
    for closure in robot.closures:
        a, b = (carriers[end.body] | {end.body} for end in (closure.a, closure.b))
        ties.append((a ^ b) - {GROUND})
    groups: list[set[str]] = []
    for tie in ties:
        apart = [group for group in groups if group.isdisjoint(tie)]
        groups = [*apart, tie.union(*(group for group in groups if group & tie))]
    return groups
