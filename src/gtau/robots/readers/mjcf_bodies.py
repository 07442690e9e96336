"""The bodies of an MJCF file as a tree: joints of one degree of freedom, free platforms, and what carries each body."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from gtau.errors import GtauError
from gtau.robots.floating import base_joints
from gtau.robots.geometry import compose, pose_of, rounded, turn
from gtau.robots.readers.mjcf_model import name_in, pose_in, rotation_in
from gtau.robots.readers.source import BASE_ADVICE, FLOATING, BaseChoice
from gtau.robots.readers.urdf import turning
from gtau.robots.robot import GROUND, ROTATIONS, TRANSLATIONS, Attachment, Joint, Limits, Platform, Pose, base_rows

if TYPE_CHECKING:
    import mujoco


@dataclass
class Bodies:
    """What the bodies of a file are made of, filled along the tree.

    Attributes
    ----------
    joints : list of Joint
        In the order of the file, those of a floating base first.
    platforms : list of Platform
        Free bodies that carry no joints.
    carried : dict of int to Attachment
        The joint or platform that carries each body, and where on it the body's frame is.
    floating : str
        The body that is a floating base, if any.
    notes : list of str
        On bodies that were fixed.
    """

    joints: list[Joint] = field(default_factory=list)
    platforms: list[Platform] = field(default_factory=list)
    carried: dict[int, Attachment] = field(default_factory=lambda: {0: Attachment(GROUND)})
    floating: str = ""
    notes: list[str] = field(default_factory=list)


def read_bodies(model: mujoco.MjModel, qpos: np.ndarray, base: BaseChoice) -> Bodies:
    """Walk the tree of a compiled model, whose joints are at home at ``qpos``.

    Raises
    ------
    GtauError
        A free body carries joints, and ``base`` neither fixes it nor lets it float; or several of them would float.
    """
    import mujoco

    found, carriers = Bodies(), _carriers(model)
    for body in range(1, model.nbody):
        before = found.carried[int(model.body_parentid[body])]
        at = Attachment(before.body, compose(before.placement, pose_in(model.body_pos[body], model.body_quat[body])))
        own = range(int(model.body_jntadr[body]), int(model.body_jntadr[body]) + int(model.body_jntnum[body]))
        for number in own:
            if mujoco.mjtJoint(int(model.jnt_type[number])) == mujoco.mjtJoint.mjJNT_FREE:
                start = int(model.jnt_qposadr[number])
                pose = pose_in(qpos[start : start + 3], qpos[start + 3 : start + 7])
                at = _freed(found, name_in(model, "body", body), pose, body in carriers, base)
            else:
                made, at = _joints(model, number, at, qpos, number == own[-1])
                found.joints += made
        found.carried[body] = at
    found.joints.sort(key=lambda joint: joint.name not in base_rows(found.floating))
    return found


def _carriers(model: mujoco.MjModel) -> set[int]:
    """Find the bodies that carry joints, their own not counted."""
    found = set()
    for body in range(1, model.nbody):
        if model.body_jntnum[body]:
            while body := int(model.body_parentid[body]):
                found.add(body)
    return found


def _freed(found: Bodies, name: str, pose: Pose, carries: bool, base: BaseChoice) -> Attachment:
    """Make a free body a platform, a floating base or a part of the ground; and say where its frame is then."""
    if not carries:
        found.platforms.append(Platform(name, TRANSLATIONS + ROTATIONS, pose))
        return Attachment(name)
    if base is None:
        raise GtauError(f"body '{name}' floats and carries joints; {BASE_ADVICE}.")
    if base == FLOATING:
        if found.floating:
            raise GtauError(f"the bodies '{found.floating}' and '{name}' float; give the file of one robot.")
        found.floating = name
        found.joints += base_joints(name)
        return Attachment(name)
    found.notes.append(f"body '{name}' floats in the file and was fixed")
    return Attachment(GROUND, pose if base.rpy is None else Pose())


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
        angles = rotation_in(qpos[start : start + 4]).as_euler("XYZ")
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
