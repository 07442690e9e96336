"""What contradicts gains from outside their own equations, and what the contradiction of one gain means for the others.

An error of a unit scales all gains, or a payload, and is met by the data as well as the truth; only what is known
beside the data reveals it: gains from data sheets, and the limits of the joints' effort.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gtau.estimation.diagnostics.verdict import Outcome, Verdict
from gtau.estimation.thresholds.estimates import EFFORT_FACTOR, PRIOR_FACTOR
from gtau.robots.robot import Robot
from gtau.robots.units import torque_unit

THOUSAND = 2.0  # a factor between 1000 / 2 and 1000 * 2 is one of a thousand
BELIEVED = (Outcome.GIVEN, Outcome.GOOD, Outcome.WEAK)


def check_priors(
    verdicts: Sequence[Verdict], robot: Robot, gains: np.ndarray, priors: Mapping[str, float]
) -> tuple[Verdict, ...]:
    """Judge gains (n,) with a prior (by joint, N m/A or N/A) that are more than a factor of two off it."""
    found = list(verdicts)
    for j, joint in enumerate(robot.actuated):
        ratio = abs(gains[j] / priors[joint]) if joint in priors else 1.0
        if 1 / PRIOR_FACTOR <= ratio <= PRIOR_FACTOR or found[j].outcome not in BELIEVED:
            continue
        found[j] = Verdict(
            Outcome.CONTRADICTORY,
            f"it is {ratio:.3g} times its prior of {priors[joint]:.4g} {torque_unit(robot, joint)}/A",
            _units(ratio),
        )
    return tuple(found)


def _units(ratio: float) -> str:
    """Advise what to check where a gain is ``ratio`` times its prior."""
    if 1000 / THOUSAND < ratio < 1000 * THOUSAND:
        return "check the payload's mass, which looks like g taken for kg, and the unit of the currents, A taken for mA"
    if 0.001 / THOUSAND < ratio < 0.001 * THOUSAND:
        return "check the unit of the currents, which looks like mA taken for A, and the payload's mass in kg"
    return "check the payload's mass (kg), the unit of the currents, and 'prior_gains'"


def check_limits(verdicts: Sequence[Verdict], robot: Robot, torques: np.ndarray) -> tuple[Verdict, ...]:
    """Judge joints whose torque (n,), rms in N m or N, is more than twice their effort limit."""
    found = list(verdicts)
    for j, joint in enumerate(robot.actuated):
        limit = robot.joint(joint).limits.effort
        if limit is None or torques[j] <= EFFORT_FACTOR * limit or found[j].outcome not in BELIEVED:
            continue
        unit = torque_unit(robot, joint)
        found[j] = Verdict(
            Outcome.CONTRADICTORY,
            f"with it the torque is {torques[j]:.3g} {unit} (rms), {torques[j] / limit:.3g} times the joint's limit of "
            f"{limit:.4g} {unit}",
            "check the payload's mass (kg), the unit of the currents, and 'limits: effort' in the robot file",
        )
    return tuple(found)


def check_payloads(verdicts: Sequence[Verdict], payloads: Mapping[str, Verdict]) -> tuple[Verdict, ...]:
    """Judge gains that rest on a known payload whose own verdict is contradictory."""
    wrong = [name for name, each in payloads.items() if each.outcome == Outcome.CONTRADICTORY]
    if not wrong:
        return tuple(verdicts)
    found = Verdict(
        Outcome.CONTRADICTORY, f"it rests on payload '{wrong[0]}', which contradicts the data", "correct the payload"
    )
    return tuple(each if each.outcome == Outcome.CONTRADICTORY else found for each in verdicts)


def share_doubts(verdicts: Sequence[Verdict], joints: Sequence[str]) -> tuple[Verdict, ...]:
    """Judge the others where no gain is good beside a contradictory one: all joints share one model's parameters."""
    wrong = [joint for joint, each in zip(joints, verdicts, strict=True) if each.outcome == Outcome.CONTRADICTORY]
    if not wrong:
        return tuple(verdicts)
    doubt = Verdict(
        Outcome.WEAK, f"joint '{wrong[0]}' contradicts the model that they share", "resolve that joint first"
    )
    return tuple(doubt if each.outcome == Outcome.GOOD else each for each in verdicts)
