"""The homogeneous system ``W_tot chi_tot = 0`` of eq. (33), which total least squares solves by SVD.

``W_tot = [-W_theta  V_tau  -known]`` and ``chi_tot = [theta g 1]``: all unknowns stand on one side, and
the known payload sets the scale.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.estimators.solution import Solution
from gtau.estimation.regression.problem import Problem, delayed
from gtau.estimation.regression.triangle import leave_one_out, triangle

Solver = Callable[[np.ndarray], np.ndarray]  # W_tot (r, c) to chi_tot (c,)


def total_matrix(problem: Problem, weights: np.ndarray) -> list[np.ndarray]:
    """Build triangular factors of the weighted ``W_tot`` of every unit (eq. 33), (U,) of (., n_theta + n + 1)."""
    joints = range(len(problem.joints))
    return [triangle(*(total_rows_of(problem, block[j], j, weights[j]) for j in joints)) for block in problem.blocks]


def total_rows_of(problem: Problem, block: np.ndarray, j: int, weight: float) -> np.ndarray:
    """Build rows of ``W_tot`` from a block (., n_theta + 4) of joint j (eq. 33)."""
    n_theta = problem.n_theta
    rows = np.zeros((len(block), n_theta + len(problem.joints) + 1))
    rows[:, :n_theta] = -block[:, :n_theta]
    rows[:, -1] = -block[:, n_theta]
    # a gain that is known stands with the known payload
    rows[:, n_theta + j if problem.free[j] else -1] += block[:, n_theta + 1 :] @ delayed(problem.own_delays[j])
    return weight * rows


def scaled(direction: np.ndarray) -> np.ndarray:
    """Scale a solution so that its last entry is 1, by which the known payload sets the scale."""
    if abs(direction[-1]) < 1e-12 * np.linalg.norm(direction):
        raise GtauError(
            "the data do not determine the scale of the drive gains: the known payload does not show in the currents; "
            "use a heavier payload or motions that lift and accelerate it."
        )
    return direction / direction[-1]


def solution_of(
    problem: Problem,
    chi: np.ndarray,
    covariance: np.ndarray,
    blocks: list[np.ndarray],
    solver: Solver,
    statistics: dict[str, float],
) -> Solution:
    """Make the solution from ``chi_tot`` (c,) and the covariance of all but its last entry."""
    n, n_theta = len(problem.joints), problem.n_theta
    theta, gains = chi[:n_theta], chi[n_theta:-1]
    errors = np.zeros(n)
    for j, R in enumerate(problem.triangles):
        current = R[:, n_theta + 1 :] @ delayed(problem.own_delays[j])
        errors[j] = np.sum((current - (R[:, :n_theta] @ theta + R[:, n_theta]) / gains[j]) ** 2)
    sigma = np.sqrt(errors / np.maximum(problem.total_rows - (n_theta + n) / n, 1))
    full = np.zeros((n_theta + 2 * n, n_theta + 2 * n))
    full[: n_theta + n, : n_theta + n] = covariance

    def replicates() -> np.ndarray:
        shifts = np.array([solver(W)[:-1] - chi[:-1] for W in leave_one_out(blocks)])
        return np.hstack([shifts, np.zeros((len(blocks), n))])  # the delays are those of all units

    return Solution(theta, gains, problem.own_delays, sigma, full, replicates, statistics)
