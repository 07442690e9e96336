"""The uncertainty of the estimates, and what it is made of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gtau.estimation.diagnostics.position_ripple import PositionRipple, position_ripple
from gtau.estimation.estimators.degrees_of_freedom import degrees_of_freedom
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.mass_uncertainty import mass_uncertainty


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Covariance (k, k) of (theta, gains, delays), and the degrees of freedom (k,) behind its diagonal.

    ``freedom`` is None for very many, ``ripple`` where ripple was not looked for.
    """

    covariance: np.ndarray
    freedom: np.ndarray | None
    ripple: PositionRipple | None


def uncertainty_of(fit: Fit, correlated: bool) -> Uncertainty:
    """Find the uncertainty of a fit.

    Parameters
    ----------
    fit : Fit
        What was estimated.
    correlated : bool
        By the block jackknife, with what ripple does, or by the method's formula.
    """
    of_masses = mass_uncertainty(fit.dataset, fit.system, fit.unrefined, fit.solve)
    if not correlated:
        return Uncertainty(fit.solution.covariance + of_masses, None, None)
    ripple = position_ripple(fit.dataset, fit.system, fit.solution, fit.free_gains)
    covariance = fit.solution.jackknife + of_masses + ripple.covariance
    return Uncertainty(covariance, degrees_of_freedom(fit.system.problem, fit.solution, fit.free_gains), ripple)
