"""Newton's method for currents that are bilinear in the parameters and 1/g, and covariances of the estimates.

The errors are ``e_j = v(t - d_j) - (W_theta theta + known) / g_j`` at the estimates (theta, g, d), a vector (k,); steps
and Jacobians are in theta, ``1 / g`` and the delays d.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from gtau.estimation.estimators.estimator import Solution
from gtau.estimation.regression.factors import FIXED, MODEL, SIGNAL, SIGNALS, delayed_signal, modelled, triangle
from gtau.estimation.regression.problem import Problem

DELAY_MOTION = 4.0  # standard errors of the share of motion in the current's rate of change
MIRRORED = 0.05  # share of a joint's error by which that at the negative delay must be larger for the delay to be real

STEPS, HALVINGS = 100, 20
NEAR = 1.0  # of log-likelihood gained by a step: the next ones follow the weights as well
CONVERGED = 1e-9  # of a standard deviation: a smaller step ends the iteration
SETTLED, PATIENCE = 0.02, 8  # of log-likelihood gained by a step, and how many such steps find no minimum
ROUNDING = 1e-14  # of the terms that make up the residuals: steps below this are rounding
RANK = 1e-13  # of the largest singular value: less is rounding
SHARED, OPEN = 1e-6, 1e3  # least part in a direction without effect, and relative standard deviation of its gain
FLATTEST = 0.05  # least curvature accepted, as a share of the Gauss-Newton curvature
LARGEST_STEP = 1e8  # of leaving a block out, in standard deviations: more, and only that block identifies it


def least_squares(A: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Solve ``min |A x - y|`` with the columns scaled to one norm."""
    norms = np.linalg.norm(A, axis=0)
    norms[norms == 0] = 1.0
    return np.linalg.lstsq(A / norms, y, rcond=None)[0] / norms


def split(values: np.ndarray, channels: int) -> list[np.ndarray]:
    """Split estimates (k,) into parameters, gains and delays."""
    return [values[: -2 * channels], values[-2 * channels : -channels], values[-channels:]]


def moved(values: np.ndarray, step: np.ndarray, channels: int) -> np.ndarray:
    """Move estimates (k,) by a step in theta, 1 / g (if it is free) and the delays."""
    theta, gains, delays = split(values, channels)
    if len(step) == len(values):
        inverse = 1 / gains + step[len(theta) : -channels]
        gains = 1 / np.where(inverse == 0, np.finfo(float).eps / gains, inverse)  # no gain is infinite
    return np.concatenate([theta + step[: len(theta)], gains, delays + step[-channels:]])


def residuals(blocks: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Compute residuals (..., n, p) of blocks (..., n, p, n_theta + 4)."""
    theta, gains, delays = split(values, blocks.shape[-3])
    return delayed_signal(blocks, delays) - modelled(blocks, theta) / gains[:, None]


def squared(blocks: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Sum the squared residuals of each channel, (..., n)."""
    return np.asarray(np.sum(residuals(blocks, values) ** 2, axis=-1))


def jacobian(blocks: np.ndarray, values: np.ndarray, problem: Problem, free_gains: bool) -> np.ndarray:
    """Differentiate the residuals with respect to (theta, 1 / g, d) or (theta, d), (..., n, p, parameters)."""
    theta, gains, delays = split(values, len(problem.channels))
    eye = np.eye(len(gains))[:, None, :]
    parts = [-blocks[..., MODEL] / gains[:, None, None]]
    if free_gains:
        parts.append(-modelled(blocks, theta)[..., None] * (eye * problem.unknown_gains))
    _, rate, change = np.moveaxis(blocks[..., SIGNALS], -1, 0)
    shift = (delays[:, None] * change - rate) * (problem.longest_delays > 0)[:, None]
    parts.append(shift[..., None] * eye)
    return np.concatenate(parts, axis=-1)


def weighted(
    blocks: np.ndarray, values: np.ndarray, problem: Problem, free_gains: bool, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the residuals (., n p) of blocks (., n, p, n_theta + 4) and their Jacobian, times ``weights`` (n,)."""
    e = residuals(blocks, values) * weights[:, None]
    J = jacobian(blocks, values, problem, free_gains) * weights[:, None, None]
    shape = (*e.shape[:-2], e.shape[-2] * e.shape[-1])
    return e.reshape(shape), J.reshape(*shape, J.shape[-1])


def stacked(problem: Problem) -> np.ndarray:
    """Stack the joints' triangles, (n, p, n_theta + 4), filled up with zero rows."""
    triangles = np.zeros((len(problem.channels), max(map(len, problem.triangles)), problem.n_theta + FIXED))
    for j, R in enumerate(problem.triangles):
        triangles[j, : len(R)] = R
    return triangles


Weigh = Callable[[np.ndarray], np.ndarray]
"""Makes the weights (c,) of the channels' errors from the sums of their squares (c,)."""


def solve(problem: Problem, values: np.ndarray, weigh: Weigh, free_gains: bool) -> Solution:
    """Minimise the negative log-likelihood from ``values`` (k,); ``weigh`` makes weights (c,) from squares (c,).

    Far from the minimum each step of the gains takes along the parameters that are best with them: parameters trade
    against gains, so that steps in both would creep along a bent valley. Near it, weights follow the errors.
    """
    triangles = stacked(problem)
    n, end, rows = len(problem.channels), problem.n_theta, problem.total_rows
    sizes, J_known = np.abs(triangles), jacobian_of_known(problem, free_gains)

    def linearised(values: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        e, J = weighted(triangles, values, problem, free_gains, weights)
        return np.concatenate([e, errors_of_known(problem, values)]), np.concatenate([J, J_known])

    def loss(values: np.ndarray) -> float:
        squares = squared(triangles, values)
        weights, known = weigh(squares), errors_of_known(problem, values)
        return float(weights**2 @ squares + known @ known) / 2 - float(rows @ np.log(weights))

    before, near, settled = loss(values), False, 0
    for _ in range(STEPS):
        squares = squared(triangles, values)
        weights = weigh(squares)
        e, J = linearised(values, weights)
        back = whitening(J)
        follows = near * (weigh(2 * squares) != weights) / rows
        second = second_derivatives(triangles, values, problem, free_gains, weights, follows)
        # without parameters the signal is error, with the curvature of no model
        curvature, axes = np.linalg.eigh(np.eye(back.shape[1]) + back.T @ second @ back * values[:end].any())
        step = -back @ (axes @ ((axes.T @ (back.T @ (J.T @ e))) / np.maximum(np.abs(curvature), FLATTEST)))
        terms = sizes[:, :, SIGNAL] + modelled(sizes, np.abs(values[:end])) / np.abs(values[end : end + n, None])
        rounding = ROUNDING * float(np.linalg.norm(terms * weights[:, None]))
        highest = before + rounding * float(np.linalg.norm(e)) + ROUNDING * abs(before)
        for share in 0.5 ** np.arange(HALVINGS):
            after = moved(values, share * step, n)
            if free_gains and not near:
                e_after, J_after = linearised(after, weights)
                best = whitening(J_after[:, :end])
                after[:end] -= best @ (best.T @ (J_after[:, :end].T @ e_after))
            if (cost := loss(after)) <= highest:
                break
        else:
            after, cost = values, before
        smallest = max(CONVERGED * float(np.linalg.norm(e)) / np.sqrt(rows.sum()), rounding)
        converged = bool(np.linalg.norm(J @ step) < smallest * np.sqrt(J.shape[1]))
        near, settled = before - cost < NEAR, settled + (before - cost < SETTLED)
        values, before = after, cost
        # a gain that the data do not determine goes on to zero, while the likelihood hardly changes: others are found
        if converged := converged or settled == PATIENCE:
            break
    return replace(finish(problem, values, weigh(squared(triangles, values)), free_gains), converged=converged)


def second_derivatives(
    blocks: np.ndarray, values: np.ndarray, problem: Problem, free_gains: bool, weights: np.ndarray, follows: np.ndarray
) -> np.ndarray:
    """Compute what is missing from the Gauss-Newton curvature (m, m).

    Errors are bilinear in the parameters and 1/g and quadratic in the delays, and ``follows`` (c,) is one over the rows
    of the channels whose weights follow their errors.
    """
    n, end, e = len(weights), problem.n_theta, residuals(blocks, values) * (weights**2)[:, None]
    slopes = np.einsum("jp,jpk->jk", e, jacobian(blocks, values, problem, free_gains))
    second = -2 * (slopes.T * follows) @ slopes
    second[-n:, -n:] += np.diag(curvature_of_delays(blocks, values, problem, weights))
    if free_gains:
        bilinear = np.einsum("jp,jpk->jk", e, blocks[..., MODEL]) * problem.unknown_gains[:, None]
        second[end : end + n, :end] -= bilinear
        second[:end, end : end + n] -= bilinear.T
    return second


def curvature_of_delays(blocks: np.ndarray, values: np.ndarray, problem: Problem, weights: np.ndarray) -> np.ndarray:
    """Compute what ``e e'' `` adds to the curvature of the cost in each joint's delay, (..., n).

    Where motions are slow and the current's noise white, ``v'`` is mostly noise; the Gauss-Newton approximation then
    overestimates the curvature, and its steps in the delays are a hundred times too short.
    """
    second = np.einsum("...jp,...jp->...j", residuals(blocks, values), blocks[..., -1])
    return np.asarray(second * weights**2 * (problem.longest_delays > 0))


def delays_lost_in_noise(problem: Problem, solution: Solution) -> np.ndarray:
    """Mark the channels whose current hardly changes but for its noise, and says nothing of the delay's sign, (c,).

    A delay is read off the current's rate of change. Where a joint moves slowly, that is mostly noise, which looks the
    same at any delay. What the expansion ``v - d v' + d^2/2 v''`` makes of the noise then places the minimum, and gives
    it a curvature of its own. Noise is smoothed as well by the delay ``-d``, for which a motion is too late twice over.
    """
    rate, change = np.moveaxis(problem.blocks[..., SIGNALS], -1, 0)[1:]  # (U, c, p) each
    squares = np.einsum("ujp,ujp->uj", rate, rate)
    # what is not motion is noise n, of which n n'' takes away on average what n'^2 adds (parts integrated)
    e = problem.blocks[..., SIGNAL] - modelled(problem.blocks, solution.theta) / solution.gains[:, None]
    motion_squares = squares + np.einsum("ujp,ujp->uj", e, change)
    share = motion_squares.sum(axis=0) / np.maximum(squares.sum(axis=0), 1e-300)
    # the error of a ratio, from its scatter over the units
    error = np.linalg.norm(motion_squares - share * squares, axis=0)
    channels = zip(problem.own_currents, problem.own_delays, strict=True)
    errors = np.array([[np.linalg.norm(delayed_signal(T, d)) for d in (delay, -delay)] for T, delay in channels])
    mirrored = errors[:, 0] >= (1 - MIRRORED) * errors[:, 1]
    return np.asarray((motion_squares.sum(axis=0) <= DELAY_MOTION * error) & mirrored)


def whitening(rows: np.ndarray, curvature: np.ndarray | None = None) -> np.ndarray:
    """Compute ``B`` (k, .) with ``B B^T = (rows^T rows)^-1``, its last diagonal entries raised by ``curvature``.

    Directions without any effect are left out, and directions of almost no curvature are given a small one.
    """
    norms = np.linalg.norm(rows, axis=0)
    norms[norms == 0] = 1.0
    back = _inverse(triangle(rows / norms)) / norms[:, None]
    if curvature is None:
        return np.asarray(back)
    # few directions have curvature; Q is their orthonormal basis, and all other directions stay as they are
    Q, S = np.linalg.qr(back[len(back) - len(curvature) :].T)
    values, vectors = np.linalg.eigh(np.eye(len(S)) + (S * curvature) @ S.T)
    root = (vectors / np.sqrt(np.maximum(values, FLATTEST))) @ vectors.T
    return np.asarray(back + (back @ Q) @ (root - np.eye(len(S))) @ Q.T)


def _inverse(R: np.ndarray) -> np.ndarray:
    """Invert a triangular factor R (k, k); the pseudo-inverse, without directions of rounding, where it is singular."""
    from scipy.linalg.lapack import dtrtri

    if R.shape[0] == R.shape[1]:
        inverse, singular = dtrtri(R)
        if not singular and np.linalg.norm(R) * np.linalg.norm(inverse) * RANK < 1:
            return np.asarray(inverse)
    _, s, Vt = np.linalg.svd(R, full_matrices=False)
    kept = s > RANK * s[0]
    return np.asarray(Vt[kept].T / s[kept])


def curved(gauss: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Add ``gauss + second`` (k, k), where delays keep at least ``FLATTEST`` of the Gauss-Newton curvature."""
    try:
        np.linalg.cholesky((1 - FLATTEST) * gauss + second)
        return np.asarray(gauss + second)
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(gauss)
        kept = values > RANK * values[-1]
        root = vectors[:, kept] * np.sqrt(values[kept])
        inverse = vectors[:, kept] / np.sqrt(values[kept])
        shares, axes = np.linalg.eigh(np.eye(root.shape[1]) + inverse.T @ second @ inverse)
        return np.asarray(root @ (axes * np.maximum(shares, FLATTEST)) @ axes.T @ root.T)


def jacobian_of_known(problem: Problem, free_gains: bool) -> np.ndarray:
    """Compute the Jacobian (k + m, parameters) of :func:`errors_of_known`: by theta, or by ``1 / g`` if it is free."""
    more = (2 if free_gains else 1) * len(problem.channels)
    J = np.pad(problem.known[:, :-1], ((0, len(problem.voltages)), (0, more)))
    if free_gains:
        channels, _, weights = problem.voltages.T
        J[range(len(problem.known), len(J)), problem.n_theta + channels.astype(int)] = weights
    return J


def errors_of_known(problem: Problem, values: np.ndarray) -> np.ndarray:
    """Compute the residuals (k + m,) of the known parameters, and of the gains from voltages."""
    theta, gains, _ = split(values, len(problem.channels))
    channels, inverse, weights = problem.voltages.T
    parameters = problem.known[:, :-1] @ theta - problem.known[:, -1]
    return np.concatenate([parameters, weights * (1 / gains[channels.astype(int)] - inverse)])


def finish(problem: Problem, values: np.ndarray, weights: np.ndarray, free_gains: bool) -> Solution:
    """Compute the covariances at the estimates ``values`` (k,)."""
    triangles = stacked(problem)
    filled, J_known = triangles.any(axis=-1), jacobian_of_known(problem, free_gains)
    n, size = len(problem.channels), J_known.shape[1]
    # eqs. (25) and (26), joint by joint
    sigma = np.sqrt(squared(triangles, values) / np.maximum(problem.total_rows - size / n, 1))
    J = (jacobian(triangles, values, problem, free_gains) * weights[:, None, None])[filled]
    rows = np.concatenate([J, J_known])
    # from whitened to physical parameters
    back = whitening(rows, curvature_of_delays(triangles, values, problem, weights))
    white = J @ back * (sigma * weights)[np.nonzero(filled)[0], None]
    prior_covariance = back @ (back.T @ (J_known.T @ J_known) @ back) @ back.T
    # eq. (27), with the errors' own variance in every joint
    formula = back @ (white.T @ white) @ back.T + prior_covariance
    T = to_gains(values, n, free_gains)

    def curvature(blocks: np.ndarray) -> np.ndarray:
        added = back[size - n :]
        return np.asarray((added.T * curvature_of_delays(blocks, values, problem, weights)) @ added)

    def replicates() -> np.ndarray:
        # one step from the solution, with unit u left out
        whitened, second, blocks = rows @ back, curvature(triangles), []
        gauss = whitened.T @ whitened
        for block in problem.units:
            e_u, J_u = weighted(block, values, problem, free_gains, weights)
            filled_u = block.any(axis=-1).reshape(-1)
            e_u, J_u = e_u[filled_u], J_u[filled_u] @ back
            others = curved(gauss - J_u.T @ J_u, second - curvature(block))
            blocks.append((np.eye(len(others)) - others, J_u.T @ e_u))
        return one_step(blocks) @ (T @ back).T

    opened, gains = np.zeros(len(values)), slice(-2 * n, -n)
    if free_gains and back.shape[1] < np.count_nonzero(rows.any(axis=0)):
        # gains that others take back without any effect are not determined, but for those that have none
        norms = np.linalg.norm(rows, axis=0)
        _, s, Vt = np.linalg.svd(triangle(rows / np.where(norms > 0, norms, 1.0)), full_matrices=False)
        lost = (np.abs(Vt[s <= RANK * s[0]]).max(axis=0, initial=0.0) > SHARED) & (norms > 0)
        opened[gains] = (OPEN * values[gains] * lost[gains]) ** 2
    formula = T @ formula @ T.T + np.diag(opened)
    prior_covariance = T @ prior_covariance @ T.T + np.diag(opened)
    return Solution(problem.unknowns, values, sigma, formula, replicates, {}, prior_covariance)


def to_gains(values: np.ndarray, channels: int, free_gains: bool) -> np.ndarray:
    """Differentiate estimates (theta, g, d) with respect to the unknowns of :func:`jacobian`, (k, .)."""
    slopes = np.ones(len(values))
    slopes[-2 * channels : -channels] = -(values[-2 * channels : -channels] ** 2)
    T = np.diag(slopes)
    return T if free_gains else np.delete(T, np.s_[-2 * channels : -channels], axis=1)


def one_step(blocks: Iterable[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Take Newton's steps (U, k) from the estimates of all units to those without each.

    ``blocks`` are each unit's shares in the normal equations: in their matrix (k, k), which adds up to the unit matrix,
    and in their left-hand side (k,), which adds up to zero.
    """
    steps = []
    for share, side in blocks:
        others = np.eye(len(share)) - share
        try:
            inverse = np.linalg.inv(others)
            if np.abs(inverse).max() > LARGEST_STEP:
                raise np.linalg.LinAlgError
            steps.append(inverse @ side)
        except np.linalg.LinAlgError:  # directions identified by this block alone stay unchanged
            steps.append(np.linalg.lstsq(others, side, rcond=1e-10)[0])
    return np.array(steps)


def degrees_of_freedom(problem: Problem, solution: Solution, free_gains: bool) -> np.ndarray:
    """Compute the degrees of freedom (k,) of the jackknife standard deviations, for intervals by the t distribution.

    As many as there are blocks, less one, if all carry the same information on a parameter. Often a few carry nearly
    all: Coulomb friction of a passive joint shows where that joint reverses. The information of each block follows from
    the motions (Satterthwaite's rule, as Bell and McCaffrey use it): ``(sum s_u^2)^2 / sum s_u^4`` with s_u^2 the
    variance that leaving out block u contributes, for independent residuals. Known parameters belong to no block; their
    standard deviations count as known.
    """
    values, n = solution.values, len(problem.channels)
    weights = 1 / np.maximum(solution.sigma, problem.smallest_sigma)
    _, rows = weighted(stacked(problem), values, problem, free_gains, weights)
    back = whitening(np.concatenate([rows, jacobian_of_known(problem, free_gains)]))
    named = to_gains(values, n, free_gains) @ back
    variances = []
    for block in problem.units:
        J = weighted(block, values, problem, free_gains, weights)[1] @ back
        others = np.eye(J.shape[1]) - J.T @ J
        try:
            row_influence = np.linalg.solve(others, J.T)
        except np.linalg.LinAlgError:  # identified by this block alone
            row_influence = np.linalg.pinv(others, rcond=1e-10, hermitian=True) @ J.T
        variances.append(np.sum((named @ row_influence) ** 2, axis=1))
    total = np.sum(variances, axis=0)
    squares = np.sum(np.square(variances), axis=0)
    count = float(len(problem.units))
    share = np.divide(total**2, squares, out=np.full(len(total), count), where=squares > 0)
    return np.asarray(np.clip(share - 1, 1.0, count - 1))
