"""What can be believed of a fit: verdicts on gains and delays from all hypotheses and checks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gtau.estimation.diagnostics.delays import delay_verdicts
from gtau.estimation.diagnostics.gain_verdicts import gain_verdicts, lack_of_fit
from gtau.estimation.diagnostics.leg_symmetry import unlike_legs
from gtau.estimation.diagnostics.misspecification import Misspecification, find_misspecification
from gtau.estimation.diagnostics.position_ripple import ripple_notes
from gtau.estimation.diagnostics.prior_checks import check_limits, check_payloads, check_priors, share_doubts
from gtau.estimation.diagnostics.saturation import check_saturation, find_saturation
from gtau.estimation.diagnostics.swapped_channels import check_swapped
from gtau.estimation.diagnostics.uncertainty import Uncertainty
from gtau.estimation.diagnostics.verdict import GIVEN, GOOD, Outcome, Verdict
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.thresholds import LACKING
from gtau.progress import Progress, silent


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Verdicts on the drive gains and delays (n,) and on the known payloads by name, and notes on what was found."""

    gains: tuple[Verdict, ...]
    delays: tuple[Verdict, ...]
    payloads: Mapping[str, Verdict]
    lack_of_fit: float
    notes: tuple[str, ...]


def diagnose(
    fit: Fit,
    uncertainty: Uncertainty,
    payloads: Mapping[str, Verdict],
    prior_gains: Mapping[str, float],
    progress: Progress = silent,
) -> Diagnosis:
    """Find what can be believed of a fit.

    Parameters
    ----------
    fit, uncertainty : Fit, Uncertainty
        What was estimated, and how well.
    payloads : mapping
        Verdicts on known payloads, by name.
    prior_gains : mapping
        Gains expected, N m/A or N/A, by joint; may be empty.
    progress : callable
        Called while the hypotheses are tested.
    """
    dataset, system, solution = fit.dataset, fit.system, fit.solution
    robot, problem, joints = dataset.robot, system.problem, dataset.model.actuated
    n_theta, n, lack = problem.n_theta, len(joints), lack_of_fit(problem, solution)
    std = np.sqrt(np.diag(uncertainty.covariance))
    gain_std, delay_std = std[n_theta : n_theta + n], std[n_theta + n :]
    verdicts: Sequence[Verdict] = (GIVEN,) * n
    if gain_std.any():
        repeating = uncertainty.ripple is not None and uncertainty.ripple.found
        names = tuple(run.name for run in dataset.runs)
        verdicts = gain_verdicts(problem, solution, gain_std, system.block_positions, names, repeating)
        if any(each != GOOD for each in verdicts) or lack > LACKING:
            verdicts = check_swapped(verdicts, dataset)
            verdicts = _check_description(verdicts, find_misspecification(dataset, system, solution, progress))
            verdicts = check_saturation(verdicts, find_saturation(dataset, system, solution))
        verdicts = check_priors(check_payloads(verdicts, payloads), robot, solution.gains, prior_gains)
    elif lack > LACKING:
        verdicts = check_swapped(verdicts, dataset)
    verdicts = share_doubts(check_limits(verdicts, robot, np.abs(solution.gains) * problem.signal), joints)
    delays = delay_verdicts(problem, solution) if delay_std.any() else (GOOD,) * n
    ripple = () if uncertainty.ripple is None else ripple_notes(uncertainty.ripple, joints, solution)
    notes = (*unlike_legs(dataset, system, solution.theta, uncertainty.covariance), *ripple)
    return Diagnosis(tuple(verdicts), tuple(delays), payloads, lack, notes)


def _check_description(verdicts: Sequence[Verdict], found: Misspecification | None) -> tuple[Verdict, ...]:
    """Condemn all gains where something in the robot's description is suspected, unless another reason is known."""
    if found is None:
        return tuple(verdicts)
    return tuple(
        each
        if each.outcome == Outcome.CONTRADICTORY and not found.decisive
        else Verdict(Outcome.CONTRADICTORY, found.why, found.advice)
        for each in verdicts
    )
