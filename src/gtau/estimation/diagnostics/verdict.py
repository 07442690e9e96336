"""Verdicts: the credibility of an estimate, and the finding that decides it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from gtau.estimation.diagnostics.hypotheses import HYPOTHESES
from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.findings import Outcome as Outcome  # which verdicts have
from gtau.findings.finding import WORDS


@dataclass(frozen=True)
class Verdict:
    """An outcome, and the finding behind it."""

    outcome: Outcome
    finding: Finding | None = None

    @property
    def why(self) -> str:
        """The reason, empty without a finding."""
        return "" if self.finding is None else self.finding.what

    @property
    def advice(self) -> str:
        """Advice of the deciding finding."""
        return "" if self.finding is None else self.finding.action

    @property
    def sentence(self) -> str:
        """The verdict as one sentence, without its subject."""
        return self.outcome.value + (f": {self.why}; {self.advice}" if self.finding else "")


WORDS.update({cause.kind: cause.words for hypothesis in HYPOTHESES for cause in hypothesis.causes})
GIVEN, GOOD = Verdict(Outcome.GIVEN), Verdict(Outcome.GOOD)

OUTCOMES: Mapping[str, Outcome] = {kind: kind.outcome for kind in F if kind.outcome}
ALONE = frozenset({F.NEGATIVE_GAIN, F.GAINS_APART, F.LARGE_CURRENT})
"""Factors of one joint's channel, which its gain takes up whole: those of the other joints stay as they are."""
RANKS: Mapping[str, int] = {kind: rank for rank, kind in enumerate(OUTCOMES)}


def verdict_of(finding: Finding) -> Verdict:
    """Judge an estimate by one finding."""
    return Verdict(OUTCOMES[finding.kind], finding)


def decide(joints: Sequence[str], findings: Iterable[Finding], otherwise: Verdict = GOOD) -> tuple[Verdict, ...]:
    """Judge the gain of each joint by the highest-ranked finding on it, in whatever order the checks found them.

    Of findings of one kind the most severe counts. No gain is good beside a contradictory one, since all joints share
    the parameters of one model, but for what concerns the channel of one joint alone.

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
    wrong = next((joint for joint in joints if couples(found[joint])), None)
    if wrong is not None:
        coupled = {joint: verdict_of(Finding(F.COUPLED, (joint,), wrong)) for joint in joints}
        found = {joint: coupled[joint] if each.outcome == Outcome.GOOD else each for joint, each in found.items()}
    return tuple(found.values())


def couples(verdict: Verdict) -> bool:
    """Decide whether a verdict on a joint's gain puts those of the others in doubt."""
    kind = None if verdict.finding is None else verdict.finding.kind
    return verdict.outcome == Outcome.CONTRADICTORY and kind not in ALONE


def _precedence(finding: Finding) -> tuple[int, float, str]:
    return RANKS[finding.kind], -finding.size, repr(finding)


def worst(verdicts: Mapping[str, Verdict] | Sequence[Verdict]) -> Outcome:
    """Return the worst outcome of several."""
    found = list(verdicts.values()) if isinstance(verdicts, Mapping) else list(verdicts)
    order = list(Outcome)
    return max((verdict.outcome for verdict in found), key=order.index, default=Outcome.GOOD)
