"""Examine a fit: the checks in their order, which effect silences which others, and how uncertain the estimates are."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from gtau.estimation.diagnostics.alternatives import Alternative, compete, model_covariance
from gtau.estimation.diagnostics.effort import UNRANKED, Meaning, effort_findings, rank_meanings, stated_meaning
from gtau.estimation.diagnostics.hypotheses import HYPOTHESES, find_alternatives, ranked
from gtau.estimation.diagnostics.hypotheses.description import GRAVITY, WRENCH_OFFSETS, WRENCH_POINTS
from gtau.estimation.diagnostics.hypotheses.drives import GAIN_CHANGE, gain_changes
from gtau.estimation.diagnostics.log_checks import frozen_encoders, gravity_not_shown, lack_of_fit
from gtau.estimation.diagnostics.other_estimators import ESTIMATORS, other_estimators, two_stage_difference
from gtau.estimation.diagnostics.other_robots import (
    LENGTHS,
    TOOL_BODIES,
    gravity_asked_for,
    likelier_gravity,
    missing_gravity,
    other_gravity,
    other_length,
    other_loads,
)
from gtau.estimation.diagnostics.repeating_residuals import RIPPLE, position_ripple
from gtau.estimation.diagnostics.stated_constants import scale_uncertainty
from gtau.estimation.diagnostics.verdict import unexplained_shares
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.newton import degrees_of_freedom
from gtau.estimation.regression.problem import Estimates
from gtau.estimation.regression.run_blocks import WINDOWS, usable_rows
from gtau.estimation.thresholds.estimates import (
    DIFFERENT_PROBABILITY,
    DOMINANT,
    FEWEST_FOR_TESTS,
    GRAVITY_MISFIT,
    LACKING,
    OF_BEST,
    OF_REPEATING,
    PROBABLE,
    REFUTED_SHARE,
)
from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.progress import Progress, silent

DESCRIPTION = {hypothesis.name for hypothesis in HYPOTHESES if hypothesis.description} | {
    GAIN_CHANGE, LENGTHS, TOOL_BODIES
}  # fmt: skip
"""Hypotheses that contradict the user's description of robot and logs."""
WRENCHES = {WRENCH_OFFSETS.name, WRENCH_POINTS.name}


@dataclass(frozen=True, eq=False)
class Examination:
    """Evidence of the data against a fit.

    Attributes
    ----------
    lack_of_fit : float
        Standard deviations by the jackknife over those for independent residuals.
    alternatives : tuple of Alternative
        All that were tried.
    findings : tuple of Finding
        What the columns of some joints hold instead of their currents or torques, frozen encoders, a torque that
        repeats at the same positions, and tests that refused these data or have no power on them.
    effort : tuple of Meaning
        What the columns of all joints may hold, the most likely first.
    ripple : Alternative, optional
        What of the residuals repeats at the same positions.
    """

    lack_of_fit: float
    alternatives: tuple[Alternative, ...] = ()
    findings: tuple[Finding, ...] = ()
    effort: tuple[Meaning, ...] = UNRANKED
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
        held = [effect for effect in self.alternatives if effect.probability > PROBABLE and effect.significant]
        of_physics: dict[str, float] = {}
        for effect in held:
            if effect.hypothesis not in DESCRIPTION:
                of_physics[effect.hypothesis] = of_physics.get(effect.hypothesis, 0.0) + effect.share
        stated = [effect for effect in held if effect.hypothesis in DESCRIPTION]
        of_stated = OF_BEST * max((effect.share for effect in stated), default=0.0)
        of_ripple = OF_REPEATING * (0.0 if self.ripple is None else self.ripple.share)
        least = max([REFUTED_SHARE, of_ripple, of_stated, *of_physics.values()])
        return tuple(sorted((effect for effect in stated if effect.share > least), key=lambda effect: -effect.share))


@dataclass(frozen=True, eq=False)
class Check:
    """A test of a fit, with what it silences.

    Attributes
    ----------
    name : str
        By which other checks silence it.
    test : callable
        Yields findings and alternatives, from a fit, what was found before, and the progress.
    silences : frozenset of str
        Checks that are not made, and hypotheses and kinds of findings that do not count, where it finds something: it
        explains what they would find.
    least : float
        Share of the residual variance from which on an alternative of it silences them.
    """

    name: str
    test: Callable[[Fit, Examination, Progress], Iterable[Finding | Alternative]]
    silences: frozenset[str] = frozenset()
    least: float = -np.inf


def _lacking(fit: Fit) -> bool:
    return lack_of_fit(fit.system.problem, fit.solution) > LACKING


def _loads(fit: Fit, seen: Examination, progress: Progress) -> Iterator[Alternative]:
    misfit = float(unexplained_shares(fit.system.problem, fit.solution).max())
    if (_lacking(fit) or misfit > GRAVITY_MISFIT) and (loads := other_loads(fit)):
        yield loads


def _gravity(fit: Fit, seen: Examination, progress: Progress) -> Iterator[Alternative]:
    missing = missing_gravity(fit) if seen.effort[0].kind == F.WITHOUT_GRAVITY else None
    asked = _lacking(fit) and gravity_asked_for(fit, seen.alternatives)
    if gravity := likelier_gravity(fit, missing, other_gravity(fit, progress) if asked else None):
        yield gravity


def _gravity_not_shown(fit: Fit, seen: Examination, progress: Progress) -> Iterator[Finding]:
    if stated_meaning(seen.effort).values.get("open"):
        yield from gravity_not_shown(fit)


def _lengths(fit: Fit, seen: Examination, progress: Progress) -> Iterator[Alternative]:
    if _lacking(fit) and (length := other_length(fit, progress)):
        yield length


def _ripple(fit: Fit, seen: Examination, progress: Progress) -> Iterator[Alternative]:
    if _lacking(fit):
        yield position_ripple(fit)


OTHER_GRAVITY, GRAVITY_NOT_SHOWN, EFFORT, FROZEN = "other gravity", "gravity not shown", "effort", "frozen encoders"
OF_EFFORT = {F.LATE, F.SWAPPED, F.MAGNITUDES, F.REVERSED}
CHECKS: tuple[Check, ...] = (
    Check("hypotheses", lambda fit, seen, progress: find_alternatives(fit)),
    Check("other estimators", lambda fit, seen, progress: other_estimators(fit)),
    Check("two-stage least squares", lambda fit, seen, progress: two_stage_difference(fit)),
    # see the evidence of DOMINANT
    Check(GAIN_CHANGE, lambda fit, seen, progress: gain_changes(fit), frozenset({RIPPLE}), DOMINANT),
    # what the columns hold instead explains the residuals
    Check(
        EFFORT,
        lambda fit, seen, progress: effort_findings(seen.effort, fit.dataset),
        frozenset({OTHER_GRAVITY, LENGTHS}),
    ),
    # links that turned unseen look like another body in that run
    Check(FROZEN, lambda fit, seen, progress: frozen_encoders(fit), frozenset({TOOL_BODIES})),
    # what another current in these runs, say, would explain is its effect
    Check(
        TOOL_BODIES, _loads, frozenset({*DESCRIPTION, *OF_EFFORT, OTHER_GRAVITY, GRAVITY_NOT_SHOWN, LENGTHS, RIPPLE})
    ),
    # what a few degrees, other lengths or ripple would explain is its effect
    Check(OTHER_GRAVITY, _gravity, frozenset({GRAVITY.name, GRAVITY_NOT_SHOWN, LENGTHS, RIPPLE})),
    Check(GRAVITY_NOT_SHOWN, _gravity_not_shown),
    Check(LENGTHS, _lengths),
    Check(RIPPLE, _ripple),
)
"""All checks, in the order in which they are made; the comment of each is why what it finds silences others."""
LIKE_WRENCHES = {GAIN_CHANGE, LENGTHS}
"""Effects that seem to be there where a wrench is wrong, and count if they explain ``OF_BEST`` of what that does."""


def examine(fit: Fit, progress: Progress = silent) -> Examination:
    """Make all checks of a fit; ``progress`` is called as the work goes on."""
    rows, unknowns = usable_rows(fit.dataset.windows(WINDOWS), fit.dataset.prepared), len(fit.solution.values)
    seen = Examination(lack_of_fit(fit.system.problem, fit.solution))
    if rows < FEWEST_FOR_TESTS * unknowns:
        return replace(seen, findings=(Finding(F.FEW_ROWS, values={"rows": rows, "unknowns": unknowns}),))
    seen = replace(seen, effort=rank_meanings(fit.dataset, fit.system.problem.slowest))
    silenced: set[str] = set()
    for check in CHECKS:
        if check.name not in silenced:
            evidence = list(check.test(fit, seen, progress))
            findings = [item for item in evidence if isinstance(item, Finding)]
            alternatives = [item for item in evidence if isinstance(item, Alternative)]
            if findings or any(item.share > check.least for item in alternatives):
                silenced |= check.silences
                seen = replace(
                    seen,
                    findings=tuple(item for item in seen.findings if item.kind not in check.silences),
                    alternatives=tuple(item for item in seen.alternatives if item.hypothesis not in check.silences),
                )
            seen = replace(seen, findings=(*seen.findings, *findings), alternatives=(*seen.alternatives, *alternatives))
    return _weighed(seen)


def _weighed(seen: Examination) -> Examination:
    """Assign probabilities to all alternatives together; other estimators compete for each estimate, and come last."""
    of_wrenches = [effect.share for effect in seen.alternatives if effect.hypothesis in WRENCHES and effect.significant]
    least = OF_BEST * max(of_wrenches, default=0.0)  # lengths and single currents look wrong too
    models = [
        effect
        for effect in seen.alternatives
        if effect.hypothesis not in {*ESTIMATORS, RIPPLE}
        and (effect.hypothesis not in LIKE_WRENCHES or effect.share > least)
    ]
    estimators = compete(
        [effect for effect in seen.alternatives if effect.hypothesis in ESTIMATORS],
        lambda effect: (effect.causes[0].joints, effect.causes[0].subject),
    )
    listed = [
        effect for effect in estimators if any(effect.moves.values()) or effect.probability > DIFFERENT_PROBABILITY
    ]
    ripple = next((effect for effect in seen.alternatives if effect.hypothesis == RIPPLE), None)
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
    parts = (solution.jackknife, of_scale, examined.covariance(fit))
    return Estimates(problem.unknowns, solution.values, *parts, freedom)
