"""What every estimator returns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Solution:
    """Estimates of one method.

    Attributes
    ----------
    theta : ndarray
        Unknown parameters, (n_theta,), SI units.
    gains, delays : ndarray
        Drive gains (n,), N m/A or N/A, and delays of the currents (n,), s.
    sigma : ndarray
        Standard deviation of each joint's current residual, (n,), A.
    covariance : ndarray
        Of (theta, gains, delays) by the method's formula, which takes errors for independent; zero
        where a value is given and not estimated.
    jackknife : ndarray
        The same by leaving out one unit after another, which allows for errors correlated in time.
    statistics : Mapping
        Further figures that the method offers, such as ``singular_ratio``.
    """

    theta: np.ndarray
    gains: np.ndarray
    delays: np.ndarray
    sigma: np.ndarray
    covariance: np.ndarray
    jackknife: np.ndarray
    statistics: Mapping[str, float] = field(default_factory=dict)


def jackknife_covariance(replicates: np.ndarray) -> np.ndarray:
    """Covariance (k, k) from delete-one estimates (U, k)."""
    deviations = replicates - replicates.mean(axis=0)
    units = len(replicates)
    return (units - 1) / units * deviations.T @ deviations
