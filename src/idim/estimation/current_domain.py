"""Least squares in the domain of the current references: OLS, WLS and maximum likelihood.

All noise is taken to be the current's, of its own size in every joint,

    e_j = v(t - d_j) - (W_theta theta + known) / g_j .

With the gains given this is linear least squares: ordinary where torque errors count alike in every
joint (eq. 24), weighted by each joint's own error level (eq. 28). With the gains free as well it is
the maximum-likelihood estimate, bilinear in theta and 1/g, and sigma_j is estimated from the current
residuals alone. (From torque residuals of the homogeneous system a gain could buy a small residual
by collapsing to zero.)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from idim.errors import IdimError
from idim.estimation.problem import Problem, delayed
from idim.estimation.solution import Solution
from idim.estimation.triangle import triangle

STEPS = 200
SETTLED = 1e-9  # of a standard deviation: a smaller step ends the iteration
ROUNDING = 1e-14  # of the currents: no step can be told from rounding below this


@dataclass(frozen=True)
class _State:
    theta: np.ndarray
    b: np.ndarray  # 1 / g
    delays: np.ndarray


def ols(problem: Problem, gains: np.ndarray) -> Solution:
    """Ordinary least squares with given ``gains`` (n,): every joint's torque error counts alike (eq. 24)."""
    return _solve(problem, _given(problem, gains), lambda state, errors: np.abs(1 / state.b), free_gains=False)


def wls(problem: Problem, gains: np.ndarray) -> Solution:
    """Weighted least squares with given ``gains`` (n,): joints weighted by their own error level (eq. 28)."""
    weights = 1 / problem.own_sigma
    return _solve(problem, _given(problem, gains), lambda state, errors: weights, free_gains=False)


def ml(problem: Problem) -> Solution:
    """Maximum likelihood of parameters, drive gains and delays, started from 2SLS.

    Raises
    ------
    IdimError
        Where the iteration does not settle.
    """
    gains, theta = two_stage(problem)
    start = _State(theta, 1 / gains, problem.own_delays)

    def weights(state: _State, errors: np.ndarray) -> np.ndarray:
        return 1 / np.maximum(np.sqrt(errors / problem.total_rows), problem.smallest_sigma)

    return _solve(problem, start, weights, free_gains=True)


def two_stage(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Two-stage least squares (2SLS): gains (n,) and theta.

    The currents are first projected on their own joint's regressor columns, which frees them of noise
    uncorrelated with the motion; the known payload then stands alone on the right-hand side.
    """
    n, n_theta = len(problem.joints), problem.n_theta
    scale = 1 / problem.own_sigma
    for _ in range(3):
        blocks = []
        for j, (R, columns) in enumerate(zip(problem.triangles, problem.own_columns, strict=True)):
            current = R[:, n_theta + 1 :] @ delayed(problem.own_delays[j])
            Q = np.linalg.qr(R[:, columns])[0]
            block = np.zeros((R.shape[0], n_theta + n + 1))
            block[:, :n_theta], block[:, -1] = R[:, :n_theta], R[:, n_theta]
            block[:, n_theta + j] = -(Q @ (Q.T @ current))
            blocks.append(block * scale[j])
        A = np.concatenate(blocks)
        x = _least_squares(A[:, :-1], -A[:, -1])
        gains = x[n_theta:]
        if not np.all(np.abs(gains) > 0):
            raise IdimError(
                "the currents of some joint do not follow its motion at all; check the columns of the current "
                "references."
            )
        scale = 1 / (problem.own_sigma * np.abs(gains))
    return gains, x[:n_theta]


def _given(problem: Problem, gains: np.ndarray) -> _State:
    return _State(np.zeros(problem.n_theta), 1 / np.asarray(gains, dtype=float), problem.own_delays)


def _least_squares(A: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Solution of ``min |A x - y|``, columns brought to one scale first."""
    norms = np.linalg.norm(A, axis=0)
    norms[norms == 0] = 1.0
    return np.linalg.lstsq(A / norms, y, rcond=None)[0] / norms


def _residuals(blocks: np.ndarray, state: _State, n_theta: int) -> np.ndarray:
    """Residuals (..., n, p) of blocks (..., n, p, n_theta + 4)."""
    W, known, currents = blocks[..., :n_theta], blocks[..., n_theta], blocks[..., n_theta + 1 :]
    modelled = np.einsum("...jpk,k->...jp", W, state.theta) + known
    shifts = np.stack([delayed(d) for d in state.delays])
    return np.einsum("...jpk,jk->...jp", currents, shifts) - state.b[:, None] * modelled


def _jacobian(blocks: np.ndarray, state: _State, problem: Problem, free_gains: bool) -> np.ndarray:
    """Derivatives of the residuals by (theta, b, d) or (theta, d), (..., n, p, parameters)."""
    n_theta = problem.n_theta
    W, known, currents = blocks[..., :n_theta], blocks[..., n_theta], blocks[..., n_theta + 1 :]
    n = len(state.b)
    modelled = np.einsum("...jpk,k->...jp", W, state.theta) + known
    eye = np.eye(n)[:, None, :]
    parts = [-state.b[:, None, None] * W]
    if free_gains:
        parts.append(-modelled[..., None] * eye)
    shift = (state.delays[:, None] * currents[..., 2] - currents[..., 1]) * (problem.slowest > 0)
    parts.append(shift[..., None] * eye)
    return np.concatenate(parts, axis=-1)


def _moved(state: _State, step: np.ndarray, n_theta: int, free_gains: bool) -> _State:
    n = len(state.b)
    b = state.b + step[n_theta : n_theta + n] if free_gains else state.b
    return _State(state.theta + step[:n_theta], b, state.delays + step[-n:])


def _stacked(problem: Problem) -> np.ndarray:
    """The joints' triangles in one array, (n, p, n_theta + 4), filled up with zero rows."""
    triangles = np.zeros((len(problem.joints), max(map(len, problem.triangles)), problem.n_theta + 4))
    for j, R in enumerate(problem.triangles):
        triangles[j, : len(R)] = R
    return triangles


def _solve(
    problem: Problem,
    start: _State,
    weigh: Callable[[_State, np.ndarray], np.ndarray],
    free_gains: bool,
) -> Solution:
    """Gauss-Newton with re-estimated weights, then the covariances."""
    n, n_theta = len(problem.joints), problem.n_theta
    triangles = _stacked(problem)
    state = start

    def errors(at: _State) -> np.ndarray:
        return np.sum(_residuals(triangles, at, n_theta) ** 2, axis=-1)

    for _ in range(STEPS):
        weights = weigh(state, errors(state))
        J = (_jacobian(triangles, state, problem, free_gains) * weights[:, None, None]).reshape(
            -1, _size(n, n_theta, free_gains)
        )
        e = (_residuals(triangles, state, n_theta) * weights[:, None]).reshape(-1)
        step = _least_squares(J, -e)
        before, share = float(e @ e), 1.0
        while share > 1e-6 and float(weights**2 @ errors(_moved(state, share * step, n_theta, free_gains))) > before * (
            1 + 1e-12
        ):
            share /= 2
        state = _moved(state, share * step, n_theta, free_gains)
        level = np.linalg.norm(triangles[:, :, n_theta + 1] * weights[:, None])
        smallest = max(SETTLED * np.sqrt(before / problem.total_rows.sum()), ROUNDING * level)
        if np.linalg.norm(J @ step) < smallest * np.sqrt(J.shape[1]):
            break
    else:
        raise IdimError(
            "the maximum-likelihood iteration did not settle, so the data do not fix the drive gains; "
            "add runs that move every joint, a heavier payload, or use --method wls with prior_gains."
        )
    return _finish(problem, triangles, state, weigh(state, errors(state)), errors(state), free_gains)


def _size(n: int, n_theta: int, free_gains: bool) -> int:
    return n_theta + (2 if free_gains else 1) * n


def _finish(
    problem: Problem, triangles: np.ndarray, state: _State, weights: np.ndarray, errors: np.ndarray, free_gains: bool
) -> Solution:
    n, n_theta = len(problem.joints), problem.n_theta
    size = _size(n, n_theta, free_gains)
    sigma = np.sqrt(errors / np.maximum(problem.total_rows - size / n, 1))
    J = _jacobian(triangles, state, problem, free_gains) * weights[:, None, None]  # (n, p, size)
    norms = np.linalg.norm(J.reshape(-1, size), axis=0)
    norms[norms == 0] = 1.0
    R = triangle((J / norms).reshape(-1, size))
    back = np.linalg.pinv(R) / norms[:, None]  # from whitened to physical parameters
    white = (J @ back * (sigma * weights)[:, None, None]).reshape(-1, size)
    formula = back @ (white.T @ white) @ back.T
    gains = 1 / state.b
    # from (theta, b, d) or (theta, d) to (theta, g, d)
    T = np.zeros((n_theta + 2 * n, size))
    T[:n_theta, :n_theta] = np.eye(n_theta)
    if free_gains:
        T[n_theta : n_theta + n, n_theta : n_theta + n] = np.diag(-(gains**2))
    T[n_theta + n :, size - n :] = np.eye(n)

    def replicates() -> np.ndarray:
        # one Gauss-Newton step from the solution, with unit u left out
        steps = np.empty((len(problem.units), size))
        for u, unit in enumerate(problem.units):
            J_u = (_jacobian(unit, state, problem, free_gains) * weights[:, None, None]).reshape(-1, size) @ back
            e_u = (_residuals(unit, state, n_theta) * weights[:, None]).reshape(-1)
            steps[u] = back @ np.linalg.lstsq(np.eye(size) - J_u.T @ J_u, J_u.T @ e_u, rcond=1e-10)[0]
        return steps @ T.T

    return Solution(state.theta, gains, state.delays, sigma, T @ formula @ T.T, replicates)
