"""Whether all other data agree with the known parameters that take part in the estimation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.special import ndtr, ndtri

from gtau.estimation.diagnostics.verdict import Outcome, Verdict
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.flight import whole_mass
from gtau.estimation.thresholds.estimates import APART
from gtau.signals.notes import Kind, Note

ADVICE = "check its value, and the units and signs of what else gives the scale: payloads, sensors, wrenches"


def contradicted(fit: Fit, covariance: np.ndarray, accuracy: float) -> dict[str, str]:
    """Find base parameters that all data put elsewhere than their priors, by more than the ``accuracy``, and say where.

    Parameters
    ----------
    fit : Fit
        What was estimated, with the priors.
    covariance : ndarray
        Of (theta, gains, delays), (k, k).
    accuracy : float
        Relative difference that does not matter.
    """
    parameters, base, found = fit.system.problem.parameters, fit.dataset.base.names, {}
    priors = {name: prior for name, prior in fit.dataset.priors.items() if name in base and name in parameters}
    limit = -ndtri(ndtr(-APART) / max(len(priors), 1))  # of many priors some are further off
    for name, prior in priors.items():
        if prior.value is None or prior.std is None:
            continue
        k = parameters.index(name)
        value, std = float(fit.solution.theta[k]), float(np.sqrt(covariance[k, k]))
        apart = prior.std * np.sqrt(max(1 - (std / prior.std) ** 2, 0.0))  # as the estimate has the prior in it
        if abs(value - prior.value) > max(limit * apart, accuracy * abs(prior.value)):
            found[name] = (
                f"is {value:.4g} +- {std:.2g} by all data, but {prior.value:.4g} +- {prior.std:.2g} by its prior"
            )
    return found


def prior_notes(found: Mapping[str, str]) -> list[Note]:
    """Note the priors that all data contradict, see :func:`contradicted`."""
    return [Note(Kind.MODEL, f"the known parameter {name} {why}", ADVICE) for name, why in found.items()]


def check_mass(verdicts: Sequence[Verdict], fit: Fit, found: Mapping[str, str]) -> tuple[Verdict, ...]:
    """Judge all gains of a floating robot that weighs something else than what all data say."""
    name = whole_mass(fit.dataset.base, fit.dataset.model.parameter_names) if fit.dataset.robot.floating else ""
    if name not in found:
        return tuple(verdicts)
    wrong = Verdict(Outcome.CONTRADICTORY, f"the mass of the robot, {name}, {found[name]}", ADVICE)
    return tuple(each if each.outcome == Outcome.CONTRADICTORY else wrong for each in verdicts)
