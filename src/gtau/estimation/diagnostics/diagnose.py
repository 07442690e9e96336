"""Diagnose a fit: effects beside it, other descriptions, the findings of all checks in order, and verdicts from them.

A cross-validated torque says nothing about a wrong gain, as both sides of the equation carry it. The user needs the
possible error of a gain: its interval, with a random part and one from model deficits. It is good where the whole
interval lies within the required accuracy, and contradictory only where the data refute the description of robot and
logs and the gain would move by more than that.

Every scale of logged torques is proportional to the stated mass of the payload; but torques of different motors rarely
share one scale error, while a mistyped mass, or a gripper that was not weighed with its load, has that effect. Gains
and parameters also absorb part of a wrench of wrong sign, body or axes, and lengths or single currents look wrong
instead: so wherever wrenches are measured, the advice names them first.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics import columns, descriptions, gains, gravity, scale
from gtau.estimation.diagnostics.effort import MISFIT_TRIED, columns_of_effort, middle_rows, shows_gravity
from gtau.estimation.diagnostics.log_checks import frozen_encoders, lack_of_fit, logged_torques
from gtau.estimation.diagnostics.units import reversed_by_file, units_and_signs
from gtau.estimation.diagnostics.verdict import GIVEN, GOOD, decide, delay_verdicts, motors, unexplained_shares
from gtau.estimation.effects.effect import EstimatedEffect
from gtau.estimation.effects.estimate import CONTRADICTED, Mixed, contradictions, estimate_effects, estimated_effects
from gtau.estimation.effects.known import EFFECTS
from gtau.estimation.effects.known.wrenches import WRENCH_ERRORS
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.newton import degrees_of_freedom
from gtau.estimation.regression.problem import Estimates
from gtau.estimation.regression.run_blocks import WINDOWS, usable_rows
from gtau.findings import Finding, Grade, Progress, silent
from gtau.robots.parameter import Parameter

if TYPE_CHECKING:
    from gtau.estimation.diagnostics.inertia_audit import InertiaAudit

FEWEST_FOR_TESTS = 3.0  # rows for each unknown; with fewer, effects fit the noise and are not tried
LACKING = 1.3  # ratio of jackknife to white-noise standard errors, from which causes of misfit are tried
LARGEST_MOVE = 0.4  # relative move of a gain by all effects, beyond which the estimates are not moved
HARMLESS_SHARE = 0.3  # share of the residual variance that a description explains, up to which it is information
SURE = 0.01  # part of the residual variance that a description leaves, below which no further one is tried
LARGE_SHARE = 0.1  # the same of physics that is larger than a motor can be, and of measured wrenches

FEW_ROWS = "too few rows for tests"
DESCRIPTIONS = {effect.name for effect in EFFECTS if effect.description}
IMITATED = DESCRIPTIONS - WRENCH_ERRORS  # by friction and gears, which a measured wrench does not contain


@dataclass(frozen=True, eq=False)
class Examination:
    """Evidence of the data against a fit.

    ``effects`` are what the model or the description may lack, with a size, the best supported first, or the other
    description alone with which the same rows were fitted again; ``contradicting`` are descriptions that explain the
    data better than the user's, the best first. ``findings`` say what the columns of some joints hold instead of their
    currents or torques, which encoders are frozen, and which tests refused these data. ``mixed`` are the estimates
    beside all effects; None where there are too few rows.
    """

    effects: tuple[EstimatedEffect, ...] = ()
    contradicting: tuple[EstimatedEffect, ...] = ()
    findings: tuple[Finding, ...] = ()
    mixed: Mixed | None = None

    def moved(self, fit: Fit) -> Fit | None:
        """Move the estimates of a fit by all effects; None where that leaves the range in which they are small.

        Nor where columns made again move them on, as in a robot with more parameters than the motions show; where
        wrenches are measured, whose noise is common to all joints, which the jackknife sees; where the
        robot's file gives the scale, roughly; or where the description is wrong, which the effects explain in part.
        """
        problem = fit.problem
        if self.mixed is None or fit.dataset.scaled_by_file or problem.wrenches or problem.base:
            return None
        if self.contradicting or any(finding.joints and finding.decisive for finding in self.findings):
            return None
        far = np.any(np.abs(self.mixed.values[problem.gain_rows] / fit.gains - 1) > LARGEST_MOVE)
        return None if far or not self.mixed.settled else self.mixed.applied(fit)


def examine(fit: Fit, progress: Progress = silent) -> Examination:
    """Examine a fit; ``progress`` is called as the work goes on."""
    rows = usable_rows(fit.dataset.windows(WINDOWS), fit.dataset.prepared)
    unknowns = len(fit.solution.values)
    if rows < FEWEST_FOR_TESTS * unknowns:
        few = Finding(
            FEW_ROWS,
            text=f"the tests of the model were skipped, because the robot moves too little ({rows} rows in the middle "
            f"of the runs for {unknowns} unknowns): the intervals cover random errors alone",
            advice="log longer motions",
            shown_as="model",
        )
        return Examination(findings=(few,))
    misfit = float(unexplained_shares(fit).max()) > MISFIT_TRIED
    lack, middle = lack_of_fit(fit.problem, fit.solution), middle_rows(fit)
    lacking = lack > LACKING
    causes = tuple[EstimatedEffect, ...]()
    mixed, findings = None, list(columns_of_effort(middle) if misfit or lacking else ())
    effects = contradicting = causes
    try:
        if (mixed := estimate_effects(fit)) is not None:
            effects = estimated_effects(mixed)
            causes = contradictions(mixed)
            contradicting = _contradicting(effects, causes)
            lacking = lacking or bool(contradicting)
        frozen = list(frozen_encoders(fit))
        missing, as_well = (False, False) if middle is None else shows_gravity(middle, lack)
        loads = descriptions.other_loads(fit) if misfit or (lacking and not findings) else None
        odd = descriptions.odd_run(fit, loads) if misfit and not frozen else None
        findings = [odd] if odd else [*frozen, *findings]  # other columns in all runs do not mend one run
        contradicting = () if odd else contradicting
        refit: EstimatedEffect | None = None
        if not findings:
            # effects beside parameters that no body has explain nothing
            estimates = (estimates_of(fit, Examination(mixed=moving), correlated=True) for moving in (None, mixed))
            alone, beside = (any(gains.impossible_parameters(fit, values)) for values in estimates)
            scaled = columns.other_torques(fit)
            wrong = misfit or beside or bool(contradicting or scaled or (fit.free_gains and fit.gains.min() < 0))
            others = _other_descriptions(fit, wrong, lacking, missing, (*effects, *causes), progress)
            refit = _best_described(chain([loads, scaled], others))
            explained = any(not effect.beyond and effect.share > 1 - descriptions.LEFT for effect in contradicting)
            if refit.cause.values["remains"] >= SURE if refit else wrong and not explained:
                refit = _best_described([refit, columns.other_columns(fit, not alone, refit, progress)])
        if refit:
            effects, contradicting = (refit,), (refit,)  # what is linear about the wrong description explains nothing
        elif not findings and as_well and not (fit.dataset.robot.inertias and fit.kind == "torque"):
            findings += gravity.gravity_not_shown(fit)
    except GtauError as refusal:
        text = f"effects that the model may lack could not be tested: {str(refusal).removesuffix('.')}"
        kind = "other estimators not tried"
        findings.append(Finding(kind, text=text, grade=Grade.INFORMATION, shown_as="reading"))
    return Examination(effects, contradicting, tuple(findings), mixed)


def _contradicting(
    effects: Sequence[EstimatedEffect], causes: Sequence[EstimatedEffect]
) -> tuple[EstimatedEffect, ...]:
    """Select the effects that contradict the description, the best first; of physics by its size, its largest joint.

    What is so large that its columns do not describe it counts where nothing else does: its cause is then a guess.
    """
    physics: dict[str, EstimatedEffect] = {}
    for effect in effects:
        if effect.effect not in DESCRIPTIONS:
            largest = physics.setdefault(effect.effect, effect)
            physics[effect.effect] = max(largest, effect, key=lambda other: abs(other.size))
    against = [
        effect
        for effect in (*causes, *physics.values())
        if effect.description
        and effect.likelihood > CONTRADICTED
        and effect.share > (HARMLESS_SHARE if effect.effect in IMITATED else LARGE_SHARE)
        and abs(effect.size) > descriptions.REFUTED_STD * effect.std
    ]
    within = [effect for effect in against if not effect.beyond] or against[:1]
    return tuple(sorted(within, key=lambda effect: -effect.share))


def _other_descriptions(
    fit: Fit, wrong: bool, lacking: bool, missing: bool, effects: Sequence[EstimatedEffect], progress: Progress
) -> Iterator[EstimatedEffect | None]:
    """Fit the data with other descriptions of robot and logs.

    Each is tried where something is ``wrong``, or the residual is autocorrelated, as that takes seconds a fit.
    """
    if wrong or lacking:
        yield descriptions.other_body(fit)
    tilted = any(effect.effect == "gravity" and effect.share > gravity.REFUTED_SHARE for effect in effects)
    others = list[EstimatedEffect | None]()
    if lacking and any(effect.description and effect.likelihood > CONTRADICTED for effect in effects):
        others.append(gravity.other_clock(fit, progress))
    turned = wrong or (lacking and tilted)
    if missing or turned:
        others.append(gravity.likeliest_gravity(fit, missing, turned, progress))
    # a clock that is far too slow leaves as little gravity as torques without gravity do
    yield max((other for other in others if other is not None), key=lambda other: other.share, default=None)
    if wrong:
        yield columns.angle_from_another_link(fit, progress)


def _best_described(tried: Iterable[EstimatedEffect | None]) -> EstimatedEffect | None:
    """Choose the description that leaves least of the residuals, or the first that leaves hardly any."""
    best: EstimatedEffect | None = None
    for other in tried:
        # one that leaves more of the residuals than the user's explains a single joint at most
        if other is None or other.share <= 0:
            continue
        remains = other.cause.values["remains"]
        if best is None or remains < best.cause.values["remains"]:
            best = other
        if remains < SURE:
            break
    return best


def estimates_of(
    fit: Fit, examined: Examination, correlated: bool, moved: bool = False, shifted: bool = True
) -> Estimates:
    """Collect the estimates of a fit with their covariance.

    ``moved`` by all effects the covariance is their posterior; otherwise it comes from the block jackknife, from what
    the effects leave open, and, ``shifted``, from how much they would move an estimate; without ``correlated`` from
    the method's formula, as in the paper.
    """
    problem, solution, mixed = fit.problem, fit.solution, examined.mixed
    scale_part = scale.scale_uncertainty(fit.system, fit.solve)
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


def diagnose(
    fit: Fit,
    examined: Examination,
    estimates: Estimates,
    payloads: Mapping[str, Finding],
    prior_gains: Mapping[str, float],
    references: Sequence[Finding],
    accuracy: float,
    audit: InertiaAudit | None = None,
) -> tuple[Finding, ...]:
    """List what speaks against the estimates of a fit, what counts most first, and what else the user should know.

    ``payloads`` are verdicts on known payloads by name, ``prior_gains`` those expected, N m/A or N per A, by joint,
    and ``references`` what speaks against torque sensors and voltages. ``accuracy`` is half the relative width of the
    95 % interval up to which a gain is good, and ``audit`` what the data say of the inertias of the robot's file.
    """
    judged = gains.judged_gains(fit, estimates)
    contradicted = (verdict for verdict in payloads.values() if verdict.outcome == Grade.CONTRADICTORY)
    wrong = sorted(contradicted, key=lambda finding: -finding.size)
    plain = estimates
    # effects explain part of a wrong prior, and of reversed torques
    if (fit.dataset.stated_priors or audit) and examined.mixed is not None:
        plain = estimates_of(fit, examined, correlated=True, shifted=False)
    return (
        *gains.wrench_contradictions(fit),
        *gains.payloads_in_noise(fit, judged),
        *examined.findings,
        *(() if audit is None or examined.contradicting else reversed_by_file(fit, audit, plain)),
        *gains.all_negative(fit, examined.contradicting, judged, prior_gains),
        *gains.refuted_descriptions(fit, examined.contradicting, judged, wrong, accuracy),
        *gains.unexplained_signals(fit, wrong),
        *(scale.contradictory_payload(finding.subject, motors(fit)) for finding in wrong if fit.free_gains),
        *references,
        *scale.contradictory_priors(fit, plain, accuracy),
        # a gain without a value: what follows would judge that value
        *gains.gains_without_value(fit, judged),
        *gains.impossible_parameters(fit, estimates),
        # units and signs, which fit the data whatever they are
        *units_and_signs(fit, estimates, prior_gains, audit),
        *gains.wide_gains(fit, examined.effects, estimates, judged, accuracy),
        *(() if audit is None else audit.contradicted_priors()),
        *gains.small_refutations(examined.contradicting, judged, accuracy),
        *gains.common_scale(fit, estimates, accuracy),
        *logged_torques(fit, estimates),
    )


def channel_verdicts(
    fit: Fit, estimates: Estimates, findings: Sequence[Finding], delayed: bool
) -> dict[Parameter, Finding]:
    """Judge the gains of the motors by findings on them, and the delays of all channels, where any is ``delayed``."""
    verdicts = decide(motors(fit), findings, GOOD if fit.free_gains else GIVEN)
    unknowns = estimates.unknowns
    std = np.sqrt(np.diag(estimates.random))[unknowns.delays]
    period = 1 / min(run.rate for run in fit.dataset.runs)
    delays = delay_verdicts(fit.problem, fit.solution, std, period) if delayed else [GOOD] * len(std)
    judged = {Parameter("gain", joint): verdict for joint, verdict in verdicts.items()}
    return judged | dict(zip(unknowns[unknowns.delays], delays, strict=True))
