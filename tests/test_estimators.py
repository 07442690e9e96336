"""Estimators against formulas written down here, Monte Carlo, and each other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize

from idim.errors import IdimError
from idim.estimation.current_domain import ml, ols, two_stage, wls
from idim.estimation.homogeneous import leave_one_out, mixed, tls
from idim.estimation.problem import Problem, delayed
from idim.estimation.reduction import essential
from idim.estimation.solution import Solution
from idim.estimation.triangle import triangle

UNITS = 20
GAINS = np.array([2.0, -5.0])
DELAYS = np.array([2e-3, -1e-3])
THETA = np.array([1.5, -0.7, 0.4, 2.2, -1.1])
SIGMA = np.array([0.01, 0.003])
SLOWEST = 0.02

METHODS: dict[str, Callable[[Problem], Solution]] = {
    "ols": lambda problem: ols(problem, GAINS),
    "wls": lambda problem: wls(problem, GAINS),
    "ml": ml,
    "mixed": mixed,
    "tls": tls,
}
EVERY = pytest.mark.parametrize("method", METHODS)


def rows_of(
    rng: np.random.Generator, per_unit: int = 15, delays: np.ndarray = DELAYS, curved: bool = True
) -> np.ndarray:
    """Exact rows (U, n, p, n_theta + 4) of a random linear model; parameter 4 acts on joint 1 alone."""
    n, n_theta = len(GAINS), len(THETA)
    units = np.zeros((UNITS, n, per_unit, n_theta + 4))
    W, known, v1, v2 = np.split(units, [n_theta, n_theta + 1, n_theta + 3], axis=-1)[0:1] + [None] * 3
    W[:] = rng.normal(size=W.shape)
    W[:, 1, :, 4] = 0.0
    units[UNITS // 2 :, :, :, n_theta] = rng.normal(size=(UNITS // 2, n, per_unit))
    units[..., n_theta + 2] = 50 * rng.normal(size=units.shape[:3])
    units[..., n_theta + 3] = 5000 * rng.normal(size=units.shape[:3]) if curved else 0.0
    return filled(units, delays)


def filled(units: np.ndarray, delays: np.ndarray = DELAYS) -> np.ndarray:
    """The rows with the currents that follow from them."""
    n_theta = len(THETA)
    tau = units[..., :n_theta] @ THETA + units[..., n_theta]
    shift = np.stack([delayed(d)[1:] for d in delays])
    units[..., n_theta + 1] = tau / GAINS[:, None] - np.einsum("ujpk,jk->ujp", units[..., n_theta + 2 :], shift)
    return units


def problem_of(units: np.ndarray) -> Problem:
    names = tuple(f"p{k}" for k in range(units.shape[-1] - 4))
    joints = tuple(f"j{k}" for k in range(units.shape[1]))
    return Problem(names, joints, units, np.full(units.shape[:2], units.shape[2]), SLOWEST)


def noisy(units: np.ndarray, rng: np.random.Generator, sigma: np.ndarray = SIGMA) -> np.ndarray:
    """The rows with white noise on the currents."""
    units = units.copy()
    units[..., -3] += sigma[:, None] * rng.normal(size=units.shape[:3])
    return units
