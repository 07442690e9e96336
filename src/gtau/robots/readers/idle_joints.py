"""Lock pins that move nothing but themselves, with a note.

CAD exporters put a hinge on both parts that a loop joins. The closure then ties two coaxial pins, and the piece
between them can turn freely; likewise a pin through the centre of a ball, and a rod or a leg between two balls about
itself. Such a degree of freedom does not belong to the robot.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gtau.robots.geometry import compose, euler_angles, rounded, turn
from gtau.robots.parts import lock_joints
from gtau.robots.robot import Attachment, Joint, Pose, Robot

COAXIAL = 1e-8  # rad, and share of the length of the closure's arms


def without_idle_pins(robot: Robot) -> Robot:
    """Lock, at zero, one of two coaxial pins at each closure, and pins through the point of a ``connect``.

    Only passive revolute joints that carry nothing but the closure count as pins, or a leg that slides along their axis
    to the point of a ``connect``. Where a pin is the last of three that make up a ball, their axes are chosen so that
    it is idle.

    Returns
    -------
    Robot
        With a note on every joint locked.
    """
    for number, closure in enumerate(robot.closures):
        # the second pin first, so that the first one stays
        for end, other in ((closure.b, closure.a), (closure.a, closure.b)):
            if closure.kind == "connect":
                near, slides = _before_slides(robot, end)
                if (pin := _pin(robot, near)) is None:
                    continue
                point = near.placement.position
                along = slides[0] if slides else point / max(float(np.linalg.norm(point)), 1e-300)
                aimed = _aimed(robot, pin, along)
                if aimed is not robot:
                    return without_idle_pins(aimed)
                apart = [np.cross(each, pin.axis) for each in (point, *slides)]
                idle = np.linalg.norm(apart, axis=1).max() < COAXIAL
                why = "its axis passes through the point of the closure"
            else:
                pin, twin = _pin(robot, end), _pin(robot, other)
                if pin is None or twin is None:
                    continue
                direction, place = _line(pin, end)
                direction_2, place_2 = _line(twin, other)
                away = np.linalg.norm(np.cross(place - place_2, direction))
                idle = away < COAXIAL and np.linalg.norm(np.cross(direction, direction_2)) < COAXIAL
                why = f"it is coaxial with '{twin.name}'"
            if idle:
                note = f"joint '{pin.name}' is idle, since {why} in closure {number + 1}; it was locked at zero"
                note += f", its link a part of '{pin.antecedent}'" * pin.has_mass
                return without_idle_pins(replace(lock_joints(robot, {pin.name: 0.0}), notes=(*robot.notes, note)))
    return robot


def _before_slides(robot: Robot, end: Attachment) -> tuple[Attachment, list[np.ndarray]]:
    """Express a closure's end in the body before the slides that carry nothing else, with their directions (3,)."""
    directions: list[np.ndarray] = []
    while (slide := _lone(robot, end.body)) is not None and slide.kind == "prismatic":
        turned = slide.placement.rotation
        directions = [turned @ each for each in (np.array(slide.axis), *directions)]
        end = Attachment(slide.antecedent, compose(slide.placement, end.placement))
    return end, directions


def _pin(robot: Robot, end: Attachment) -> Joint | None:
    """Find the passive revolute joint that moves a closure's end and nothing else."""
    pin = _lone(robot, end.body)
    return pin if pin is not None and pin.kind == "revolute" and not pin.actuated else None


def _lone(robot: Robot, body: str) -> Joint | None:
    """Find the joint of a body that carries one thing only, a closure's end or another joint."""
    if all(joint.name != body for joint in robot.joints):
        return None
    uses = [joint.antecedent for joint in robot.joints]
    uses += [end.body for end in robot.ends]
    uses += [name for coupling in robot.couplings for name in (coupling.joint, *dict(coupling.ratios))]
    return robot.joint(body) if uses.count(body) == 1 else None


def _line(pin: Joint, end: Attachment) -> tuple[np.ndarray, np.ndarray]:
    """Compute direction (3,) and a point (3,) of the pin's axis in the frame of the closure's end."""
    to_end = end.placement.rotation.T
    return to_end @ np.array(pin.axis), to_end @ -end.placement.position


def _aimed(robot: Robot, pin: Joint, along: np.ndarray) -> Robot:
    """Choose the axes of a ball anew: that of ``pin``, its last, ``along`` a direction (3,) of its link.

    The robot itself where the pin is not the last of a ball, or its axis is along already.
    """
    moved = [joint.name for joint in robot.joints]
    if pin.antecedent not in moved or robot.joint(pin.antecedent).antecedent not in moved:
        return robot
    middle = robot.joint(pin.antecedent)
    first = robot.joint(middle.antecedent)
    axes = np.array([first.axis, middle.axis, pin.axis]).T
    is_ball = pin.placement == middle.placement == Pose() and np.allclose(axes.T @ axes, np.eye(3), atol=COAXIAL)
    inner = all(joint.parameters == "none" and _pin(robot, Attachment(joint.name)) for joint in (first, middle))
    if not (is_ball and inner) or np.linalg.norm(np.cross(axes[:, 2], along)) < COAXIAL:
        return robot
    ball = (first, middle, pin)
    orientation = np.linalg.multi_dot([turn(axis, joint.home) for axis, joint in zip(axes.T, ball, strict=True)])
    # the first axis is square to the rod at home, far from where the first and last would be one
    across = np.cross(along, orientation @ along)
    if np.linalg.norm(across) < 0.1:
        across = np.cross(along, axes[:, np.argmin(np.abs(along @ axes))])
    across /= np.linalg.norm(across)
    now = np.array([across, np.cross(along, across), along]).T
    homes = euler_angles(now.T @ orientation @ now)
    made = {
        joint.name: replace(joint, axis=(rounded(x), rounded(y), rounded(z)), home=rounded(home))
        for joint, (x, y, z), home in zip(ball, now.T, homes, strict=True)
    }
    return replace(robot, joints=tuple(made.get(joint.name, joint) for joint in robot.joints))
