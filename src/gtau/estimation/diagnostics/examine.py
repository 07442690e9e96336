"""Examine a fit: the effects beside it, and other descriptions of robot and logs that explain it better."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.effort import GRAVITY_MISFIT, Effort, effort_of
from gtau.estimation.diagnostics.log_checks import frozen_encoders, lack_of_fit
from gtau.estimation.diagnostics.other_clock import other_clock
from gtau.estimation.diagnostics.other_columns import angle_from_another_link, reversed_torques
from gtau.estimation.diagnostics.other_gravity import (
    REFUTED_SHARE,
    WITHOUT_GRAVITY,
    gravity_not_shown,
    likeliest_gravity,
)
from gtau.estimation.diagnostics.position_noise import FEWEST_FOR_TESTS, position_noise
from gtau.estimation.diagnostics.refits import untested
from gtau.estimation.diagnostics.stated_constants import scale_uncertainty
from gtau.estimation.diagnostics.tool_bodies import REFUTED_STD, other_body, other_loads
from gtau.estimation.diagnostics.verdict import unexplained_shares
from gtau.estimation.effects.description import CONTRADICTED, contradictions, estimated_effects
from gtau.estimation.effects.effect import EstimatedEffect
from gtau.estimation.effects.estimate import Mixed, estimate_effects
from gtau.estimation.effects.registry import EFFECTS
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.newton import degrees_of_freedom
from gtau.estimation.regression.problem import Estimates
from gtau.estimation.regression.run_blocks import WINDOWS, usable_rows
from gtau.findings import Finding, Grade
from gtau.progress import Progress, silent

LACKING = 1.3  # ratio of jackknife to white-noise standard errors, from which causes of misfit are tried
LARGEST_MOVE = 0.5  # relative move of a gain by all effects, beyond which the estimates are not moved
HARMLESS_SHARE = 0.3  # share of the residual variance that an effect explains, up to which it is information

FEW_ROWS = "too few rows for tests"
AS_LOGGED = Effort()
DESCRIPTIONS = {effect.name for effect in EFFECTS if effect.description}


@dataclass(frozen=True, eq=False)
class Examination:
    """Evidence of the data against a fit.

    Attributes
    ----------
    effects : tuple of EstimatedEffect
        What the model or the description may lack, with a size, the best supported first.
    causes : tuple of EstimatedEffect
        Those that contradict the description one by one, the best first.
    refits : tuple of EstimatedEffect
        Other descriptions with which the same rows were fitted again.
    findings : tuple of Finding
        What the columns of some joints hold instead of their currents or torques, frozen encoders, noise of the
        positions, and tests that refused these data.
    effort : Effort
        What the columns of all joints hold.
    mixed : Mixed, optional
        The estimates beside all effects; None where there are too few rows.
    """

    effects: tuple[EstimatedEffect, ...] = ()
    causes: tuple[EstimatedEffect, ...] = ()
    refits: tuple[EstimatedEffect, ...] = ()
    findings: tuple[Finding, ...] = ()
    effort: Effort = AS_LOGGED
    mixed: Mixed | None = None

    def moved(self, fit: Fit) -> Fit | None:
        """Move the estimates of a fit by all effects; None where that leaves the range in which they are small.

        Nor where wrenches are measured, whose noise is common to all joints, which the jackknife sees; where the
        robot's file gives the scale, roughly; or where the description is wrong, which the effects explain in part.
        """
        problem = fit.system.problem
        if self.mixed is None or fit.dataset.scaled_by_file or problem.wrenches or problem.base:
            return None
        if self.contradicting or self.findings_on_joints:
            return None
        if np.any(np.abs(self.mixed.values[problem.gain_rows] / fit.gains - 1) > LARGEST_MOVE):
            return None
        return self.mixed.applied(fit)

    @property
    def findings_on_joints(self) -> bool:
        """Whether the columns of some joints hold something else."""
        return any(finding.joints and finding.decisive for finding in self.findings)

    @property
    def contradicting(self) -> tuple[EstimatedEffect, ...]:
        """Descriptions that explain the data better than the user's, the best first.

        One that was fitted again explains them all the way; a linear one is at the wrong place beside it.
        """
        if self.refits:
            return self.refits
        beyond_physics = [effect for effect in self.effects if effect.effect not in DESCRIPTIONS]
        contradicting = [
            # of one effect on several joints, all of which change where one does, the largest
            max((other for other in beyond_physics if other.effect == effect.effect), key=lambda other: abs(other.size))
            if effect in beyond_physics
            else effect
            for effect in (*self.causes, *beyond_physics)
            if effect.description
            and effect.likelihood > CONTRADICTED
            and effect.share > HARMLESS_SHARE
            and not effect.beyond
            and abs(effect.size) > REFUTED_STD * effect.std
        ]
        return tuple(sorted(dict.fromkeys(contradicting), key=lambda effect: -effect.share))


def examine(fit: Fit, progress: Progress = silent) -> Examination:
    """Examine a fit; ``progress`` is called as the work goes on."""
    rows, unknowns = usable_rows(fit.dataset.windows(WINDOWS), fit.dataset.prepared), len(fit.solution.values)
    if rows < FEWEST_FOR_TESTS * unknowns:
        few = Finding(
            FEW_ROWS,
            text=f"the tests of the model were skipped, because the robot moves too little ({rows} rows in the middle "
            f"of the runs for {unknowns} unknowns): the intervals cover random errors alone",
            advice="log longer motions",
            grade=Grade.WARNING,
            shown_as="model",
        )
        return Examination(findings=(few,))
    effort = effort_of(fit.dataset, fit.system.unreduced.longest_delays.max())
    mixed, nothing = None, tuple[EstimatedEffect, ...]()
    effects = causes = refits = nothing
    findings = [*effort.findings]
    try:
        if (mixed := estimate_effects(fit)) is not None:
            effects, causes = estimated_effects(mixed), contradictions(mixed)
        frozen = list(frozen_encoders(fit))
        tried = _other_descriptions(fit, effort, effects, bool(frozen), progress)
        # one that leaves more of the residuals than the user's explains a single joint at most
        if refit := next((other for other in tried if other is not None and other.share > 0), None):
            # what is linear about the wrong description explains nothing, and what columns would hold is its effect
            effects, causes, refits, findings = nothing, nothing, (refit,), []
        elif not findings and effort.gravity_open:
            findings += gravity_not_shown(fit)
        findings = [*frozen, *findings]
    except GtauError as refusal:
        findings.append(untested("effects that the model may lack", refusal))
    return Examination(effects, causes, refits, (*findings, *position_noise(fit)), effort, mixed)


def _other_descriptions(
    fit: Fit, effort: Effort, effects: Sequence[EstimatedEffect], frozen: bool, progress: Progress
) -> Iterator[EstimatedEffect | None]:
    """Fit the data with other descriptions of robot and logs; the first that explains the residuals counts.

    Each is tried where the residual is large, or autocorrelated, as that takes seconds a fit.
    """
    misfit = float(unexplained_shares(fit.system.problem, fit.solution).max()) > GRAVITY_MISFIT
    lacking = lack_of_fit(fit.system.problem, fit.solution) > LACKING
    if (lacking or misfit) and not frozen:
        yield other_loads(fit)
        yield other_body(fit)
    if misfit:
        yield reversed_torques(fit)
    if effort.findings:
        return
    if lacking and any(effect.description and effect.likelihood > CONTRADICTED for effect in effects):
        yield other_clock(fit, progress)
    tilted = any(effect.effect == "gravity" and effect.share > REFUTED_SHARE for effect in effects)
    missing, turned = effort.kind == WITHOUT_GRAVITY, lacking and (tilted or misfit)
    if missing or turned:
        yield likeliest_gravity(fit, missing, turned, progress)
    if misfit:
        yield angle_from_another_link(fit, progress)


def estimates_of(
    fit: Fit, examined: Examination, correlated: bool, moved: bool = False, shifted: bool = True
) -> Estimates:
    """Collect the estimates of a fit with their covariance.

    ``moved`` by all effects the covariance is their posterior; otherwise it comes from the block jackknife, from what
    the effects leave open, and, ``shifted``, from how much they would move an estimate; without ``correlated`` from
    the method's formula, as in the paper.
    """
    problem, solution, mixed = fit.system.problem, fit.solution, examined.mixed
    scale_part = scale_uncertainty(fit.system, fit.solve)
    if not correlated:
        parts = (solution.covariance, scale_part, np.zeros_like(scale_part))
        return Estimates(problem.unknowns, solution.values, *parts, None)
    file_part = solution.prior_covariance if fit.dataset.scaled_by_file else 0.0
    model = np.zeros_like(scale_part) if mixed is None else mixed.covariance - mixed.random
    if mixed is not None and moved:
        ratio = np.divide(mixed.values, solution.values, out=np.ones(len(mixed.values)), where=solution.values != 0)
        parts = (mixed.random - file_part, scale_part * np.outer(ratio, ratio) + file_part, model)
        return Estimates(problem.unknowns, mixed.values, *parts, None)
    freedom = degrees_of_freedom(problem, solution, fit.free_gains)
    if mixed is not None and shifted:
        shift = mixed.values - solution.values
        model = model + np.outer(shift, shift)
    parts = (solution.jackknife - file_part, scale_part + file_part, model)
    return Estimates(problem.unknowns, solution.values, *parts, freedom)
