"""Verdicts: the credibility of an estimate, and the finding that decides it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from gtau.estimation.diagnostics.finding import Finding
from gtau.estimation.diagnostics.finding import FindingKind as F
from gtau.estimation.diagnostics.sentences import advice, reason


class Outcome(StrEnum):
    """Outcomes of judging an estimate, the best first."""

    GIVEN = "given"
    GOOD = "good"
    WEAK = "weak"
    NOT_IDENTIFIABLE = "not identifiable"
    CONTRADICTORY = "contradictory"


@dataclass(frozen=True)
class Verdict:
    """An outcome, and the finding behind it."""

    outcome: Outcome
    finding: Finding | None = None

    @property
    def why(self) -> str:
        """The reason, empty without a finding."""
        return "" if self.finding is None else reason(self.finding)

    @property
    def advice(self) -> str:
        """Advice of the deciding finding."""
        return "" if self.finding is None else advice(self.finding)

    @property
    def sentence(self) -> str:
        """The verdict as one sentence, without its subject."""
        return self.outcome.value + (f": {self.why}; {self.advice}" if self.finding else "")


GIVEN, GOOD = Verdict(Outcome.GIVEN), Verdict(Outcome.GOOD)

OUTCOMES: Mapping[F, Outcome] = {
    # what the whole estimation rests on
    F.NEGATIVE_MASS: Outcome.CONTRADICTORY,
    F.BASE_UNEXPLAINED: Outcome.CONTRADICTORY,
    # a gain that is noise: what it seems to contradict is noise too
    F.TLS_CONFUSED: Outcome.NOT_IDENTIFIABLE,
    # the data against the description of robot and logs
    F.LATE: Outcome.CONTRADICTORY,
    F.ALL_NEGATIVE: Outcome.CONTRADICTORY,
    F.SWAPPED: Outcome.CONTRADICTORY,
    F.REFUTED: Outcome.CONTRADICTORY,
    F.UNEXPLAINED: Outcome.CONTRADICTORY,
    # stated constants against each other
    F.PAYLOAD: Outcome.CONTRADICTORY,
    F.SENSOR: Outcome.CONTRADICTORY,
    F.WHOLE_MASS: Outcome.CONTRADICTORY,
    # a gain without a value: what follows would judge that value
    F.UNSETTLED: Outcome.NOT_IDENTIFIABLE,
    F.LOST: Outcome.NOT_IDENTIFIABLE,
    F.SIGN_OPEN: Outcome.NOT_IDENTIFIABLE,
    F.OTHER_ESTIMATOR: Outcome.CONTRADICTORY,
    F.PRIOR_GAIN: Outcome.CONTRADICTORY,
    F.WIDE_SCALE: Outcome.WEAK,
    F.WIDE_RIPPLE: Outcome.WEAK,
    F.WIDE_CAUSE: Outcome.WEAK,
    F.WIDE_RANDOM: Outcome.WEAK,
    F.COUPLED: Outcome.WEAK,
    F.NEGATIVE_GAIN: Outcome.GOOD,
    # of delays, parameters, payloads and torque sensors
    F.DELAY_NOISE: Outcome.NOT_IDENTIFIABLE,
    F.DELAY_UNCERTAIN: Outcome.WEAK,
    F.IMPOSSIBLE: Outcome.CONTRADICTORY,
    F.INSEPARABLE: Outcome.NOT_IDENTIFIABLE,
    F.NEAR_ZERO: Outcome.NOT_IDENTIFIABLE,
    F.UNCERTAIN: Outcome.WEAK,
    F.PAYLOAD_MASS: Outcome.CONTRADICTORY,
    F.PAYLOAD_PARAMETER: Outcome.CONTRADICTORY,
    F.SENSOR_SCALE: Outcome.CONTRADICTORY,
}
"""The outcome of each kind of finding, in the order in which they count where several are on one estimate."""

RANKS = {kind: rank for rank, kind in enumerate(OUTCOMES)}


def verdict_of(finding: Finding) -> Verdict:
    """Judge an estimate by one finding."""
    return Verdict(OUTCOMES[finding.kind], finding)


def decide(joints: Sequence[str], findings: Iterable[Finding], otherwise: Verdict = GOOD) -> tuple[Verdict, ...]:
    """Judge the gain of each joint by the highest-ranked finding on it, in whatever order the checks found them.

    Of findings of one kind the most severe counts. No gain is good beside a contradictory one, since all joints share
    the parameters of one model.

    Parameters
    ----------
    joints : sequence of str
        Joints of the robot, (n,).
    findings : iterable of Finding
        All findings against gains.
    otherwise : Verdict
        Of a gain without a finding.
    """
    of_joint: dict[str, Finding] = {}
    for each in sorted(findings, key=_precedence):
        for joint in each.joints:
            of_joint.setdefault(joint, each)
    found = {joint: verdict_of(of_joint[joint]) if joint in of_joint else otherwise for joint in joints}
    wrong = next((joint for joint in joints if found[joint].outcome == Outcome.CONTRADICTORY), None)
    if wrong is not None:
        coupled = {joint: verdict_of(Finding(F.COUPLED, (joint,), wrong)) for joint in joints}
        found = {joint: coupled[joint] if each.outcome == Outcome.GOOD else each for joint, each in found.items()}
    return tuple(found.values())


def _precedence(finding: Finding) -> tuple[int, float, str]:
    return RANKS[finding.kind], -finding.severity, repr(finding)


def worst(verdicts: Mapping[str, Verdict] | Sequence[Verdict]) -> Outcome:
    """Return the worst outcome of several."""
    found = list(verdicts.values()) if isinstance(verdicts, Mapping) else list(verdicts)
    order = list(Outcome)
    return max((verdict.outcome for verdict in found), key=order.index, default=Outcome.GOOD)
