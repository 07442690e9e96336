"""The estimates of one method, and their covariances."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np


@dataclass(frozen=True, eq=False)
class Iterate:
    """Unknowns in the domain of the currents: ``theta`` (n_theta,), ``b = 1 / g`` (c,) and ``delays`` (c,) in s."""

    theta: np.ndarray
    b: np.ndarray
    delays: np.ndarray


@dataclass(frozen=True, eq=False)
class Solution:
    """Estimates of one method.

    Attributes
    ----------
    theta : ndarray
        Unknown parameters, (n_theta,), SI units.
    gains, delays : ndarray
        Gains of the channels (c,), N m/A or N/A, 1 of torque sensors, and their delays (c,), s.
    sigma : ndarray
        Standard deviation of each channel's residual, (c,), A, of torque sensors N m or N.
    covariance : ndarray
        Of (theta, gains, delays) by the method's formula, which takes errors for independent; zero
        where a value is given and not estimated.
    replicates : callable
        What leaving out one unit after another adds to the estimates of (theta, gains, delays), (U, k);
        called when the jackknife is asked for.
    statistics : Mapping
        Further figures that the method offers, such as ``singular_ratio``.
    of_prior : ndarray or float
        The share of priors in the covariance, which no unit of the data shows.
    settled : bool
        Whether the iteration came to an end.
    """

    theta: np.ndarray
    gains: np.ndarray
    delays: np.ndarray
    sigma: np.ndarray
    covariance: np.ndarray
    replicates: Callable[[], np.ndarray]
    statistics: Mapping[str, float] = field(default_factory=dict)
    of_prior: np.ndarray | float = 0.0
    settled: bool = True

    @cached_property
    def jackknife(self) -> np.ndarray:
        """Compute the covariance (k, k) from the steps (U, k) that leaving out each unit makes."""
        return jackknife(self.replicates()) + self.of_prior

    @property
    def iterate(self) -> Iterate:
        """The estimates as unknowns in the domain of the currents."""
        return Iterate(self.theta, 1 / self.gains, self.delays)

    @property
    def stacked(self) -> np.ndarray:
        """(theta, gains, delays) in one vector, (k,)."""
        return np.concatenate([self.theta, self.gains, self.delays])


def jackknife(replicates: np.ndarray) -> np.ndarray:
    """Compute the delete-one jackknife covariance (k, k) of k estimates from their replicates (U, k)."""
    deviations = replicates - replicates.mean(axis=0)
    blocks = len(replicates)
    return np.asarray((blocks - 1) / blocks * deviations.T @ deviations)
