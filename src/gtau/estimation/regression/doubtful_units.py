"""Implausible currents and payloads, which suggest a wrong unit."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from itertools import pairwise

import numpy as np

from gtau.estimation.thresholds.logs import CURRENTS_APART, LARGEST_CURRENT, PAYLOAD_DENSITY
from gtau.robots.robot import GROUND, Robot
from gtau.signals.notes import Kind, Note
from gtau.signals.payload import Payload
from gtau.signals.run import Run
from gtau.signals.storage import block, spans


def doubtful_currents(runs: Sequence[Run], base: Collection[str] = ()) -> list[Note]:
    """Note currents that are too large, or of very different size between joints.

    Parameters
    ----------
    runs : sequence of Run
        All runs, their joints in the same order.
    base : collection of str
        Joints of a floating base, without currents.
    """
    if runs[0].kind != "current":
        return []
    squares, samples = np.zeros(len(runs[0].joints)), 0
    for run in runs:
        n = len(run.joints)
        squares += sum(np.sum(block(run.command, *span)[:, :n] ** 2, axis=0) for span in spans(len(run.time)))
        samples += len(run.time)
    # joints at rest may have no current
    driven = [
        (float(rms), joint)
        for joint, rms in zip(runs[0].joints, np.sqrt(squares / samples), strict=True)
        if joint not in base and rms > 0
    ]
    found = []
    if driven and max(driven)[0] > LARGEST_CURRENT:
        rms, joint = max(driven)
        what = f"the current of joint '{joint}' is {rms:.4g} A rms, more than drives of robots take"
        found.append(Note(Kind.UNIT, what, "if it is in mA, write units: {current: mA}", joint=joint))
    for (small, below), (large, above) in pairwise(sorted(driven)):
        if large > CURRENTS_APART * small:
            what = (
                f"the current of joint '{above}' is {large / small:.3g} times that of '{below}' "
                f"({large:.3g} and {small:.3g} A rms)"
            )
            action = "check that the columns are in the same unit (A, mA, % or counts), and convert those that are not"
            found.append(Note(Kind.UNIT, what, action, joint=above))
    return found


def doubtful_payloads(robot: Robot, payloads: Iterable[Payload | None]) -> Iterator[Note]:
    """Note masses too large for an arm of this reach; robots with closures, and floating ones, carry more."""
    reach = None if robot.closures or robot.floating else _reach(robot)
    if not reach:
        return
    most = PAYLOAD_DENSITY * reach**3
    for name, mass in dict.fromkeys((each.name, each.mass) for each in payloads if each and each.mass):
        if mass is not None and mass > most:
            what = (
                f"payload '{name}' weighs {mass:.4g} kg, more than arms that reach {reach:.2g} m carry (about "
                f"{most:.2g} kg at most); all drive gains are proportional to it"
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
