"""Payloads heavier than any arm of the robot's size carries, so that another unit is likely."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from gtau.estimation.thresholds.logs import PAYLOAD_DENSITY
from gtau.robots.robot import GROUND, Robot
from gtau.signals.notes import Kind, Note
from gtau.signals.payload import Payload


def doubtful_payloads(robot: Robot, payloads: Iterable[Payload | None]) -> Iterator[Note]:
    """Note masses that no arm of this reach carries; robots with closures, and floating ones, carry more."""
    reach = None if robot.closures or robot.floating else _reach(robot)
    if not reach:
        return
    most = PAYLOAD_DENSITY * reach**3
    for name, mass in dict.fromkeys((each.name, each.mass) for each in payloads if each and each.mass):
        if mass is not None and mass > most:
            what = (
                f"payload '{name}' weighs {mass:.4g} kg, more than arms that reach {reach:.2g} m carry (about "
                f"{most:.2g} kg at most); all drive gains are in proportion to it"
            )
            yield Note(Kind.UNIT, what, f"if it is in g, write 'mass: {mass / 1000:.4g}' (kg)")


def _reach(robot: Robot) -> float | None:
    """Add up the links from the ground to the body that carries payloads, m; None where a slide has no limits."""
    reach, body = 0.0, robot.tool
    while body != GROUND:
        joint = robot.joint(body)
        reach += float(np.linalg.norm(joint.placement.position))
        if joint.kind == "prismatic":
            if joint.limits.position is None:
                return None
            reach += max(map(abs, joint.limits.position))
        body = joint.antecedent
    return reach
