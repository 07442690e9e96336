"""The uncertainty of the estimates: a random part, and one from what the model may lack."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gtau.estimation.diagnostics.examine import Examination
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.newton import degrees_of_freedom
from gtau.estimation.estimators.scale_uncertainty import scale_uncertainty


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Covariances (k, k) of (theta, gains, delays): by ``scatter``, the ``scale``, and what the ``model`` may lack.

    ``freedom`` (k,) are the degrees of freedom behind the scatter, None for very many.
    """

    scatter: np.ndarray
    scale: np.ndarray
    model: np.ndarray
    freedom: np.ndarray | None

    @property
    def random(self) -> np.ndarray:
        """The random part: scatter, and masses and calibrations that give the scale."""
        return self.scatter + self.scale

    @property
    def covariance(self) -> np.ndarray:
        """Both parts together."""
        return self.random + self.model

    @property
    def effective_freedom(self) -> np.ndarray | None:
        """Degrees of freedom of all parts together (k,): all but the scatter counts as known (Satterthwaite)."""
        if self.freedom is None:
            return None
        scatter, total = np.diag(self.scatter), np.diag(self.covariance)
        share = np.divide(total, scatter, out=np.ones_like(total), where=scatter > 0)
        return np.asarray(self.freedom * share**2)


def uncertainty_of(fit: Fit, examined: Examination, correlated: bool) -> Uncertainty:
    """Find the uncertainty of a fit.

    Parameters
    ----------
    fit, examined : Fit, Examination
        What was estimated, and what the model may lack.
    correlated : bool
        By the block jackknife and with the model part, or by the method's formula alone, as the paper does.
    """
    of_scale = scale_uncertainty(fit.dataset, fit.system, fit.unrefined, fit.solve)
    if not correlated:
        return Uncertainty(fit.solution.covariance, of_scale, np.zeros_like(of_scale), None)
    freedom = degrees_of_freedom(fit.system.problem, fit.solution, fit.free_gains)
    return Uncertainty(fit.solution.jackknife, of_scale, examined.covariance, freedom)
