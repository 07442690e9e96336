"""How an effect drifts from run to run: an Ornstein-Uhlenbeck process along their order."""

from __future__ import annotations

import numpy as np

from gtau.estimation.estimators.estimator import Fit

ALONG = 3.0  # runs over which a drift is forgotten: some minutes of warm-up (experience; 1 and 10 change no interval
# of the experiments in docs/evidence/coverage.md by more than a fifth)
MODES = 8  # largest modes that are kept of a longer series


def runs_of(fit: Fit) -> int:
    """Count the runs of a fit."""
    return len(fit.dataset.runs)


def run_covariance(runs: int) -> np.ndarray:
    """Compute the covariance (runs, runs) of a drift of unit variance."""
    order = np.arange(runs)
    return np.exp(-np.abs(order[:, None] - order) / ALONG)


def run_modes(runs: int) -> np.ndarray:
    """Compute the modes (runs, modes) whose sum with independent unit sizes drifts like that."""
    values, vectors = np.linalg.eigh(run_covariance(runs))
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0)))[:, ::-1][:, :MODES])


def difference_root(runs: int) -> np.ndarray:
    """Factor the covariance of the differences from the mean of all runs but the last, (runs - 1, runs - 1)."""
    centred = np.eye(runs) - 1 / runs
    covariance = (centred @ run_covariance(runs) @ centred)[:-1, :-1]
    return np.linalg.cholesky(covariance + 1e-9 * np.eye(runs - 1))
