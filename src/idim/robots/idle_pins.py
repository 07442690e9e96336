"""Pins that move nothing but themselves: locked, and said so.

Drawing programs put a hinge on both parts that a loop joins. The closure then ties two coaxial pins, and the piece
between them can turn freely; likewise a pin through the centre of a ball. Such a freedom is none of the robot's.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from idim.robots.geometry import compose
from idim.robots.robot import Attachment, Closure, Joint, Robot

COAXIAL = 1e-8  # rad, and share of the length of the closure's arms


def without_idle_pins(robot: Robot) -> Robot:
    """Lock, at zero, one of two coaxial pins at each closure, and pins through the point of a ``connect``.

    Only passive revolute joints that carry nothing but the closure count as pins.

    Returns
    -------
    Robot
        With a note on every joint locked.
    """
    for number, closure in enumerate(robot.closures):
        # the second pin first, so that the first one stays
        for end, other in ((closure.b, closure.a), (closure.a, closure.b)):
            pin = _pin(robot, end)
            if pin is None:
                continue
            direction, point = _line(pin, end)
            if closure.kind == "connect":
                idle = np.linalg.norm(np.cross(point, direction)) < COAXIAL
                why = "its axis passes through the point of the closure"
            else:
                twin = _pin(robot, other)
                if twin is None:
                    continue
                direction_2, point_2 = _line(twin, other)
                apart = np.linalg.norm(np.cross(point - point_2, direction))
                idle = apart < COAXIAL and np.linalg.norm(np.cross(direction, direction_2)) < COAXIAL
                why = f"it is coaxial with '{twin.name}'"
            if idle:
                note = f"joint '{pin.name}' is idle, since {why} in closure {number + 1}; it was locked at zero"
                return without_idle_pins(replace(_locked(robot, pin), notes=(*robot.notes, note)))
    return robot


def _pin(robot: Robot, end: Attachment) -> Joint | None:
    """The passive revolute joint that moves a closure's end and nothing else."""
    if all(joint.name != end.body for joint in robot.joints):
        return None
    pin = robot.joint(end.body)
    uses = [joint.antecedent for joint in robot.joints]
    uses += [each.body for closure in robot.closures for each in (closure.a, closure.b)]
    uses += [name for coupling in robot.couplings for name in (coupling.joint, *dict(coupling.ratios))]
    return pin if pin.kind == "revolute" and not pin.actuated and uses.count(pin.name) == 1 else None


def _line(pin: Joint, end: Attachment) -> tuple[np.ndarray, np.ndarray]:
    """Direction (3,) and a point (3,) of the pin's axis in the frame of the closure's end."""
    to_end = end.placement.rotation.T
    return to_end @ np.array(pin.axis), to_end @ -end.placement.position


def _locked(robot: Robot, pin: Joint) -> Robot:
    def moved(end: Attachment) -> Attachment:
        if end.body != pin.name:
            return end
        return Attachment(pin.antecedent, compose(pin.placement, end.placement))

    return replace(
        robot,
        joints=tuple(joint for joint in robot.joints if joint is not pin),
        closures=tuple(Closure(closure.kind, moved(closure.a), moved(closure.b)) for closure in robot.closures),
    )
