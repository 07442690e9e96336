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

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from idim.errors import IdimError
from idim.estimation.problem import Problem, delayed
from idim.estimation.solution import Solution
from idim.estimation.triangle import triangle

STEPS = 200
SETTLED = 1e-9  # of a standard deviation: a smaller step ends the iteration
ROUNDING = 1e-14  # of the currents: no step can be told from rounding below this


@dataclass(frozen=True)
class State:
    """Unknowns of the current-domain model."""

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


def ml(problem: Problem, prior: np.ndarray | None = None) -> Solution:
    """Maximum likelihood of parameters, drive gains and delays, started from 2SLS.

    Parameters
    ----------
    problem : Problem
        All equations.
    prior : ndarray, optional
        Further equations (k, n_theta + 1): ``[P | y]`` for ``P theta = y`` with errors of unit variance.

    Raises
    ------
    IdimError
        Where the iteration does not settle.
    """
    first = two_stage(problem)
    start = State(first.theta, 1 / first.gains, first.delays)

    def weights(state: State, errors: np.ndarray) -> np.ndarray:
        return 1 / np.maximum(np.sqrt(errors / problem.total_rows), problem.smallest_sigma)

    return _solve(problem, start, weights, True, prior)


def two_stage(problem: Problem) -> Solution:
    """Two-stage least squares (2SLS).

    The currents are first projected on their own joint's regressor columns, which frees them of noise
    uncorrelated with the motion; the known payload then stands alone on the right-hand side.
    """
    n, n_theta = len(problem.joints), problem.n_theta
    coefficients = [
        least_squares(R[:, columns], R[:, n_theta + 1 :] @ delayed(d))
        for R, columns, d in zip(problem.triangles, problem.own_columns, problem.own_delays, strict=True)
    ]
    blocks = [_rows(problem, j, R, coefficients[j]) for j, R in enumerate(problem.triangles)]
    gains = np.ones(n)
    for _ in range(3):
        scale = 1 / (problem.own_sigma * np.abs(gains))
        A = np.concatenate([block * weight for block, weight in zip(blocks, scale, strict=True)])
        x = least_squares(A[:, :-1], -A[:, -1])
        gains = x[n_theta:]
        if not np.all(np.abs(gains) > 0):
            raise IdimError(
                "the currents of some joint do not follow its motion at all; check the columns of the current "
                "references."
            )
    state = State(x[:n_theta], 1 / gains, problem.own_delays)
    errors = np.sum(residuals(stacked(problem), state, n_theta) ** 2, axis=-1)
    weights = 1 / np.maximum(np.sqrt(errors / problem.total_rows), problem.smallest_sigma)
    solution = _finish(problem, stacked(problem), state, weights, errors, True, np.zeros((0, n_theta + 2 * n)))

    def replicates() -> np.ndarray:
        norms = np.linalg.norm(A[:, :-1], axis=0)
        norms[norms == 0] = 1.0
        back = np.linalg.pinv(triangle(A[:, :-1] / norms)) / norms[:, None]
        rows = []
        for unit in problem.units:
            # the projected currents of a unit are its regressor's rows with the coefficients of all units
            A_u = np.concatenate([_rows(problem, j, unit[j], coefficients[j]) * scale[j] for j in range(n)])
            e_u = (residuals(unit, state, n_theta) * (scale * gains)[:, None]).reshape(-1)
            rows.append((A_u[:, :-1] @ back, -e_u))
        return np.hstack([one_step(rows) @ back.T, np.zeros((len(problem.units), n))])  # delays are those of all units

    return replace(solution, replicates=replicates)


def _rows(problem: Problem, j: int, block: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Rows ``[W_theta -v_projected | known]`` of the second stage from a block (., n_theta + 4) of joint j."""
    n_theta = problem.n_theta
    rows = np.zeros((len(block), n_theta + len(problem.joints) + 1))
    rows[:, :n_theta], rows[:, -1] = block[:, :n_theta], block[:, n_theta]
    rows[:, n_theta + j] = -block[:, problem.own_columns[j]] @ coefficients
    return rows


def one_step(rows: Iterable[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Steps (U, k) from the estimates of all units to those without each, from whitened rows and errors of units."""
    steps = []
    for J, e in rows:
        left = np.eye(J.shape[1]) - J.T @ J
        try:
            L = np.linalg.cholesky(left)
            if np.diag(L).min() < 1e-4:
                raise np.linalg.LinAlgError
            steps.append(np.linalg.solve(left, J.T @ e))
        except np.linalg.LinAlgError:  # what only this unit tells stays as it is
            steps.append(np.linalg.lstsq(left, J.T @ e, rcond=1e-10)[0])
    return np.array(steps)


def _given(problem: Problem, gains: np.ndarray) -> State:
    return State(np.zeros(problem.n_theta), 1 / np.asarray(gains, dtype=float), problem.own_delays)


def least_squares(A: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Solution of ``min |A x - y|``, columns brought to one scale first."""
    norms = np.linalg.norm(A, axis=0)
    norms[norms == 0] = 1.0
    return np.linalg.lstsq(A / norms, y, rcond=None)[0] / norms


def residuals(blocks: np.ndarray, state: State, n_theta: int) -> np.ndarray:
    """Residuals (..., n, p) of blocks (..., n, p, n_theta + 4)."""
    shifts = np.stack([delayed(d) for d in state.delays])
    currents = np.einsum("...jpk,jk->...jp", blocks[..., n_theta + 1 :], shifts)
    return np.asarray(currents - state.b[:, None] * modelled(blocks, state, n_theta))


def modelled(blocks: np.ndarray, state: State, n_theta: int) -> np.ndarray:
    """Torques (..., n, p) that the model gives blocks (..., n, p, n_theta + 4)."""
    return np.asarray(np.einsum("...jpk,k->...jp", blocks[..., :n_theta], state.theta) + blocks[..., n_theta])


def jacobian(blocks: np.ndarray, state: State, problem: Problem, free_gains: bool) -> np.ndarray:
    """Derivatives of the residuals by (theta, b, d) or (theta, d), (..., n, p, parameters)."""
    n_theta = problem.n_theta
    W, currents = blocks[..., :n_theta], blocks[..., n_theta + 1 :]
    n = len(state.b)
    eye = np.eye(n)[:, None, :]
    parts = [-state.b[:, None, None] * W]
    if free_gains:
        parts.append(-modelled(blocks, state, n_theta)[..., None] * eye)
    shift = (state.delays[:, None] * currents[..., 2] - currents[..., 1]) * (problem.slowest > 0)
    parts.append(shift[..., None] * eye)
    return np.concatenate(parts, axis=-1)


def moved(state: State, step: np.ndarray, n_theta: int, free_gains: bool) -> State:
    """The state after a step in the unknowns of :func:`jacobian`."""
    n = len(state.b)
    b = state.b + step[n_theta : n_theta + n] if free_gains else state.b
    return State(state.theta + step[:n_theta], b, state.delays + step[-n:])


def stacked(problem: Problem) -> np.ndarray:
    """The joints' triangles in one array, (n, p, n_theta + 4), filled up with zero rows."""
    triangles = np.zeros((len(problem.joints), max(map(len, problem.triangles)), problem.n_theta + 4))
    for j, R in enumerate(problem.triangles):
        triangles[j, : len(R)] = R
    return triangles


def _solve(
    problem: Problem,
    start: State,
    weigh: Callable[[State, np.ndarray], np.ndarray],
    free_gains: bool,
    prior: np.ndarray | None = None,
) -> Solution:
    """Gauss-Newton with re-estimated weights, then the covariances."""
    n, n_theta = len(problem.joints), problem.n_theta
    triangles = stacked(problem)
    state = start

    size = _size(n, n_theta, free_gains)
    known = np.zeros((0, n_theta + 1)) if prior is None else prior
    J_known = np.pad(known[:, :-1], ((0, 0), (0, size - n_theta)))

    def errors(at: State) -> np.ndarray:
        return np.sum(residuals(triangles, at, n_theta) ** 2, axis=-1)

    def cost(at: State) -> float:
        return float(weights**2 @ errors(at) + np.sum((known[:, :-1] @ at.theta - known[:, -1]) ** 2))

    for _ in range(STEPS):
        weights = weigh(state, errors(state))
        J = (jacobian(triangles, state, problem, free_gains) * weights[:, None, None]).reshape(-1, size)
        J = np.concatenate([J, J_known])
        e = (residuals(triangles, state, n_theta) * weights[:, None]).reshape(-1)
        e = np.concatenate([e, known[:, :-1] @ state.theta - known[:, -1]])
        step = least_squares(J, -e)
        before, share = cost(state), 1.0
        while share > 1e-6 and cost(moved(state, share * step, n_theta, free_gains)) > before * (1 + 1e-12):
            share /= 2
        state = moved(state, share * step, n_theta, free_gains)
        level = np.linalg.norm(triangles[:, :, n_theta + 1] * weights[:, None])
        smallest = max(SETTLED * np.sqrt(before / problem.total_rows.sum()), ROUNDING * level)
        if np.linalg.norm(J @ step) < smallest * np.sqrt(J.shape[1]):
            break
    else:
        raise IdimError(
            "the maximum-likelihood iteration did not settle, so the data do not fix the drive gains; "
            "check the signs and units of positions and currents, add runs that move every joint or a heavier "
            "payload, or use --method wls with prior_gains."
        )
    return _finish(problem, triangles, state, weigh(state, errors(state)), errors(state), free_gains, J_known)


def _size(n: int, n_theta: int, free_gains: bool) -> int:
    return n_theta + (2 if free_gains else 1) * n


def _finish(
    problem: Problem,
    triangles: np.ndarray,
    state: State,
    weights: np.ndarray,
    errors: np.ndarray,
    free_gains: bool,
    J_known: np.ndarray,
) -> Solution:
    n, n_theta = len(problem.joints), problem.n_theta
    size = _size(n, n_theta, free_gains)
    sigma = np.sqrt(errors / np.maximum(problem.total_rows - size / n, 1))
    J = jacobian(triangles, state, problem, free_gains) * weights[:, None, None]  # (n, p, size)
    rows = np.concatenate([J.reshape(-1, size), J_known])
    norms = np.linalg.norm(rows, axis=0)
    norms[norms == 0] = 1.0
    R = triangle(rows / norms)
    back = np.linalg.pinv(R) / norms[:, None]  # from whitened to physical parameters
    white = (J @ back * (sigma * weights)[:, None, None]).reshape(-1, size)
    of_prior = back @ (back.T @ (J_known.T @ J_known) @ back) @ back.T
    formula = back @ (white.T @ white) @ back.T + of_prior
    gains = 1 / state.b
    # from (theta, b, d) or (theta, d) to (theta, g, d)
    T = np.zeros((n_theta + 2 * n, size))
    T[:n_theta, :n_theta] = np.eye(n_theta)
    if free_gains:
        T[n_theta : n_theta + n, n_theta : n_theta + n] = np.diag(-(gains**2))
    T[n_theta + n :, size - n :] = np.eye(n)

    def replicates() -> np.ndarray:
        # one Gauss-Newton step from the solution, with unit u left out
        rows = (
            (
                (jacobian(unit, state, problem, free_gains) * weights[:, None, None]).reshape(-1, size) @ back,
                (residuals(unit, state, n_theta) * weights[:, None]).reshape(-1),
            )
            for unit in problem.units
        )
        return one_step(rows) @ (T @ back).T

    return Solution(state.theta, gains, state.delays, sigma, T @ formula @ T.T, replicates, {}, T @ of_prior @ T.T)
