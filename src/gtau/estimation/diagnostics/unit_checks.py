"""Sizes of currents, gravity and payloads that only a wrong unit explains, before any fit.

A wrong unit fits the data as well as the truth, so that only sizes reveal it: grams for kilograms scale all gains and
parameters, milliamperes for amperes a gain.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from itertools import pairwise

import numpy as np

from gtau.estimation.diagnostics.verdict import LARGE_CURRENT, contradiction
from gtau.findings import Finding
from gtau.robots.robot import GROUND, Robot
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run
from gtau.signals.storage import block, spans

LARGEST_CURRENT = 100.0  # rms current of a joint, A, from which it is rather in mA
SMALLEST_CURRENT = 0.02  # largest rms current of all joints, A, below which a current stated in mA is rather in A
GRAVITY_RANGE = 0.04  # strength of gravity from 9.80 m/s2, or 1.62 on the moon, beyond which it is of no place
PAYLOAD_DENSITY = 100.0  # mass of a payload over the cube of the arm's reach, kg/m3, from which it is rather in g
CURRENTS_APART = 30.0  # rms current of a joint over the next smaller one, from which units may differ between joints

SMALL_CURRENT = "current too small"
PLACES = (9.80, 1.62)  # m/s2, on earth and on the moon


def doubtful_gravity(robot: Robot) -> Iterator[Finding]:
    """Find a strength of gravity that is of no place where robots are; without gravity there is nothing to doubt."""
    strength = float(np.linalg.norm(robot.gravity))
    if strength and min(abs(strength - place) for place in PLACES) > GRAVITY_RANGE:
        text = (
            f"gravity is {strength:.4g} m/s2 in the robot's description, and 9.76 to 9.84 on earth; gains and "
            "parameters that rest on weights have its error"
        )
        advice = (
            "write 'gravity: [0, 0, -9.81]' in the robot file (in base axes; 'moon' and 'none' are words), or state "
            "'prior_gains' if it is right"
        )
        yield contradiction("strength of gravity", (), text, advice, shown_as="model")


def doubtful_currents(runs: Sequence[Run], base: Collection[str] = ()) -> Iterator[Finding]:
    """Find currents that no drive takes, or that differ much between joints; a floating ``base`` has none."""
    if runs[0].kind != "current":
        return
    joints = runs[0].joints
    squares = sum(
        np.sum(block(run.command, *span)[:, : len(joints)] ** 2, axis=0)
        for run in runs
        for span in spans(len(run.time))
    )
    sizes = np.sqrt(squares / sum(len(run.time) for run in runs)).tolist()
    # joints at rest may have no current
    driven = sorted((rms, joint) for joint, rms in zip(joints, sizes, strict=True) if joint not in base and rms > 0)
    if large := tuple(joint for rms, joint in driven if rms > LARGEST_CURRENT):
        text = f"the current of joint '{large[-1]}' is {driven[-1][0]:.4g} A rms, more than drives of robots take"
        advice = "if it is in mA, write units: {current: mA}; otherwise state 'prior_gains'"
        yield contradiction(LARGE_CURRENT, large, text, advice, large[-1], shown_as="unit")
    if driven and driven[-1][0] < SMALLEST_CURRENT:
        rms, largest = driven[-1]
        text = f"the largest current, of joint '{largest}', is {rms:.2g} A rms, less than drives of robots take"
        yield contradiction(
            SMALL_CURRENT, tuple(joint for _, joint in driven), text, check_milliamperes(runs), largest, shown_as="unit"
        )
    for (small, below), (larger, above) in pairwise(driven):
        if larger > CURRENTS_APART * small:
            text = (
                f"the current of joint '{above}' is {larger / small:.3g} times the current of '{below}' ({larger:.3g} "
                f"and {small:.3g} A rms)"
            )
            advice = "check that the columns are in the same unit (A, mA, % or counts), and convert the others"
            yield Finding("currents far apart", (above,), below, text=text, advice=advice, shown_as="unit")


def check_milliamperes(runs: Sequence[Run]) -> str:
    """Advise what to check where currents look too small."""
    mass = " and the payload's mass (kg)" if any(run.payload for run in runs) else ""
    return f"check the unit of the currents (A stated as mA?){mass}; if both are right, state 'prior_gains'"


def doubtful_payloads(robot: Robot, payloads: Iterable[Payload | None]) -> Iterator[Finding]:
    """Find masses too large for an arm of this reach."""
    if not (reach := reach_of(robot)):
        return
    most = PAYLOAD_DENSITY * reach**3
    for name, mass in dict.fromkeys((payload.name, payload.mass) for payload in payloads if payload and payload.mass):
        if mass is not None and mass > most:
            text = (
                f"payload '{name}' weighs {mass:.4g} kg, more than arms that reach {reach:.2g} m carry (about "
                f"{most:.3g} kg at most); all drive gains are proportional to it"
            )
            advice = f"if it is in g, write 'mass: {0.001 * mass:.4g}' (kg); otherwise state 'prior_gains'"
            yield contradiction("payload too heavy", (), text, advice, name, shown_as="unit")


def reach_of(robot: Robot) -> float | None:
    """Add up the links from the ground to the body that carries payloads, m.

    None where a slide has no limits, and of robots with closures and floating ones, which carry more.
    """
    if robot.closures or robot.floating:
        return None
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
