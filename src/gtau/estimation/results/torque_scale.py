"""Test the scale of the torques that a robot reports: the gains of logs of torques, and their correction as YAML.

The gain of such a joint is its torque scale, the true torque over the reported one; the reported share of the torque is
its inverse.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import yaml

from gtau.estimation.diagnostics.verdict import APART
from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.result import IdentifiedModel
from gtau.findings import Grade
from gtau.findings.words import percent_text

KNOWN = (Grade.GOOD, Grade.WEAK)
SCALE_UNTESTED = "torque scale not tested"
HEAD = """\
# Torque scale of '{robot}', identified by gtau from {runs}.
# true torque = factor x reported torque; a command for a wanted torque is the torque divided by the factor.
# Correct the factors whose state is 'wrong'; leave the others at 1. Intervals: 95 %. Docs: torque-scale.md
"""


@dataclass(frozen=True)
class TorqueScale:
    """The torque scale of a joint, and whether it is wrong: known, and not 1.

    ``state`` is ``wrong``, ``consistent with 1`` or ``undecided``, ``in doubt`` beside a contradiction, else the
    verdict's outcome.
    """

    gain: Estimate
    state: str

    @property
    def joint(self) -> str:
        """Its name."""
        return self.gain.name

    @property
    def reported(self) -> float:
        """Share of its torque that the joint reports."""
        return 1 / (self.gain.value or 1.0)

    @property
    def reported_interval(self) -> tuple[float, float]:
        """Ends of its 95 % interval, of an identifiable scale."""
        low, high = sorted(1 / end for end in self.gain.interval() or (1.0, 1.0))
        return low, high


def torque_scales(result: IdentifiedModel) -> tuple[TorqueScale, ...]:
    """List the torque scales of all joints; empty where logs hold currents, or nothing tests the torques.

    A scale is wrong where it differs from 1 by more than the required accuracy, and by 3.5 standard deviations: of many
    joints some are outside their 95 % interval by chance, and these are undecided.
    """
    gains = list(result.drive_gains.values())
    if result.kind != "torque" or all(gain.std is None for gain in gains):
        return ()
    accuracy = result.statistics["accuracy"]

    def state(gain: Estimate) -> str:
        if gain.verdict.outcome not in KNOWN or gain.value is None:
            return gain.verdict.outcome.value
        if not result.believable:
            return "in doubt"
        off = abs(gain.value - 1)
        if off > max(APART * (gain.std or 0.0), accuracy):
            return "wrong"
        return "consistent with 1" if off <= (gain.half_interval() or 0.0) else "undecided"

    return tuple(TorqueScale(gain, state(gain)) for gain in gains)


def torque_headline(result: IdentifiedModel) -> str:
    """Summarise the torque scale of each joint, or say that it was not tested and how to test it."""
    if not (scales := torque_scales(result)):
        if any(gain.value != 1 for gain in result.drive_gains.values()):
            return "The torque scales were given, not identified."
        if why := next((note.what for note in result.notes if note.kind == SCALE_UNTESTED), ""):
            return f"{why[0].upper()}{why[1:]}."
        return (
            "The logged torques are assumed to be correct: their scale was not tested. To test it, log one run with a "
            "payload of known mass and one without."
        )
    by_state: dict[str, list[TorqueScale]] = {}
    for scale in scales:
        by_state.setdefault(scale.state, []).append(scale)
    sentences, wrong, right = [], by_state.get("wrong", []), by_state.get("consistent with 1", [])
    if wrong:
        parts = [f"{_reported(scale)}{' of the torque' * (k == 0)} at '{scale.joint}'" for k, scale in enumerate(wrong)]
        sentences.append(f"The arm reports {enumerated(parts)} (95 % intervals).")
    if right:
        widest = percent_text(max(scale.gain.half_width or 0.0 for scale in right))
        known = f"consistent with 1, known to within {widest} %{'' if wrong else ' (95 % intervals)'}"
        sentences.append(_scales_are(right, known, "all joints" if len(right) == len(scales) > 1 else ""))
    if undecided := by_state.get("undecided"):
        one = len(undecided) == 1
        outside = f"1 is outside {'its 95 % interval' if one else 'their 95 % intervals'}, but by too little to correct"
        sentences.append(_scales_are(undecided, f"undecided: {outside} {'it' if one else 'them'}"))
    for state in ("in doubt", Grade.NOT_IDENTIFIABLE.value):
        if members := by_state.get(state):
            sentences.append(_scales_are(members, state))
    return " ".join(sentences)


def _scales_are(members: Sequence[TorqueScale], state: str, called: str = "") -> str:
    names = called or enumerated([f"'{scale.joint}'" for scale in members])
    return (
        f"The torque scale{'s' if len(members) > 1 else ''} of {names} {'are' if len(members) > 1 else 'is'} {state}."
    )


def _reported(scale: TorqueScale) -> str:
    shown = ".2f" if 0.1 <= abs(scale.reported) < 10 else ".3g"
    value, low, high = (f"{end:{shown}}" for end in (scale.reported, *scale.reported_interval))
    return f"{value} ({low} to {high})"


def enumerated(parts: Sequence[str]) -> str:
    """Join parts by commas, and the last by 'and'."""
    return parts[0] if len(parts) == 1 else ", ".join(parts[:-1]) + f" and {parts[-1]}"


def torque_scale_text(result: IdentifiedModel) -> str:
    """Write the correction of the torques as YAML: a factor for each joint, with its interval and state."""
    joints: dict[str, dict[str, object]] = {}
    for scale in torque_scales(result):
        interval = scale.gain.interval() if scale.gain.verdict.outcome in KNOWN else None
        factor, *ends = (float(f"{value:.4g}") for value in (scale.gain.value, *interval)) if interval else (None,)
        joints[scale.joint] = {"factor": factor, "interval": ends or None, "state": scale.state}
    head = HEAD.format(robot=" ".join(result.robot.name.split()), runs=", ".join(result.runs))
    return head + str(yaml.safe_dump({"torque_scale": joints}, sort_keys=False, default_flow_style=None, width=120))
