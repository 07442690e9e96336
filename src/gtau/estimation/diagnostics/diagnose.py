"""What can be believed of a fit: verdicts on gains and delays from all findings and checks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gtau.estimation.diagnostics.delays import delay_verdicts
from gtau.estimation.diagnostics.findings import Findings
from gtau.estimation.diagnostics.gain_verdicts import gain_verdicts
from gtau.estimation.diagnostics.known_checks import check_mass, contradicted, prior_notes
from gtau.estimation.diagnostics.leg_symmetry import unlike_legs
from gtau.estimation.diagnostics.other_estimators import noise_note
from gtau.estimation.diagnostics.position_ripple import ripple_notes
from gtau.estimation.diagnostics.prior_checks import check_limits, check_payloads, check_priors, share_doubts
from gtau.estimation.diagnostics.sensor_checks import SensorScale, check_sensors, sensor_scales
from gtau.estimation.diagnostics.uncertainty import Uncertainty
from gtau.estimation.diagnostics.verdict import GIVEN, GOOD, Outcome, Verdict
from gtau.estimation.diagnostics.wrench_checks import check_wrenches
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.thresholds.estimates import MISFIT_GIVEN
from gtau.signals.notes import Kind, Note


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Verdicts on gains, delays and known payloads, and notes on what was found.

    Of the drive ``gains`` (n,), the ``delays`` (c,), those of torque sensors included, and the ``payloads`` by name.
    ``accuracy`` is half the relative width of the 95 % interval up to which a gain is good; ``sensors`` are the scales
    of torque sensors by all else that is known.
    """

    gains: tuple[Verdict, ...]
    delays: tuple[Verdict, ...]
    payloads: Mapping[str, Verdict]
    notes: tuple[Note, ...]
    accuracy: float
    sensors: tuple[SensorScale, ...] = ()


def diagnose(
    fit: Fit,
    findings: Findings,
    uncertainty: Uncertainty,
    payloads: Mapping[str, Verdict],
    prior_gains: Mapping[str, float],
    accuracy: float,
) -> Diagnosis:
    """Judge what can be believed of a fit.

    Parameters
    ----------
    fit, findings, uncertainty : Fit, Findings, Uncertainty
        What was estimated, what the data say against it, and how well it is known.
    payloads : mapping
        Verdicts on known payloads, by name.
    prior_gains : mapping
        Gains expected, N m/A or N/A, by joint; may be empty.
    accuracy : float
        Half the relative width of the 95 % interval up to which a gain is good.
    """
    dataset, system, solution = fit.dataset, fit.system, fit.solution
    robot, problem, joints = dataset.robot, system.problem, dataset.model.actuated
    torques = np.abs(solution.gains) * problem.signal
    sensors = sensor_scales(fit) if fit.free_gains else ()
    if fit.free_gains:
        verdicts: Sequence[Verdict] = gain_verdicts(fit, findings, uncertainty, accuracy, prior_gains)
        verdicts = check_wrenches(verdicts, fit)
        verdicts = check_sensors(check_payloads(verdicts, payloads), sensors, accuracy)
        verdicts = check_priors(verdicts, robot, fit.gains, prior_gains)
    else:
        verdicts = check_wrenches(_given_verdicts(fit, findings), fit)
    wrong_priors = contradicted(fit, uncertainty.covariance, accuracy)
    verdicts = check_mass(verdicts, fit, wrong_priors)
    verdicts = share_doubts(check_limits(verdicts, robot, torques), joints)
    delay_std = np.sqrt(np.diag(uncertainty.random))[problem.n_theta + len(problem.channels) :]
    period = 1 / min(run.rate for run in dataset.runs)
    delays = delay_verdicts(problem, solution, delay_std, period) if delay_std.any() else (GOOD,) * len(delay_std)
    notes = (
        *unlike_legs(dataset, system, solution.theta, uncertainty.covariance),
        *prior_notes(wrong_priors),
        *noise_note(fit, findings.alternatives),
        *ripple_notes(findings.ripple, fit),
        *_small_refutations(fit, findings, accuracy),
    )
    return Diagnosis(tuple(verdicts), tuple(delays), payloads, notes, accuracy, sensors)


def _given_verdicts(fit: Fit, findings: Findings) -> tuple[Verdict, ...]:
    """Judge gains that are given, or 1 for torques: contradictory where the model does not explain the joint."""
    misfit = (fit.solution.sigma / fit.system.problem.balance(fit.solution.theta))[: len(fit.gains)]
    kind = fit.dataset.runs[0].kind
    found = [GIVEN] * len(misfit)
    for j, share in enumerate(misfit):
        swapped = [each for each in findings.swapped if j in each.joints]
        if swapped:
            found[j] = Verdict(Outcome.CONTRADICTORY, swapped[0].why, swapped[0].advice)
        elif share > MISFIT_GIVEN:
            found[j] = Verdict(
                Outcome.CONTRADICTORY,
                f"the model leaves {100 * share:.0f} % of this joint's {kind} unexplained",
                f"check its position and {kind} columns, their signs and units, the clock of the log and its "
                "'preparation'",
            )
    return tuple(found)


def _small_refutations(fit: Fit, findings: Findings, accuracy: float) -> list[Note]:
    """List what the data refute of the description where no gain moves by more than the accuracy."""
    if not fit.free_gains:
        return []
    return [
        Note(
            Kind.MODEL,
            f"{each.subject} would explain {100 * each.share:.0f} % of the residual variance and move no gain by more "
            f"than {100 * float(np.abs(each.moves).max()):.2g} %",
            each.advice,
        )
        for each in findings.refuted
        if np.abs(each.moves).max() <= accuracy
    ]
