"""Find the outliers among values of which each has a standard deviation of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

LEAST = 8  # values: the spread of fewer is too uncertain to call one an outlier
FALSE_ALARM = 0.05  # chance that a fleet without outliers shows one; 0.1 where the spread is small
EFFICIENCY = 0.37  # of a median-based spread, relative to that of the standard deviation
QUARTILE = 0.4549364  # median of the chi-square distribution with one degree of freedom


@dataclass(frozen=True, eq=False)
class Distances:
    """How far values are from their median.

    Attributes
    ----------
    median, median_std, spread : float
        Weighted median of the values with its standard deviation, and the standard deviation between the values
        beyond those of the values themselves.
    z : ndarray
        (N,) distances from the median, in standard deviations of spread and value together.
    limit : ndarray
        (N,) the ``|z|`` beyond which a value is an outlier; infinite where there are fewer than 8 values.
    """

    median: float
    median_std: float
    spread: float
    z: np.ndarray
    limit: np.ndarray

    @property
    def outlier(self) -> np.ndarray:
        """Whether each value is an outlier, (N,)."""
        return np.abs(self.z) > self.limit


def distances(values: np.ndarray, std: np.ndarray, freedom: np.ndarray, tests: int) -> Distances:
    """Compute the distances of values from their median.

    The spread makes the median of ``(value - median)^2 / (spread^2 + std^2)`` that of a chi-square variable, so it
    breaks down only where half of the values are outliers. The limit is the point of a t distribution that is exceeded
    in ``tests`` draws with a probability of 5 %.

    Parameters
    ----------
    values, std, freedom : ndarray
        (N,) values, their standard deviations, and the degrees of freedom of those (inf: very many).
    tests : int
        Values tested in the whole fleet.
    """
    from scipy.special import stdtrit

    median, spread = float(np.median(values)), 0.0
    for _ in range(20):
        before = median, spread
        spread = _spread((values - median) ** 2, std**2)
        median = _weighted_median(values, 1 / np.maximum(np.hypot(spread, std), 1e-300))
        if (median, spread) == before:
            break
    total = np.hypot(spread, std)
    z = np.divide(values - median, total, out=np.zeros(len(values)), where=total > 0)
    of_spread = max(EFFICIENCY * (len(values) - 1), 1.0)
    # where there is spread, it may well be the larger part: its few degrees of freedom count for both
    both = np.minimum(freedom, of_spread) if spread else freedom
    limit = stdtrit(both, 1 - FALSE_ALARM / (2 * tests))
    median_std = float(np.sqrt(np.pi / 2 / np.sum(1 / np.maximum(total, 1e-150) ** 2)))
    return Distances(median, median_std, spread, z, limit if len(values) >= LEAST else np.full(len(values), np.inf))


def _spread(squares: np.ndarray, variances: np.ndarray) -> float:
    """Find the spread whose square, added to ``variances``, gives ``squares`` the median ratio of chi-square."""
    low, high = 0.0, float(squares.max()) / QUARTILE
    if np.median(squares / np.maximum(variances, 1e-300)) <= QUARTILE:
        return 0.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (low, middle) if np.median(squares / (middle + variances)) <= QUARTILE else (middle, high)
    return float(np.sqrt(high))


def _weighted_median(values: np.ndarray, weights: np.ndarray) -> float:
    order = np.argsort(values)
    cumulated = np.cumsum(weights[order])
    half = cumulated[-1] / 2
    k = int(np.searchsorted(cumulated, half))
    tie = k + 1 < len(values) and np.isclose(cumulated[k], half, rtol=1e-12)
    return float(values[order[k : k + 2 if tie else k + 1]].mean())
