"""Verdicts: the credibility of an estimate, and the finding that decides it; of gains that which counts most."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gtau.estimation.estimators.estimator import Fit, Solution
from gtau.estimation.regression.problem import Estimates, Problem
from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.findings import Outcome as Outcome  # which verdicts have
from gtau.robots.parameter import Parameter

WEAK_PARAMETER = 0.2  # relative standard deviation of a parameter
NEGATIVE_STD = 4.0  # standard deviations below zero of a parameter that cannot be negative
DELAY_STD = 0.25  # relative standard deviation of a delay longer than a sample that is believed
APART = 3.5  # standard deviations between a declared value of a payload and what all else gives


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


GIVEN, GOOD = Verdict(Outcome.GIVEN), Verdict(Outcome.GOOD)
NONNEGATIVE = {"m", "xx", "yy", "zz", "ia", "fv", "fs"}
OUTCOMES: Mapping[str, Outcome] = {kind: kind.outcome for kind in F if kind.outcome}
"""Kinds with an outcome, in the order in which they count where several are on one estimate."""
ALONE = frozenset({F.NEGATIVE_GAIN, F.GAINS_APART, F.LARGE_CURRENT})
"""Factors of one joint's channel, which its gain takes up whole: those of the other joints stay as they are."""


def verdict_of(finding: Finding) -> Verdict:
    """Judge an estimate by one finding."""
    return Verdict(OUTCOMES[finding.kind] if finding.grade is None else Outcome(finding.grade), finding)


def decide(joints: Sequence[str], findings: Iterable[Finding], otherwise: Verdict = GOOD) -> dict[str, Verdict]:
    """Judge the gain of each joint by the highest-ranked finding on it, in whatever order the checks found them.

    Of findings of one kind that of the largest size counts. No gain is good beside a contradictory one, since all
    joints share the parameters of one model, but for what concerns the channel of one joint alone. A gain without a
    finding is judged as ``otherwise``.
    """
    verdicts, rank = dict.fromkeys(joints, otherwise), list(OUTCOMES).index
    against = [finding for finding in findings if finding.kind in OUTCOMES]
    against.sort(key=lambda finding: (rank(finding.kind), -finding.size, repr(finding)))
    for finding in reversed(against):  # the one that counts most comes last
        verdicts |= dict.fromkeys(verdicts.keys() & finding.joints, verdict_of(finding))
    for joint, verdict in verdicts.items():
        if verdict.finding and verdict.outcome == Outcome.CONTRADICTORY and verdict.finding.kind not in ALONE:
            good = [name for name in joints if verdicts[name].outcome == Outcome.GOOD]
            return verdicts | {name: verdict_of(Finding(F.COUPLED, (name,), joint)) for name in good}
    return verdicts


def worst(verdicts: Iterable[Verdict]) -> Outcome:
    """Return the worst outcome of several."""
    return max((verdict.outcome for verdict in verdicts), key=list(Outcome).index, default=Outcome.GOOD)


def parameter_verdict(value: float | None, std: float | None) -> Verdict:
    """Judge a parameter by its value and standard deviation."""
    if value is None:
        return verdict_of(Finding(F.INSEPARABLE))
    if std is None:
        return GOOD
    if abs(value) < 2 * std:
        return verdict_of(Finding(F.NEAR_ZERO))
    if std > WEAK_PARAMETER * abs(value):
        return verdict_of(Finding(F.UNCERTAIN, values={"std": std / abs(value)}))
    return GOOD


def judge_parameter(value: float | None, std: float | None, terms: Mapping[Parameter, float]) -> Verdict:
    """Judge a base parameter from its value, standard deviation, and the ``terms`` that it regroups."""
    if value is None or not std or value >= -NEGATIVE_STD * std or not cannot_be_negative(terms):
        return parameter_verdict(value, std)
    friction = next(iter(terms)).kind in ("fv", "fs")
    return verdict_of(Finding(F.IMPOSSIBLE, values={"t": -value / std, "friction": friction}))


def cannot_be_negative(terms: Mapping[Parameter, float]) -> bool:
    """Decide from its terms whether a base parameter is a sum of masses, moments of inertia or friction."""
    return all(factor > 0 and name.kind in NONNEGATIVE for name, factor in terms.items())


def known_verdict(values: Mapping[str, Any], explained: tuple[str, ...] = ()) -> Verdict:
    """Judge a known value of a payload by its estimate from the other known constants and the data.

    ``values`` are the ``parameter``, its ``declared`` value and the one ``found``, with its ``std`` and ``unit``, the
    kind of the commands where gains are ``given``, and what the value that is found ``remains`` of the residual
    variance, the geometric mean of all channels; ``explained`` the joints whose torque only the declared value leaves
    unexplained.
    """
    size = abs(values["found"] - values["declared"]) / values["std"]
    if size <= APART:
        return GOOD
    kind = F.PAYLOAD_MASS if values["parameter"] == "m" else F.PAYLOAD_PARAMETER
    return verdict_of(Finding(kind, explained, values=values, size=size))


def delay_verdicts(problem: Problem, solution: Solution, std: np.ndarray, period: float) -> list[Verdict]:
    """Judge the delay of every channel, of the joints' currents and of torque sensors, by its ``std`` (c,), s.

    A delay lost in noise was not estimated. One within the ``period`` of the samples, s, is believed whatever its
    relative standard deviation.
    """
    size = np.abs(solution.delays)
    uncertain = (size > period) & (std > DELAY_STD * size)
    return [
        verdict_of(Finding(F.DELAY_NOISE))
        if not longest
        else verdict_of(Finding(F.DELAY_UNCERTAIN, values={"std": float(std[k])}))
        if uncertain[k]
        else GOOD
        for k, longest in enumerate(problem.longest_delays)
    ]


def unexplained_shares(problem: Problem, solution: Solution) -> np.ndarray:
    """Compute the share of each channel's current or torque that the model leaves unexplained, rms, (c,)."""
    return np.asarray(solution.sigma / problem.balance(solution.theta))


def half_widths(fit: Fit, estimates: Estimates) -> np.ndarray:
    """Compute half the relative widths of the gains' 95 % intervals, (n,)."""
    from scipy.special import ndtri, stdtrit

    rows, freedom = fit.system.problem.gain_rows, estimates.effective_freedom
    std = np.sqrt(np.diag(estimates.covariance)[rows]) / np.abs(estimates.values[rows])
    return np.asarray(std * (ndtri(0.975) if freedom is None else stdtrit(freedom[rows], 0.975)))


def motors(fit: Fit) -> tuple[str, ...]:
    """List the joints whose gains are judged: all but those of a floating base."""
    return tuple(channel.joint for channel in fit.system.problem.channels if channel.kind.unknown_gain)
