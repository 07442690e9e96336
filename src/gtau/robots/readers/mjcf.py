"""MJCF files, through MuJoCo's own compiler: geometry, limits, loops and which joints are driven.

Masses, shapes and meshes are ignored; mesh files need not exist. Joints with an actuator have
motors, and in a gripper alone the shafts that pull tendons; joints that no motor moves are held: those of scenery, of
bases that roll, and of grippers that tendons pull.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from gtau.errors import GtauError
from gtau.robots.file import RobotFile
from gtau.robots.geometry import rounded
from gtau.robots.parts import hold_joints, listed, without_idle_pins
from gtau.robots.readers.inertias import mjcf_inertias, mjcf_masses
from gtau.robots.readers.mjcf_bodies import fixed_tendons, read_bodies, read_ties, site_springs
from gtau.robots.readers.mjcf_file import MjcfFile, angle_notes, compile_mjcf, mjcf_rounding, name_in
from gtau.robots.readers.source import Base, BaseChoice
from gtau.robots.readers.xml_document import read_xml
from gtau.robots.robot import GROUND, Coupling, Joint, Robot, base_rows

if TYPE_CHECKING:
    import mujoco

HOME = "home"
"""Name of the keyframe that gives home; without one, MuJoCo's reference configuration does."""


def read_mjcf(path: str | Path, base: BaseChoice = None) -> Robot:
    """Read a robot from an MJCF file.

    Hinges and slides are joints; a ball becomes three revolute ones, about x, y and z, with massless links in between,
    and a free body that closures hold a platform. Bodies without joints become part of those that carry them. The
    equalities ``connect``, ``weld`` and ``joint`` (linear) become closures and couplings, and so do narrow limits of
    fixed tendons; a joint with an actuator is actuated, and where there are no actuators, every joint that is not
    coupled. Joints that a fixed tendon pulls are held. A joint with a stiffness has a spring; so do the bodies of two
    sites with a tendon straight between them. A ``base`` fixes free bodies that carry joints, as in the file, or, if
    its ``rpy`` is given, with the axes of the world; ``"floating"`` makes the one there is a floating base.

    Joint coordinates are MuJoCo's ``qpos``. Notes list omitted elements and effects of the simulator alone.
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
    qpos, home_given, notes = _home(file)
    bodies = read_bodies(file.model, qpos, base)
    kinds = {joint.name: joint.kind for joint in bodies.joints}
    closures, tied_joints, held, ties_notes = read_ties(file, bodies.carried, kinds)
    motors = read_motors(file, bodies.joints)
    joints = (*bodies.joints, *motors.shafts)
    couplings = (*tied_joints, *motors.couplings)
    rows = set(base_rows(bodies.floating))
    driven = motors.driven if file.actuators else {joint.name for joint in joints} - {tie.joint for tie in couplings}
    _check_motors(joints, driven - rows, bool(closures and not file.actuators))
    tied = {end.body for closure in closures for end in (closure.a, closure.b)}
    loose = [platform.name for platform in bodies.platforms if platform.name not in tied]
    springs = (
        spring for spring in site_springs(file, bodies.carried) if {spring.a.body, spring.b.body}.isdisjoint(loose)
    )
    notes += [*bodies.notes, *_left_out(loose), *ties_notes, *motors.notes, *_simulated_alone(file, bodies.floating)]
    robot = Robot(
        path.stem,
        tuple(replace(joint, actuated=joint.name in driven | rows) for joint in joints),
        tuple(platform for platform in bodies.platforms if platform.name in tied),
        tuple(closures),
        couplings,
        _gravity(file.model),
        tuple(springs),
        bodies.floating,
        file=RobotFile(
            path.name,
            tuple(notes),
            home_given,
            inertias=mjcf_inertias(file.inertias, bodies.carried, file.armatures),
            rounding=mjcf_rounding(file.elements),
        ),
    )
    return _without_idle_joints(robot, held, motors.pulled, base)


def _home(file: MjcfFile) -> tuple[np.ndarray, bool, list[str]]:
    """Take the positions of the keyframe ``home``, if it fits, else the reference; note the choice and omissions."""
    given, needed = file.keys.get(HOME), file.model.nq
    if given is None:
        return file.model.qpos0, False, file.notes
    if given.size == needed:
        return given, True, file.notes
    left_out = f"keyframe '{HOME}' has {given.size} positions for {needed} and was left out"
    return file.model.qpos0, False, [*file.notes, left_out]


def _check_motors(joints: Sequence[Joint], actuated: AbstractSet[str], loops_alone: bool) -> None:
    if loops_alone:
        raise GtauError("it has loops but no actuators, so the actuated joints are unknown; add actuators.")
    if not joints:
        raise GtauError("it has no joints except those of free bodies; give the file of a robot.")
    if actuated.isdisjoint(joint.name for joint in joints):
        raise GtauError("no actuator drives a joint (joint=...), so the actuated joints are unknown; add actuators.")


def _gravity(model: mujoco.MjModel) -> tuple[float, float, float]:
    if _weightless(model):
        return (0.0, 0.0, 0.0)
    x, y, z = (float(rounded(g)) for g in model.opt.gravity)
    return (x, y, z)


def _weightless(model: mujoco.MjModel) -> bool:
    import mujoco

    return bool(model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY)


def _left_out(loose: Sequence[str]) -> Iterator[str]:
    if loose:
        yield f"free {'bodies' if len(loose) > 1 else 'body'} {listed(loose)} attached to nothing: left out"


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
    """Note effects of the simulator that are not modelled, and likely errors of the file."""
    model = file.model
    if _weightless(model):
        yield "gravity is switched off in the file, and here; where it acts, write it in a saved robot file"
    if model.opt.density or model.opt.viscosity:
        yield "drag of the fluid around the robot (density, viscosity) acts in the simulator and is not modelled"
    if light := [name_in(model, "body", k) for k in range(1, model.nbody) if model.body_gravcomp[k]]:
        yield f"gravity compensation (gravcomp) acts in the simulator and is not modelled: body {listed(light)}"
    balls = [k for k in range(model.njnt) if model.jnt_type[k] == 1 and np.any(model.jnt_stiffness[k])]
    if balls:
        names = listed([name_in(model, "joint", k) for k in balls])
        yield f"springs of balls act in the simulator and are not modelled: joint {names}"
    if floating and _braked(model, model.body(floating).jntadr[0]):
        yield f"damping, friction or armature of the floating '{floating}' acts in the simulator and is not modelled"
    yield from mjcf_masses(file.elements)
    yield from angle_notes(file.elements)


def _braked(model: mujoco.MjModel, free: int) -> bool:
    """Decide whether damping and similar effects act on a free joint, as set by the defaults of its class."""
    six = slice(int(model.jnt_dofadr[free]), int(model.jnt_dofadr[free]) + 6)
    acting = (model.dof_damping[six], model.dof_frictionloss[six], model.dof_armature[six], model.jnt_stiffness[free])
    return any(np.any(effect) for effect in acting)


Kind = Literal["revolute", "prismatic"]


@dataclass(frozen=True)
class Motors:
    """Joints and tendons driven by the actuators of a file.

    ``driven`` are the joints with a motor, shafts among them, and ``pulled`` others, pulled by fixed tendons, which are
    not modelled. ``shafts`` are motors of tendons, as joints on the ground, and ``couplings`` tie joints to them.
    """

    driven: frozenset[str]
    pulled: frozenset[str]
    shafts: tuple[Joint, ...]
    couplings: tuple[Coupling, ...]
    notes: tuple[str, ...]


def read_motors(file: MjcfFile, joints: Sequence[Joint]) -> Motors:
    """Read the actuators; those that pull fixed tendons become motors only where no other drives a joint."""
    tendons, notes = fixed_tendons(file), list[str]()
    driven, pulled = _actuated_joints(file, tendons, notes)
    if driven or not pulled:
        return Motors(frozenset(driven), frozenset(pulled - driven), (), (), tuple(notes))
    shafts, couplings = [], []
    for shaft, coupling in _tendon_motors(file, tendons, {joint.name: joint.kind for joint in joints}):
        shafts.append(shaft)
        couplings.append(coupling)
        notes.append(
            f"'{shaft.name}' is the motor that pulls {listed([name for name, _ in coupling.ratios])} by a fixed "
            "tendon; its position is the tendon's length"
        )
    driven = {shaft.name for shaft in shafts}
    return Motors(frozenset(driven), frozenset(), tuple(shafts), tuple(couplings), tuple(notes))


def _actuated_joints(
    file: MjcfFile, tendons: Mapping[str, Mapping[str, float]], notes: list[str]
) -> tuple[set[str], set[str]]:
    """Name the joints that actuators drive, and those that they pull by fixed tendons; add notes."""
    import mujoco

    model, others = file.model, []
    driven: set[str] = set()
    pulled: set[str] = set()
    turning_or_sliding = {
        name_in(model, "joint", k)
        for k in range(model.njnt)
        if mujoco.mjtJoint(int(model.jnt_type[k])) in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
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
            pulled |= tendons[target].keys()
        else:
            others.append(name or target)
    if others:
        s = "s" * (len(others) > 1)
        notes.append(f"actuator{s} {listed(others)} on no hinge, slide or fixed tendon: left out")
    return driven, pulled


def _tendon_motors(
    file: MjcfFile, tendons: Mapping[str, Mapping[str, float]], kinds: Mapping[str, Kind]
) -> Iterator[tuple[Joint, Coupling]]:
    """Convert motors that pull fixed tendons to shafts on the ground whose position is the tendon's length.

    The force along a tendon acts on a joint by the coefficient of the joint in the tendon's length.
    """
    import mujoco

    for number, (name, transmission, target, _) in enumerate(file.actuators, start=1):
        if transmission == mujoco.mjtTrn.mjTRN_TENDON and target in tendons:
            ratios = tuple((joint, factor) for joint, factor in tendons[target].items() if factor)
            shaft = name if name and name not in kinds else f"motor {number}"
            yield Joint(shaft, GROUND, kinds[ratios[0][0]], parameters="drive"), Coupling(shaft, ratios)


def scenery(robot: Robot) -> set[str]:
    """List the joints of doors, targets and the like: of trees from the ground in which no motor moves anything."""
    moved = _moved(robot)
    idle: set[str] = set()
    for tree in _trees(robot):
        if tree.isdisjoint(moved):
            idle |= tree
    return idle


def moving_base(robot: Robot) -> set[str]:
    """List unactuated joints that carry all actuated ones of their tree: those of a base that rolls or slides."""
    before, moved, carrying = _carrying(robot), _moved(robot), set()
    for tree in _trees(robot):
        if carried := [before[name] for name in tree & moved]:
            carrying |= set.intersection(*carried) - moved - {GROUND}
    return carrying


def with_linkages(robot: Robot, pulled: AbstractSet[str]) -> set[str]:
    """List the joints that tendons pull, and those of their loops, where no motor moves them."""
    linked = set(pulled)
    for group in _groups(robot):
        if not group.isdisjoint(pulled) and group.isdisjoint(robot.actuated):
            linked |= group
    return linked & {joint.name for joint in robot.joints}


def _carrying(robot: Robot) -> dict[str, set[str]]:
    """List the joints, and the ground, that carry each joint."""
    before: dict[str, set[str]] = {GROUND: set()}
    for joint in robot.joints:
        before[joint.name] = before[joint.antecedent] | {joint.antecedent}
    return before


def _trees(robot: Robot) -> Iterator[set[str]]:
    """Group the joints by the trees rooted at the ground."""
    before = _carrying(robot)
    for root in (joint.name for joint in robot.joints if joint.antecedent == GROUND):
        yield {root} | {name for name, carriers in before.items() if root in carriers}


def _moved(robot: Robot) -> set[str]:
    """List the joints with motors, and those that loops and couplings tie to them."""
    driven = set(robot.actuated)
    for group in _groups(robot):
        if not group.isdisjoint(robot.actuated):
            driven |= group
    return driven


def _groups(robot: Robot) -> list[set[str]]:
    """Group the joints (and platforms) that loops and couplings tie to each other."""
    before = _carrying(robot) | {platform.name: {platform.name} for platform in robot.platforms}
    ties = [{coupling.joint, *dict(coupling.ratios)} for coupling in robot.couplings]
    for closure in robot.closures:
        a, b = (before[end.body] | {end.body} for end in (closure.a, closure.b))
        ties.append((a ^ b) - {GROUND})
    groups: list[set[str]] = []
    for tie in ties:
        apart = [group for group in groups if group.isdisjoint(tie)]
        groups = [*apart, tie.union(*(group for group in groups if not group.isdisjoint(tie)))]
    return groups
