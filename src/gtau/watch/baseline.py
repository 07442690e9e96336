"""Baseline of healthy logs: bands of each chart, and the covariance of all charts.

Healthy days differ by more than the interval of one day's log, so the bands come from the scatter between
logs. With some ten logs and forty charts the empirical covariance has no full rank; it is shrunk towards the standard
deviations of the logs with the correlations that independent residuals would give (``formula``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

FEWEST = 4  # logs of a baseline: mean, scale and two degrees of freedom


@dataclass(frozen=True, eq=False)
class Baseline:
    """Healthy logs: ``mean`` and ``std`` (k,) between logs, of ``count`` (k,) each; NaN where there are too few."""

    mean: np.ndarray
    std: np.ndarray
    count: np.ndarray

    def bands(self, probability: float = 0.95) -> tuple[np.ndarray, np.ndarray]:
        """Compute the prediction interval of one more healthy log at this probability, (k,) each, by Student's t."""
        from scipy.stats import t

        factor = t.ppf((1 + probability) / 2, np.maximum(self.count - 1, 1)) * np.sqrt(
            1 + 1 / np.maximum(self.count, 1)
        )
        half = factor * self.std
        return self.mean - half, self.mean + half


def baseline_of(values: np.ndarray) -> Baseline:
    """Compute the baseline of healthy logs, ``values`` (logs, k), NaN where a chart is not observable in a log."""
    there = np.isfinite(values)
    count = there.sum(axis=0)
    filled = np.where(there, values, 0.0)
    mean = filled.sum(axis=0) / np.maximum(count, 1)
    squares = np.sum(np.where(there, values - mean, 0.0) ** 2, axis=0)
    std = np.sqrt(squares / np.maximum(count - 1, 1))
    return Baseline(np.where(count > 0, mean, np.nan), np.where(count > 1, std, np.nan), count)


def covariance_between(values: np.ndarray, formula: np.ndarray, least: np.ndarray) -> np.ndarray:
    """Estimate the covariance (k, k) between healthy logs, positive definite however few they are.

    Parameters
    ----------
    values : ndarray
        (logs, k) of charts that every log shows.
    formula : ndarray
        (k, k) covariance of one log for independent residuals, whose correlations it is shrunk to.
    least : ndarray
        (k,) standard deviations of one log, below which logs do not scatter.
    """
    logs, k = values.shape
    deviations = values - values.mean(axis=0)
    S = deviations.T @ deviations / max(logs - 1, 1)
    sizes = np.sqrt(np.maximum(np.diag(S), least**2 / 4))
    of_formula = np.sqrt(np.maximum(np.diag(formula), 1e-300))
    target = formula / of_formula / of_formula[:, None]
    empirical = S / sizes / sizes[:, None]
    share = k / (k + max(logs - 1, 0))
    R = share * (0.9 * target + 0.1 * np.eye(k)) + (1 - share) * empirical
    np.fill_diagonal(R, 1.0)
    return np.asarray(R * sizes * sizes[:, None])
