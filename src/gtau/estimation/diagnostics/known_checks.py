"""Whether all other data agree with the known parameters that take part in the estimation."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr, ndtri

from gtau.estimation.diagnostics.finding import Finding
from gtau.estimation.diagnostics.finding import FindingKind as F
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.thresholds.estimates import APART


def prior_contradictions(fit: Fit, covariance: np.ndarray, accuracy: float) -> list[Finding]:
    """Find base parameters that all data put elsewhere than their priors, by more than the ``accuracy``.

    Parameters
    ----------
    fit : Fit
        What was estimated, with the priors.
    covariance : ndarray
        Of (theta, gains, delays), (k, k).
    accuracy : float
        Relative difference that does not matter.
    """
    parameters, base, found = fit.system.problem.parameters, fit.dataset.base.names, []
    priors = {name: prior for name, prior in fit.dataset.priors.items() if name in base and name in parameters}
    limit = -ndtri(ndtr(-APART) / max(len(priors), 1))  # of many priors some are further off
    for name, prior in priors.items():
        if prior.value is None or prior.std is None:
            continue
        k = parameters.index(name)
        value, std = float(fit.solution.theta[k]), float(np.sqrt(covariance[k, k]))
        apart = prior.std * np.sqrt(max(1 - (std / prior.std) ** 2, 0.0))  # as the estimate has the prior in it
        if abs(value - prior.value) > max(limit * apart, accuracy * abs(prior.value)):
            values = {"found": value, "std": std, "prior": prior.value, "prior_std": prior.std}
            found.append(Finding(F.PRIOR, (), name, values))
    return found
