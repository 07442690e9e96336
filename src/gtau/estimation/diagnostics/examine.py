"""Examine a fit: all alternatives tried, what they refute, and how uncertain the estimates are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gtau.estimation.diagnostics.alternatives import Alternative, compete, model_covariance
from gtau.estimation.diagnostics.effort import UNRANKED, Ranking, rank_meanings
from gtau.estimation.diagnostics.hypotheses import HYPOTHESES
from gtau.estimation.diagnostics.hypotheses.description import GRAVITY, WRENCH_OFFSETS, WRENCH_POINTS
from gtau.estimation.diagnostics.hypotheses.drives import gain_changes
from gtau.estimation.diagnostics.linearisation import central_windows, usable_rows
from gtau.estimation.diagnostics.log_checks import frozen_encoders, lack_of_fit
from gtau.estimation.diagnostics.other_estimators import (
    alternatives_of,
    other_estimators,
    two_stage_difference,
)
from gtau.estimation.diagnostics.other_robots import (
    gravity_asked_for,
    gravity_not_shown,
    likelier_gravity,
    missing_gravity,
    other_gravity,
    other_length,
    other_loads,
)
from gtau.estimation.diagnostics.parameter_checks import unexplained_shares
from gtau.estimation.diagnostics.repeating_residuals import PositionRipple, position_ripple
from gtau.estimation.diagnostics.score_test import WINDOWS, find_alternatives
from gtau.estimation.diagnostics.stated_constants import scale_uncertainty
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.newton import degrees_of_freedom
from gtau.estimation.regression.unknowns import Estimates
from gtau.estimation.thresholds.estimates import (
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


@dataclass(frozen=True, eq=False)
class Examination:
    """Evidence of the data against a fit.

    Attributes
    ----------
    lack_of_fit : float
        Standard deviations by the jackknife over those for independent residuals.
    alternatives : tuple of Alternative
        All that were tried.
    ripple : PositionRipple
        What of the residuals repeats at the same positions.
    against : tuple of Finding
        What the columns of some joints hold instead of their currents or torques, and frozen encoders.
    untested : tuple of Finding
        Tests that refused these data or have no power on them, and why.
    effort : Ranking
        What the columns of all joints may hold.
    """

    lack_of_fit: float
    alternatives: tuple[Alternative, ...]
    ripple: PositionRipple
    against: tuple[Finding, ...]
    untested: tuple[Finding, ...] = ()
    effort: Ranking = UNRANKED

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of (theta, gains, delays) that model deficits may add, (k, k)."""
        return self.ripple.covariance + model_covariance(self.alternatives, len(self.ripple.moves))

    @property
    def refuted(self) -> tuple[Alternative, ...]:
        """Alternatives that contradict the description and that the data support, the best supported first.

        Each is tried alone, so what a lag of the currents leaves, say, goes in part with gravity, with lengths and with
        currents that change: none of these refutes the description unless it explains more than the lag of all joints.
        So does what repeats at the same positions, cables or ripple: a wrong description would explain most of that.
        """
        held = [each for each in self.alternatives if each.probability > PROBABLE and each.significant]
        of_physics: dict[str, float] = {}
        for each in held:
            if not each.description:
                of_physics[each.hypothesis] = of_physics.get(each.hypothesis, 0.0) + each.share
        repeating = float(np.maximum(self.ripple.shares, 0.0).mean())
        stated = [each for each in held if each.description]
        of_stated = OF_BEST * max((each.share for each in stated), default=0.0)
        least = max([REFUTED_SHARE, OF_REPEATING * repeating, of_stated, *of_physics.values()])
        found = [each for each in stated if each.share > least]
        return tuple(sorted(found, key=lambda each: -each.share))


def examine(fit: Fit, progress: Progress = silent) -> Examination:
    """Try all hypotheses on a fit.

    Parameters
    ----------
    fit : Fit
        What was estimated.
    progress : callable
        Called as the work goes on.
    """
    lack = lack_of_fit(fit.system.problem, fit.solution)
    windows = central_windows(fit.dataset, WINDOWS)
    rows, unknowns = usable_rows(fit.dataset, windows), len(fit.solution.values)
    if rows < FEWEST_FOR_TESTS * unknowns:
        few = Finding(F.FEW_ROWS, values={"rows": rows, "unknowns": unknowns})
        return Examination(lack, (), PositionRipple.none(fit), (), (few,))
    alternatives = list(find_alternatives(fit, HYPOTHESES, windows))
    scaled = False
    (*differences,), untested = other_estimators(fit, windows)
    if fit.free_gains:
        by_two_stage = two_stage_difference(fit)
        if isinstance(by_two_stage, Finding):
            untested = (*untested, by_two_stage)
        else:
            differences.append(by_two_stage)
        changes = gain_changes(fit)
        scaled = any(each.share > DOMINANT for each in changes)
        alternatives += [each for each in changes if each.share > OF_BEST * _most_of_wrenches(alternatives)]
    effort = rank_meanings(fit.dataset, fit.system.problem.slowest)
    against = effort.findings(fit.dataset)  # what the columns hold instead explains the residuals
    misfit = float(unexplained_shares(fit.system.problem, fit.solution).max())
    frozen = frozen_encoders(fit)
    loads = other_loads(fit) if not frozen and (lack > LACKING or misfit > GRAVITY_MISFIT) else None
    if loads:  # what another current in these runs, say, would explain is its effect
        alternatives, against = [*(each for each in alternatives if not each.description), loads], ()
    asked = lack > LACKING and not loads and gravity_asked_for(fit, alternatives)
    missing = missing_gravity(fit) if effort.best == F.WITHOUT_GRAVITY and not loads else None
    turned = likelier_gravity(fit, missing, other_gravity(fit, progress) if asked and not against else None)
    if effort.gravity_open and not turned and not loads:
        untested = (*untested, *gravity_not_shown(fit))
    if turned:  # what a few degrees, other lengths or ripple would explain is its effect
        alternatives = [*(each for each in alternatives if each.hypothesis != GRAVITY.name), turned]
    elif lack > LACKING and not against and not loads:
        length = other_length(fit, progress)
        if length is not None and length.share > OF_BEST * _most_of_wrenches(alternatives):
            alternatives.append(length)
    ripple = PositionRipple.none(fit) if scaled or turned or loads or lack < LACKING else position_ripple(fit)
    weighed = (*compete(alternatives), *alternatives_of(fit, differences))
    return Examination(lack, weighed, ripple, (*against, *frozen), untested, effort)


def _most_of_wrenches(alternatives: Sequence[Alternative]) -> float:
    """Find the largest share that an error of wrenches explains: lengths and single currents then look wrong too."""
    of_wrenches = (WRENCH_OFFSETS.name, WRENCH_POINTS.name)
    return max(
        (each.share for each in alternatives if each.hypothesis in of_wrenches and each.significant), default=0.0
    )


def estimates_of(fit: Fit, examined: Examination, correlated: bool) -> Estimates:
    """Collect the estimates of a fit with their covariance.

    Parameters
    ----------
    fit, examined : Fit, Examination
        What was estimated, and what the model may lack.
    correlated : bool
        By the block jackknife and with the model part, or by the method's formula alone, as the paper does.
    """
    problem, solution = fit.system.problem, fit.solution
    of_scale = scale_uncertainty(fit.dataset, fit.system, fit.solve)
    if not correlated:
        parts = (solution.covariance, of_scale, np.zeros_like(of_scale))
        return Estimates(problem.unknowns, solution.values, *parts, None)
    freedom = degrees_of_freedom(problem, solution, fit.free_gains)
    parts = (solution.jackknife, of_scale, examined.covariance)
    return Estimates(problem.unknowns, solution.values, *parts, freedom)
