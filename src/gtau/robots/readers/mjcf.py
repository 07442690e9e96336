"""MJCF files, through MuJoCo's own compiler: geometry, limits, loops and which joints are driven.

Shapes and meshes are ignored; mesh files need not exist. Joints that no motor moves are held: in scenery, rolling
bases, and grippers that tendons pull.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence, Set as AbstractSet
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from gtau.documents.markup import position_limits, read_xml
from gtau.errors import GtauError, errors_at
from gtau.robots.geometry import base_joints, turning
from gtau.robots.parameter import Parameter, RigidBody, lumped
from gtau.robots.parts import hold_joints, listed, without_idle_pins
from gtau.robots.placement import pose_of, rounded, turn
from gtau.robots.readers import mjcf_drives, mjcf_file
from gtau.robots.readers.mjcf_file import MjcfFile, mujoco, name_in, pose_in, rotation_in
from gtau.robots.readers.source import BASE_ADVICE, FLOATING, Base, BaseChoice
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
    RobotFile,
    base_rows,
)

HOME = "home"
"""Name of the keyframe with the home pose; the default is MuJoCo's reference configuration."""


def read_mjcf(path: str | Path, base: BaseChoice = None) -> Robot:
    """Read a robot from an MJCF file; joint coordinates are MuJoCo's ``qpos``.

    A ball becomes three revolute joints, about x, y and z, with massless links in between; a free body held by closures
    becomes a platform. The equalities ``connect``, ``weld`` and ``joint`` (linear) become closures and couplings, as do
    narrow limits of fixed tendons. Joints with an actuator are actuated, or, without actuators, all joints that are not
    coupled; joints that a fixed tendon pulls are held. Stiff joints and straight tendons between two sites are springs.
    A ``base`` fixes free bodies that carry joints, as in the file, or, with ``rpy``, along the axes of the world;
    ``"floating"`` makes the one free body a floating base. Notes list what is left out.
    """
    path = Path(path)
    with errors_at(path):
        if (root := read_xml(path)).tag != "mujoco":
            raise GtauError(f"the outermost element is <{root.tag}>, not <mujoco>; give an MJCF file.")
        robot = as_written(mjcf_file.compile_mjcf(root, path), path, base)
        return without_idle_pins(replace(robot, name=root.get("model") or path.stem))


def as_written(file: MjcfFile, path: Path, base: BaseChoice) -> Robot:
    """Make the robot of a compiled file, with its idle pins."""
    model, qpos, left_out = file.model, file.model.qpos0, list[str]()
    homes = [np.array(key.qpos) for key in file.spec.keys if key.name == HOME]
    if home_given := bool(homes) and homes[0].size == model.nq:
        qpos = homes[0]
    elif homes:
        left_out.append(f"keyframe '{HOME}' has {homes[0].size} positions for {model.nq} and was left out")
    bodies = _bodies(model, qpos, base)
    closures, ties = _equalities(model, bodies.carried)
    ties += mjcf_drives.tied_tendons(file)
    held = {tie.joint: tie.offset for tie in ties if not tie.ratios}
    kinds = {joint.name: joint.kind for joint in bodies.joints}
    limited = list(mjcf_drives.limited_tendons(file, kinds, {tie.joint for tie in ties}))
    motors, forces = mjcf_drives.read_motors(file, kinds), mjcf_drives.efforts(file.spec)
    joints = tuple(
        replace(joint, limits=replace(joint.limits, effort=forces.get(joint.name)))
        for joint in (*bodies.joints, *motors.shafts)
    )
    couplings = [tie for tie in ties if tie.ratios] + [tie for tie, _ in limited] + motors.couplings
    rows = set(base_rows(bodies.floating))
    has_motors = bool(mjcf_drives.actuators(file.spec))
    driven = motors.driven if has_motors else {joint.name for joint in joints} - {tie.joint for tie in couplings}
    _check_motors(joints, driven - rows, bool(closures and not has_motors))
    tied = {end.body for tie in closures for end in (tie.a, tie.b)}
    loose = [platform.name for platform in bodies.platforms if platform.name not in tied]
    springs, notes = mjcf_drives.site_springs(file, bodies.carried)
    notes += [*file.notes, *left_out, *bodies.notes]
    if loose:
        notes.append(f"free {'bodies' if len(loose) > 1 else 'body'} {listed(loose)} attached to nothing: left out")
    notes += [*(note for _, note in limited), *motors.notes, *_simulated_alone(file, bodies.floating)]
    x, y, z = map(rounded, model.opt.gravity.tolist())
    robot = Robot(
        path.stem,
        tuple(replace(joint, actuated=joint.name in driven | rows) for joint in joints),
        tuple(platform for platform in bodies.platforms if platform.name in tied),
        tuple(closures),
        tuple(couplings),
        (0.0, 0.0, 0.0) if _weightless(model) else (x, y, z),
        tuple(spring for spring in springs if {spring.a.body, spring.b.body}.isdisjoint(loose)),
        bodies.floating,
        file=RobotFile(
            path.name,
            tuple(notes),
            home_given,
            inertias=_inertias(file, bodies.carried),
            rounding=mjcf_file.mjcf_rounding(file.elements),
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


def _weightless(model: mujoco.MjModel) -> bool:
    return bool(model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY)


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
    free = int(model.body(floating).jntadr[0]) if floating else 0
    start, brakes = int(model.jnt_dofadr[free]), (model.dof_damping, model.dof_frictionloss, model.dof_armature)
    braked = np.any(model.jnt_stiffness[free]) or any(np.any(effect[start : start + 6]) for effect in brakes)
    if floating and braked:  # for instance by defaults of its class
        yield f"damping, friction or armature of the floating '{floating}' acts in the simulator and is not modelled"
    yield from mjcf_file.angle_notes(file.elements)


def _without_idle_joints(robot: Robot, held: Mapping[str, float], pulled: AbstractSet[str], base: BaseChoice) -> Robot:
    """Hold the joints that no modelled element moves."""
    chains: dict[str, set[str]] = {GROUND: set()}  # a joint's, from the ground
    for joint in robot.joints:
        chains[joint.name] = chains[joint.antecedent] | {joint.name}
    roots = [joint.name for joint in robot.joints if joint.antecedent == GROUND]
    trees = [{name for name, chain in chains.items() if root in chain} for root in roots]
    groups, driven = _groups(robot, chains), set(robot.actuated)
    moved = driven.union(*(group for group in groups if group & driven))
    linked = set(pulled).union(*(group for group in groups if group & pulled and group.isdisjoint(driven)))
    scenery = set[str]().union(*(tree for tree in trees if tree.isdisjoint(moved)))  # doors, targets
    carrying = [set.intersection(*(chains[name] for name in tree & moved)) for tree in trees if tree & moved]
    rolling = set[str]().union(*carrying) - moved if isinstance(base, Base) else set[str]()
    for names, why in (
        (held.keys(), "by an equality with a constant"),
        (linked, "since a tendon pulls them, which is not modelled"),
        (scenery, "since they carry no motor and nothing ties them to one that does"),
        (rolling, "with the base"),
    ):
        if here := {joint.name: held.get(joint.name, joint.home) for joint in robot.joints if joint.name in names}:
            robot = hold_joints(robot, here, why)
    return robot


def _groups(robot: Robot, chains: Mapping[str, set[str]]) -> list[set[str]]:
    """Group the joints (and platforms) that loops and couplings tie to each other."""
    chains = {**chains, **{platform.name: {platform.name} for platform in robot.platforms}}
    ties = [set(tie.terms) for tie in robot.couplings]
    ties += [chains[tie.a.body] ^ chains[tie.b.body] for tie in robot.closures]
    groups: list[set[str]] = []
    for tie in ties:
        apart = [group for group in groups if group.isdisjoint(tie)]
        groups = [*apart, tie.union(*(group for group in groups if group & tie))]
    return groups


@dataclass
class _Bodies:
    """Joints, platforms (free bodies without joints) and floating base of a file, collected along the tree."""

    joints: list[Joint] = field(default_factory=list)
    platforms: list[Platform] = field(default_factory=list)
    carried: dict[int, Attachment] = field(default_factory=lambda: {0: Attachment(GROUND)})
    floating: str = ""
    notes: list[str] = field(default_factory=list)


def _bodies(model: mujoco.MjModel, qpos: np.ndarray, base: BaseChoice) -> _Bodies:
    bodies = _Bodies()
    carriers = set[int]()  # ancestors of bodies with joints
    for body in map(int, model.jnt_bodyid):
        while body := int(model.body_parentid[body]):
            carriers.add(body)
    for body in range(1, model.nbody):
        pose = pose_in(model.body_pos[body], model.body_quat[body])
        at = bodies.carried[int(model.body_parentid[body])].at(pose)
        joints = np.flatnonzero(model.jnt_bodyid == body).tolist()
        for number in joints:
            if model.jnt_type[number] == mujoco.mjtJoint.mjJNT_FREE:
                start = int(model.jnt_qposadr[number])
                pose = pose_in(qpos[start : start + 3], qpos[start + 3 : start + 7])
                at = _freed(bodies, name_in(model, "body", body), pose, body in carriers, base)
            else:
                made, at = _joints(model, number, at, qpos, number == joints[-1])
                bodies.joints += made
        bodies.carried[body] = at
    bodies.joints.sort(key=lambda joint: joint.name not in base_rows(bodies.floating))
    return bodies


def _freed(bodies: _Bodies, name: str, pose: Pose, carries: bool, base: BaseChoice) -> Attachment:
    """Make a free body a platform, floating base or part of the ground; return the attachment of its frame."""
    if not carries:
        bodies.platforms.append(Platform(name, TRANSLATIONS + ROTATIONS, pose))
        return Attachment(name)
    if base is None:
        raise GtauError(f"body '{name}' floats and carries joints; {BASE_ADVICE}.")
    if base == FLOATING:
        if bodies.floating:
            raise GtauError(f"the bodies '{bodies.floating}' and '{name}' float; give the file of one robot.")
        bodies.floating = name
        bodies.joints += base_joints(name)
        return Attachment(name)
    bodies.notes.append(f"body '{name}' floats in the file and was fixed")
    return Attachment(GROUND, pose if base.rpy is None else Pose())


def _joints(
    model: mujoco.MjModel, number: int, at: Attachment, qpos: np.ndarray, last: bool
) -> tuple[list[Joint], Attachment]:
    """Make the joint of a body whose frame is at `at` before its motion; return the frame's attachment after it."""
    name = name_in(model, "joint", number)
    start = int(model.jnt_qposadr[number])
    kind, axis, anchor = model.jnt_type[number], model.jnt_axis[number], model.jnt_pos[number]
    slides, reference = kind == mujoco.mjtJoint.mjJNT_SLIDE, Pose()
    if slides:
        anchor = np.zeros(3)
        reference = pose_of(np.eye(3), -axis * model.qpos0[start])
    elif kind == mujoco.mjtJoint.mjJNT_HINGE:
        reference = pose_of(turn(axis, -model.qpos0[start]), np.zeros(3))
    placement = at.at(pose_of(np.eye(3), anchor)).at(reference).placement
    after = Attachment(name, pose_of(np.eye(3), -anchor))
    if kind == mujoco.mjtJoint.mjJNT_BALL:
        angles = rotation_in(qpos[start : start + 4]).as_euler("XYZ")
        chain = zip(turning(name, at.body, placement, "xyz"), angles, strict=True)
        *links, ball = (replace(joint, home=float(angle)) for joint, angle in chain)
        return [*links, ball if last else replace(ball, parameters="none")], after
    low, high = map(float, model.jnt_range[number])
    joint = Joint(
        name,
        at.body,
        "prismatic" if slides else "revolute",
        placement,
        tuple(rounded(component) for component in axis),  # type: ignore[arg-type]
        home=rounded(qpos[start]),
        limits=Limits(position_limits(low, high) if model.jnt_limited[number] else None),
        # the joints of one body have no links between them
        parameters="all" if last else "drive",
        spring=rounded(model.qpos_spring[start]) if np.any(model.jnt_stiffness[number]) else None,
    )
    return [joint], after


def _equalities(model: mujoco.MjModel, carried: Mapping[int, Attachment]) -> tuple[list[Closure], list[Coupling]]:
    """Read closures and couplings, a coupling of one joint where it is held; ``carried`` places the bodies' frames."""
    closures, couplings, tie = [], [], mujoco.mjtEq
    for number in range(model.neq):
        kind = tie(int(model.eq_type[number]))
        data = model.eq_data[number]
        ends = int(model.eq_obj1id[number]), int(model.eq_obj2id[number])
        if kind in (tie.mjEQ_CONNECT, tie.mjEQ_WELD):
            a, b = _ends(model, number, ends, carried)
            if a.body != b.body:
                closures.append(Closure("connect" if kind == tie.mjEQ_CONNECT else "weld", a, b))
        elif kind == tie.mjEQ_JOINT and (ends[1] < 0 or not np.any(data[2:5])):
            (joint, zero), *others = (
                (name_in(model, "joint", end), float(model.qpos0[model.jnt_qposadr[end]])) for end in ends if end >= 0
            )
            offset, ratio = zero + float(data[0]), float(data[1])
            ratios = tuple((other, ratio) for other, _ in others if ratio)
            couplings.append(Coupling(joint, ratios, offset - sum(ratio * other_zero for _, other_zero in others)))
        else:
            raise GtauError(
                f"equality '{name_in(model, 'equality', number)}' is neither connect, weld nor a linear joint coupling "
                "of two joints; remove it, or describe the mechanism by these."
            )
    return closures, couplings


def _ends(
    model: mujoco.MjModel, number: int, ends: tuple[int, int], carried: Mapping[int, Attachment]
) -> tuple[Attachment, Attachment]:
    """Place the two frames that an equality ``connect`` or ``weld`` ties: sites, or points and poses on bodies."""
    data = model.eq_data[number]
    if model.eq_objtype[number] == mujoco.mjtObj.mjOBJ_SITE:
        return mjcf_drives.attached_site(model, ends[0], carried), mjcf_drives.attached_site(model, ends[1], carried)
    if model.eq_type[number] == mujoco.mjtEq.mjEQ_CONNECT:
        poses = pose_of(np.eye(3), data[:3]), pose_of(np.eye(3), data[3:6])
    else:
        poses = pose_in(data[3:6], data[6:10]), pose_of(np.eye(3), data[:3])
    return carried[ends[0]].at(poses[0]), carried[ends[1]].at(poses[1])


def _inertias(file: MjcfFile, carried: Mapping[int, Attachment]) -> tuple[tuple[str, float], ...]:
    """Sum MuJoCo's inertias of an MJCF file by the carriers of the bodies; armatures of joints are rotor inertias."""
    model = file.model
    if not file.has_masses:
        return ()

    def body(number: int) -> RigidBody:
        rotation = rotation_in(model.body_iquat[number]).as_matrix()
        tensor = rotation @ np.diag(model.body_inertia[number]) @ rotation.T
        return RigidBody(float(model.body_mass[number]), model.body_ipos[number].copy(), tensor)

    inertias = lumped((carried[number], body(number)) for number in range(1, model.nbody))
    rotors = (
        (Parameter("ia", name_in(model, "joint", number)), float(model.dof_armature[model.jnt_dofadr[number]]))
        for number in range(model.njnt)
    )
    stated = inertias.items() if any(inertias.values()) else ()
    return (*stated, *((name, armature) for name, armature in rotors if armature))
