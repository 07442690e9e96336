"""The bodies of an MJCF file as a tree, the equalities that tie them, and their inertias."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from gtau.errors import GtauError
from gtau.robots.floating import base_joints, turning
from gtau.robots.parameter import Parameter, RigidBody, lumped
from gtau.robots.placement import pose_of, rounded, turn
from gtau.robots.readers.mjcf_drives import attached_site
from gtau.robots.readers.mjcf_file import MjcfFile, mujoco, name_in, pose_in, rotation_in
from gtau.robots.readers.source import BASE_ADVICE, FLOATING, BaseChoice
from gtau.robots.readers.xml_document import position_limits
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
    base_rows,
)


@dataclass
class Bodies:
    """Joints, platforms (free bodies without joints) and floating base of a file, collected along the tree."""

    joints: list[Joint] = field(default_factory=list)
    platforms: list[Platform] = field(default_factory=list)
    carried: dict[int, Attachment] = field(default_factory=lambda: {0: Attachment(GROUND)})  # frame of each body
    floating: str = ""
    notes: list[str] = field(default_factory=list)


def read_bodies(model: mujoco.MjModel, qpos: np.ndarray, base: BaseChoice) -> Bodies:
    """Read the tree of a compiled model with its home at ``qpos``."""
    bodies = Bodies()
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


def _freed(bodies: Bodies, name: str, pose: Pose, carries: bool, base: BaseChoice) -> Attachment:
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
    name, start = name_in(model, "joint", number), int(model.jnt_qposadr[number])
    kind, axis, anchor = model.jnt_type[number], model.jnt_axis[number], model.jnt_pos[number]
    slides, reference = kind == mujoco.mjtJoint.mjJNT_SLIDE, Pose()
    if slides:
        anchor, reference = np.zeros(3), pose_of(np.eye(3), -axis * model.qpos0[start])
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


def read_equalities(model: mujoco.MjModel, carried: Mapping[int, Attachment]) -> tuple[list[Closure], list[Coupling]]:
    """Read closures and couplings, those of one joint alone hold it; ``carried`` places the frames of the bodies."""
    closures, couplings, tie = [], [], mujoco.mjtEq
    for number in range(model.neq):
        kind, data = tie(int(model.eq_type[number])), model.eq_data[number]
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
        return attached_site(model, ends[0], carried), attached_site(model, ends[1], carried)
    if model.eq_type[number] == mujoco.mjtEq.mjEQ_CONNECT:
        poses = pose_of(np.eye(3), data[:3]), pose_of(np.eye(3), data[3:6])
    else:
        poses = pose_in(data[3:6], data[6:10]), pose_of(np.eye(3), data[:3])
    return carried[ends[0]].at(poses[0]), carried[ends[1]].at(poses[1])


def mjcf_inertias(file: MjcfFile, carried: Mapping[int, Attachment]) -> tuple[tuple[str, float], ...]:
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
