"""The homogeneous system ``W_tot chi_tot = 0`` of eq. (33) and its two solutions by SVD.

``W_tot = [-W_theta  V_tau  -known]`` and ``chi_tot = [theta g 1]``: all unknowns stand on one side, and
the known payload sets the scale. The paper's TLS (eqs. 34 to 39) takes every column for equally
noisy; mixed LS-TLS takes the regressor for exact and the current columns for noisy.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.estimators.solution import Solution
from gtau.estimation.regression.problem import Problem, delayed
from gtau.estimation.regression.triangle import leave_one_out, triangle

Solver = Callable[[np.ndarray], np.ndarray]  # W_tot (r, c) to chi_tot (c,)


def tls(problem: Problem) -> Solution:
    """The paper's total least squares (eqs. 33 to 39), rows weighted by each joint's sigma_W."""
    weights = 1 / np.array([_own_sigma_W(problem, j) for j in range(len(problem.joints))])
    blocks = _total(problem, weights)
    W_tot = triangle(*blocks)
    _, s, Vt = np.linalg.svd(W_tot)
    chi = _scaled(Vt[-1])
    sigma_W = s[-1] / np.sqrt(problem.total_rows.sum() - len(s))  # eq. 38
    covariance = sigma_W**2 * (1 + chi[:-1] @ chi[:-1]) * _inverse_of_compatible(s, Vt.T)
    statistics = {"singular_ratio": float(s[-2] / s[-1]), "sigma_W": float(sigma_W)}
    return _solution(problem, chi, covariance, blocks, lambda W: _scaled(np.linalg.svd(W)[2][-1]), statistics)


def mixed(problem: Problem) -> Solution:
    """Mixed LS-TLS: the regressor exact, the currents noisy, rows scaled by each joint's current residual.

    The exact columns are eliminated by a QR factorisation; the gains are the direction in which the
    current columns are left smallest, relative to their noise.
    """
    n, n_theta = len(problem.joints), problem.n_theta
    noise = np.sqrt(problem.total_rows / problem.total_rows.mean())

    def solver(W: np.ndarray) -> np.ndarray:
        exact = [*range(n_theta), n_theta + n]
        R = triangle(W[:, [*exact, *range(n_theta, n_theta + n)]])
        m = len(exact)
        gains = np.linalg.svd(R[m:, m:] / noise)[2][-1] / noise
        scales = np.linalg.norm(R[:m, :m], axis=0)
        rest = np.linalg.solve(R[:m, :m] / scales, -R[:m, m:] @ gains) / scales
        return _scaled(np.concatenate([rest[:-1], gains, rest[-1:]]))

    weights = 1 / problem.own_sigma
    blocks = _total(problem, weights)
    W_tot = triangle(*blocks)
    chi = solver(W_tot)
    # scaled rows hold currents with errors of one size, which enter the equations through the gains
    squares = chi[n_theta:-1] ** 2
    size = np.sum((W_tot @ chi) ** 2) / (squares @ problem.total_rows * (1 - len(chi) / problem.total_rows.sum()))
    back = np.linalg.pinv(triangle(W_tot[:, :-1]))
    middle = np.zeros((len(chi) - 1, len(chi) - 1))
    for j, R in enumerate(problem.triangles):
        white = _rows(problem, R, j, weights[j])[:, :-1] @ back
        middle += squares[j] * white.T @ white
    return _solution(problem, chi, size * back @ middle @ back.T, blocks, solver, {})


def _total(problem: Problem, weights: np.ndarray) -> list[np.ndarray]:
    """Triangular factors of the weighted ``W_tot`` of every unit, (U,) of (., n_theta + n + 1)."""
    joints = range(len(problem.joints))
    return [triangle(*(_rows(problem, block[j], j, weights[j]) for j in joints)) for block in problem.blocks]


def _rows(problem: Problem, block: np.ndarray, j: int, weight: float) -> np.ndarray:
    """Rows of ``W_tot`` from a block (., n_theta + 4) of joint j."""
    n_theta = problem.n_theta
    rows = np.zeros((len(block), n_theta + len(problem.joints) + 1))
    rows[:, :n_theta] = -block[:, :n_theta]
    rows[:, n_theta + j] = block[:, n_theta + 1 :] @ delayed(problem.own_delays[j])
    rows[:, -1] = -block[:, n_theta]
    return weight * rows


def _own_sigma_W(problem: Problem, j: int) -> float:
    """sigma_W of joint j from the TLS of its own equations (eq. 38)."""
    R = problem.triangles[j]
    current = R[:, problem.n_theta + 1 :] @ delayed(problem.own_delays[j])
    s = np.linalg.svd(np.column_stack([R[:, problem.own_columns[j]], current]), compute_uv=False)
    return float(s[-1] / np.sqrt(max(problem.total_rows[j] - len(s), 1)))


def _scaled(direction: np.ndarray) -> np.ndarray:
    if abs(direction[-1]) < 1e-12 * np.linalg.norm(direction):
        raise GtauError(
            "the data say nothing about the scale of the drive gains: the known payload does not show in the currents; "
            "use a heavier payload or motions that lift and accelerate it."
        )
    return direction / direction[-1]


def _inverse_of_compatible(s: np.ndarray, V: np.ndarray) -> np.ndarray:
    """``(W^T W)^-1`` of eq. (39) for the compatible system's first c-1 columns, without forming W^T W.

    With V partitioned as ``[[V1, a], [b^T, d]]``, orthogonality gives ``V1^-T = V1 - a b^T / d``.
    """
    V1, a, b, d = V[:-1, :-1], V[:-1, -1], V[-1, :-1], V[-1, -1]
    half = (V1 - np.outer(a, b) / d) / s[:-1]
    return half @ half.T


def _solution(
    problem: Problem,
    chi: np.ndarray,
    covariance: np.ndarray,
    blocks: list[np.ndarray],
    solver: Solver,
    statistics: dict[str, float],
) -> Solution:
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
