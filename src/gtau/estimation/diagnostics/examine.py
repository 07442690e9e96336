"""Examine a fit: the checks in their order, which effect silences which others, and how uncertain the estimates are."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Set
from dataclasses import dataclass, replace

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.alternatives import (
    GAIN_CHANGE,
    LENGTHS,
    RIPPLE,
    TOOL_BODIES,
    Alternative,
    compete,
    model_covariance,
)
from gtau.estimation.diagnostics.effort import UNRANKED, effort_findings, rank_meanings, stated_meaning
from gtau.estimation.diagnostics.hypotheses import HYPOTHESES, find_alternatives, ranked
from gtau.estimation.diagnostics.hypotheses.description import GRAVITY, WRENCH_OFFSETS, WRENCH_POINTS
from gtau.estimation.diagnostics.hypotheses.drives import gain_changes
from gtau.estimation.diagnostics.log_checks import frozen_encoders, gravity_not_shown, lack_of_fit
from gtau.estimation.diagnostics.other_estimators import ESTIMATORS, other_estimators, two_stage_difference
from gtau.estimation.diagnostics.other_robots import likeliest_gravity, other_body, other_length, other_loads
from gtau.estimation.diagnostics.repeating_residuals import SPRINGS, position_ripple, springs
from gtau.estimation.diagnostics.stated_constants import scale_uncertainty
from gtau.estimation.diagnostics.verdict import unexplained_shares
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.newton import degrees_of_freedom
from gtau.estimation.regression.problem import Estimates
from gtau.estimation.regression.run_blocks import WINDOWS, usable_rows
from gtau.estimation.thresholds.estimates import FEWEST_FOR_TESTS, LACKING
from gtau.estimation.thresholds.refutation import (
    DIFFERENT_PROBABILITY,
    DOMINANT,
    GRAVITY_MISFIT,
    OF_BEST,
    OF_REPEATING,
    PROBABLE,
    REFUTED_SHARE,
)
from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.progress import Progress, silent

OF_HYPOTHESES = {hypothesis.name for hypothesis in HYPOTHESES if hypothesis.description}
DESCRIPTION = OF_HYPOTHESES | {GAIN_CHANGE, LENGTHS, TOOL_BODIES}
"""Alternatives that contradict the user's description of robot and logs."""
WRENCHES = {WRENCH_OFFSETS.name, WRENCH_POINTS.name}


@dataclass(frozen=True, eq=False)
class Examination:
    """Evidence of the data against a fit.

    Attributes
    ----------
    alternatives : tuple of Alternative
        All that were tried.
    findings : tuple of Finding
        What the columns of some joints hold instead of their currents or torques, frozen encoders, and tests that
        refused these data or have no power on them.
    effort : tuple of Finding
        What the columns of all joints may hold, the most likely first.
    ripple : Alternative, optional
        What of the residuals repeats at the same positions.
    """

    alternatives: tuple[Alternative, ...] = ()
    findings: tuple[Finding, ...] = ()
    effort: tuple[Finding, ...] = UNRANKED
    ripple: Alternative | None = None

    def covariance(self, fit: Fit) -> np.ndarray:
        """Compute the covariance of (theta, gains, delays) that model deficits may add, (k, k)."""
        alternatives = self.alternatives if self.ripple is None else (*self.alternatives, self.ripple)
        return model_covariance(alternatives, len(fit.solution.values))

    @property
    def refuted(self) -> tuple[Alternative, ...]:
        """Alternatives that contradict the description and that the data support, the best supported first.

        Each is tried alone, so what a lag of the currents leaves, say, goes in part with gravity, with lengths and with
        currents that change: none of these refutes the description unless it explains more than the lag of all joints.
        So does what repeats at the same positions, cables or ripple: a wrong description would explain most of that.
        """
        stated, of_physics = [], Counter[str]()
        for effect in self.alternatives:
            if effect.probability <= PROBABLE or not effect.significant:
                continue
            if effect.hypothesis in DESCRIPTION:
                stated.append(effect)
            else:
                of_physics[effect.hypothesis] += effect.share  # type: ignore[assignment]
        stated.sort(key=lambda effect: -effect.share)
        of_stated = OF_BEST * stated[0].share if stated else 0.0
        of_ripple = OF_REPEATING * self.ripple.share if self.ripple else 0.0
        least = max(REFUTED_SHARE, of_ripple, of_stated, *of_physics.values())
        return tuple(effect for effect in stated if effect.share > least)


def _lacking(fit: Fit) -> bool:
    return lack_of_fit(fit.system.problem, fit.solution) > LACKING


def _misfit(fit: Fit) -> bool:
    return float(unexplained_shares(fit.system.problem, fit.solution).max()) > GRAVITY_MISFIT


def _loads(fit: Fit, seen: Examination, progress: Progress) -> Iterator[Alternative]:
    if (_lacking(fit) or _misfit(fit)) and (loads := other_loads(fit) or other_body(fit)):
        yield loads


def _gravity(fit: Fit, seen: Examination, progress: Progress) -> Iterator[Alternative]:
    """Fit with another gravity (seconds per fit) where a tilt helps, or the residual is large."""
    missing = seen.effort[0].kind == F.WITHOUT_GRAVITY
    tilted = any(effect.hypothesis == GRAVITY.name and effect.share > REFUTED_SHARE for effect in seen.alternatives)
    turned = _lacking(fit) and (tilted or _misfit(fit))
    if (missing or turned) and (gravity := likeliest_gravity(fit, missing, turned, progress)):
        yield gravity


def _gravity_not_shown(fit: Fit, seen: Examination, progress: Progress) -> Iterator[Finding]:
    if stated_meaning(seen.effort).values.get("open"):
        yield from gravity_not_shown(fit)


def _lengths(fit: Fit, seen: Examination, progress: Progress) -> Iterator[Alternative]:
    if _lacking(fit) and (length := other_length(fit, progress)):
        yield length


def _springs(fit: Fit, seen: Examination, progress: Progress) -> Iterator[Finding]:
    if _lacking(fit):
        yield from springs(fit, seen.alternatives)


def _ripple(fit: Fit, seen: Examination, progress: Progress) -> Iterator[Alternative]:
    # see the evidence of DOMINANT
    changes = any(effect.hypothesis == GAIN_CHANGE and effect.share > DOMINANT for effect in seen.alternatives)
    if _lacking(fit) and not changes:
        yield position_ripple(fit)


OTHER_GRAVITY, GRAVITY_NOT_SHOWN, EFFORT, FROZEN = "other gravity", "gravity not shown", "effort", "frozen encoders"
OF_EFFORT = {F.LATE, F.SWAPPED, F.MAGNITUDES, F.REVERSED}
CHECKS: Mapping[str, Callable[[Fit, Examination, Progress], Iterable[Finding | Alternative]]] = {
    "hypotheses": lambda fit, seen, progress: find_alternatives(fit),
    "other estimators": lambda fit, seen, progress: other_estimators(fit),
    "two-stage least squares": lambda fit, seen, progress: two_stage_difference(fit),
    GAIN_CHANGE: lambda fit, seen, progress: gain_changes(fit),
    EFFORT: lambda fit, seen, progress: effort_findings(seen.effort, fit.dataset),
    FROZEN: lambda fit, seen, progress: frozen_encoders(fit),
    TOOL_BODIES: _loads,
    OTHER_GRAVITY: _gravity,
    GRAVITY_NOT_SHOWN: _gravity_not_shown,
    LENGTHS: _lengths,
    SPRINGS.name: _springs,
    RIPPLE: _ripple,
}
"""All checks, in the order in which they are made: of a fit, what was found before, and the progress."""
SILENCES: Mapping[str, Set[str]] = {
    # what the columns hold instead explains the residuals
    EFFORT: {OTHER_GRAVITY, LENGTHS},
    # links that turned unseen look like another body in that run
    FROZEN: {TOOL_BODIES},
    # what another current in these runs, say, would explain is its effect
    TOOL_BODIES: {*DESCRIPTION, *OF_EFFORT, OTHER_GRAVITY, GRAVITY_NOT_SHOWN, LENGTHS, RIPPLE},
    # what a few degrees, other lengths or ripple would explain is its effect
    OTHER_GRAVITY: {GRAVITY.name, GRAVITY_NOT_SHOWN, LENGTHS, RIPPLE},
}
"""What a check silences where it finds something, as that explains what they would find: checks that are then not made,
and hypotheses and kinds of findings that do not count."""
OF_INTERVALS = ("hypotheses", "other estimators", "two-stage least squares")
"""Those that widen the intervals of a fit of which nothing is wrong."""
LIKE_WRENCHES = {GAIN_CHANGE, LENGTHS}
"""Effects that seem to be there where a wrench is wrong, and count if they explain ``OF_BEST`` of what that does."""


def examine(fit: Fit, progress: Progress = silent, checks: Iterable[str] = CHECKS) -> Examination:
    """Make the ``checks`` of a fit; ``progress`` is called as the work goes on."""
    rows, unknowns = usable_rows(fit.dataset.windows(WINDOWS), fit.dataset.prepared), len(fit.solution.values)
    if rows < FEWEST_FOR_TESTS * unknowns:
        return Examination(findings=(Finding(F.FEW_ROWS, values={"rows": rows, "unknowns": unknowns}),))
    findings: list[Finding] = []
    alternatives: list[Alternative] = []
    effort = rank_meanings(fit.dataset, fit.system.unreduced.longest_delays.max())
    silenced: Set[str] = set()
    for name in checks:
        if name in silenced:
            continue
        try:
            evidence = list(CHECKS[name](fit, Examination(tuple(alternatives), tuple(findings), effort), progress))
        except GtauError as refusal:
            findings.append(Finding(F.UNTESTED, values={"check": name, "refusal": str(refusal).removesuffix(".")}))
            continue
        if evidence and (silent_now := SILENCES.get(name)):
            silenced |= silent_now
            findings = [item for item in findings if item.kind not in silent_now]
            alternatives = [item for item in alternatives if item.hypothesis not in silent_now]
        findings += [item for item in evidence if isinstance(item, Finding)]
        alternatives += [item for item in evidence if isinstance(item, Alternative)]
    return weighed(Examination(tuple(alternatives), tuple(findings), effort))


def weighed(seen: Examination) -> Examination:
    """Assign probabilities to all alternatives together; other estimators compete for each estimate, and come last."""
    of_wrenches = [effect.share for effect in seen.alternatives if effect.hypothesis in WRENCHES and effect.significant]
    least = OF_BEST * max(of_wrenches, default=0.0)  # lengths and single currents look wrong too
    models, estimators, ripple = [], [], None
    for effect in seen.alternatives:
        if effect.hypothesis == RIPPLE:
            ripple = effect
        elif effect.hypothesis in ESTIMATORS:
            estimators.append(effect)
        elif effect.hypothesis not in LIKE_WRENCHES or effect.share > least:
            models.append(effect)
    others = compete(estimators, lambda effect: (effect.causes[0].joints, effect.causes[0].subject))
    listed = [effect for effect in others if any(effect.moves.values()) or effect.probability > DIFFERENT_PROBABILITY]
    return replace(seen, alternatives=(*ranked(models), *listed), ripple=ripple)


def estimates_of(fit: Fit, examined: Examination, correlated: bool) -> Estimates:
    """Collect the estimates of a fit with their covariance.

    That is by the block jackknife and with the model part, or by the method's formula alone, as the paper does.
    """
    problem, solution = fit.system.problem, fit.solution
    of_scale = scale_uncertainty(fit.system, fit.solve)
    if not correlated:
        parts = (solution.covariance, of_scale, np.zeros_like(of_scale))
        return Estimates(problem.unknowns, solution.values, *parts, None)
    freedom = degrees_of_freedom(problem, solution, fit.free_gains)
    of_file = solution.of_prior if fit.dataset.scaled_by_file else 0.0
    parts = (solution.jackknife - of_file, of_scale + of_file, examined.covariance(fit))
    return Estimates(problem.unknowns, solution.values, *parts, freedom)
