"""Least squares: ordinary and weighted with given drive gains (eqs. 24 to 28), two-stage, and total (eqs. 33 to 39).

Choose ``wls`` for logs of true torques, or if the gains are known better than a payload can determine them: each
joint is weighted by its own residual standard deviation (eq. 28). ``ols`` (eq. 24) weights all torque errors
alike; it is there for comparison. All noise is the current's, of its own standard deviation in every joint,

    e_j = v(t - d_j) - (W_theta theta + known) / g_j .

Choose ``2sls`` for a cross-check: with currents replaced by their projections on their own joint's regressor, it is
consistent with noisy currents, needs no iteration, and shares no weights with the others. Maximum likelihood starts
from it.

Choose ``tls`` to follow the paper, or to compare with published results: it assumes equal noise in every column of
``W_tot``. On real logs this seldom holds, and gains may be absurd where maximum likelihood gives accurate ones.
``W_tot = [-W_theta  V_tau  -known]`` and ``chi_tot = [theta g 1]``: all unknowns are on one side, and the known
payload fixes the scale.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.estimators.estimator import Estimator, Fit, FitSystem, Gains, Solution, Solve
from gtau.estimation.estimators.newton import Weigh, finish, least_squares, one_step, residuals, solve, squared, stacked
from gtau.estimation.regression.dataset import System
from gtau.estimation.regression.factors import delayed_signal, leave_one_out, modelled, triangle
from gtau.estimation.regression.problem import Problem
from gtau.findings import Progress, silent


def ols(problem: Problem, gains: np.ndarray) -> Solution:
    """Solve ordinary least squares with given ``gains`` (n,): all torque errors weighted alike (eq. 24)."""
    weights = np.abs(np.asarray(gains, dtype=float))
    return _with_given(problem, gains, lambda squares: weights, "ordinary")


def wls(problem: Problem, gains: np.ndarray, delays: np.ndarray | None = None) -> Solution:
    """Solve weighted least squares (eq. 28) with ``gains`` (n,), from ``delays`` (c,) if given."""

    def weights(squares: np.ndarray) -> np.ndarray:
        # a silent channel by its residuals, as with maximum likelihood: it has no error level of its own
        return 1 / np.where(problem.silent & (squares > 0), np.sqrt(squares / problem.total_rows), problem.own_sigma)

    return _with_given(problem, gains, weights, "weighted", delays)


def _with_given(
    problem: Problem, gains: np.ndarray, weigh: Weigh, name: str, delays: np.ndarray | None = None
) -> Solution:
    delays = problem.own_delays if delays is None else delays
    start = np.concatenate([np.zeros(problem.n_theta), gains, delays])
    solution = solve(problem, start, weigh, free_gains=False)
    if not solution.converged:
        rows, unknowns = problem.total_rows.sum(), len(problem.parameters) + 2 * len(problem.joints)
        raise GtauError(
            f"{name} least squares did not converge, so the data do not determine the delays of the currents: after "
            f"filtering there are {rows} equations for {unknowns} unknowns; log faster and longer motions, check that "
            "position and current columns belong together, and add runs that move every joint."
        )
    return solution


def with_given(solver: Callable[[Problem, np.ndarray], Solution], gains: np.ndarray | None) -> Solve:
    """Fix the gains of a solver to those given, (n,)."""
    assert gains is not None
    return lambda problem: solver(problem, np.append(gains, np.ones(len(problem.channels) - len(gains))))


def fit_by(solve: Solve, system: System, free_gains: bool, solution: Solution | None = None) -> Fit:
    """Fit by ``solve``, whose ``solution`` for ``system`` may be refined."""
    solution = solve(system.problem) if solution is None else solution
    return Fit(system, solution, solve, partial(wls, gains=solution.gains, delays=solution.delays), free_gains)


def plain_fit(solver: Callable[[np.ndarray | None], Solve]) -> FitSystem:
    """Make the fit of an estimator that only solves the problem."""

    def fit(system: System, gains: np.ndarray | None = None, progress: Progress = silent) -> Fit:
        return fit_by(solver(gains), system, gains is None)

    return fit


def two_stage(problem: Problem) -> Solution:
    """Solve two-stage least squares (2SLS).

    The currents are first projected on their own joint's regressor columns, which removes noise uncorrelated with the
    motion; the known payload is then alone on the right-hand side.
    """
    delays, n = problem.own_delays, len(problem.channels)
    coefficients = [
        least_squares(R[:, columns], delayed_signal(R, d))
        for R, columns, d in zip(problem.triangles, problem.own_columns, delays, strict=True)
    ]

    def projected(j: int, block: np.ndarray) -> np.ndarray:
        """Build rows of ``W_tot`` with projected currents from a block of channel j."""
        return problem.total_rows_of(block, j, block[:, problem.own_columns[j]] @ coefficients[j])

    blocks = [projected(j, R) for j, R in enumerate(problem.triangles)]
    known = problem.total_known
    gains = np.ones(n)
    for _ in range(3):
        scale = 1 / (problem.own_sigma * np.abs(gains))
        weighted = (block * weight for block, weight in zip(blocks, scale, strict=True))
        A = np.concatenate([*weighted, known])
        x = least_squares(A[:, :-1], -A[:, -1])
        if not any(block[:, -1].any() for block in blocks):  # noise biases a scale by known parameters towards zero
            explained = known[:, :-1] @ x
            x *= -(known[:, -1] @ explained) / max(explained @ explained, 1e-300)
        gains = np.where(problem.unknown_gains, x[problem.unknowns.gains], 1.0)
        if not np.all(np.abs(gains) > 0):
            raise GtauError(
                "the currents of some joint are unrelated to its motion; check the columns of the current references."
            )
    values = np.concatenate([x[problem.unknowns.theta], gains, delays])
    solution = finish(problem, values, problem.weights(squared(stacked(problem), values)), True)

    def replicates() -> np.ndarray:
        norms = np.linalg.norm(A[:, :-1], axis=0)
        norms[norms == 0] = 1.0
        back = np.linalg.pinv(triangle(A[:, :-1] / norms)) / norms[:, None]
        blocks = []
        for block in problem.units:
            # with the coefficients of all units
            A_u = np.concatenate([projected(j, block[j]) * scale[j] for j in range(n)])
            e_u = (residuals(block, values) * (scale * gains)[:, None]).reshape(-1)
            white = A_u[:, :-1] @ back
            blocks.append((white.T @ white, white.T @ e_u))
        steps = one_step(blocks) @ back.T
        return np.hstack([steps, np.zeros((len(steps), n))])  # all units have the same delays

    return replace(solution, replicates=replicates)


def tls(problem: Problem) -> Solution:
    """Solve by the paper's total least squares (eqs. 33 to 39), joints weighted by sigma_W; raises GtauError."""
    r, joints = problem.total_rows.sum(), range(len(problem.joints))
    own_sigma_W = [_own_sigma_W(problem, j) for j in joints]
    units = [triangle(*(problem.total_rows_of(unit[j], j) / own_sigma_W[j] for j in joints)) for unit in problem.units]
    W_tot = triangle(*units)  # eq. (33): the same singular values and right singular vectors as all rows
    _, s, Vt = np.linalg.svd(W_tot)  # eq. (35)
    chi = _scaled(Vt[-1])  # V_c solves the closest compatible system, eqs. (34) and (36)
    sigma_W = s[-1] / np.sqrt(r - len(s))  # eq. (38), of errors as in eq. (37)
    n, unknowns = len(problem.joints), problem.unknowns
    covariance = np.zeros((len(unknowns), len(unknowns)))
    covariance[:-n, :-n] = sigma_W**2 * (1 + chi[:-1] @ chi[:-1]) * _inverse_of_compatible(s, Vt.T)  # eq. (39)
    theta, gains = chi[unknowns.theta], chi[unknowns.gains]
    errors = np.zeros(n)
    for j, R in enumerate(problem.triangles):
        errors[j] = np.sum((delayed_signal(R, problem.own_delays[j]) - modelled(R, theta) / gains[j]) ** 2)
    sigma = np.sqrt(errors / np.maximum(problem.total_rows - (len(chi) - 1) / n, 1))

    def replicates() -> np.ndarray:
        shifts = np.array([(_scaled(np.linalg.svd(W)[2][-1]) - chi)[:-1] for W in leave_one_out(units)])
        return np.hstack([shifts, np.zeros((len(units), n))])  # all units have the same delays

    statistics = {"singular_ratio": float(s[-2] / s[-1]), "sigma_W": float(sigma_W)}
    return Solution(unknowns, np.append(chi[:-1], problem.own_delays), sigma, covariance, replicates, statistics)


def _scaled(direction: np.ndarray) -> np.ndarray:
    """Scale a solution to a last entry of 1: the known payload fixes the scale."""
    if abs(direction[-1]) < 1e-12 * np.linalg.norm(direction):
        raise GtauError(
            "the data do not determine the scale of the drive gains: the known payload does not show in the currents; "
            "use a heavier payload or motions that lift and accelerate it."
        )
    return np.asarray(direction / direction[-1])


def _own_sigma_W(problem: Problem, j: int) -> float:
    """Compute sigma_W of joint j from the TLS of its own equations (eq. 38)."""
    R = problem.triangles[j]
    current = delayed_signal(R, problem.own_delays[j])
    s = np.linalg.svd(np.column_stack([R[:, problem.own_columns[j]], current]), compute_uv=False)
    return float(s[-1] / np.sqrt(max(problem.total_rows[j] - len(s), 1)))


def _inverse_of_compatible(s: np.ndarray, V: np.ndarray) -> np.ndarray:
    """Compute ``(W^T W)^-1`` of eq. (39) for the compatible system's first c-1 columns, without forming W^T W.

    With V partitioned as ``[[V1, a], [b^T, d]]``, orthogonality gives ``V1^-T = V1 - a b^T / d``.
    """
    V1, a, b, d = V[:-1, :-1], V[:-1, -1], V[-1, :-1], V[-1, -1]
    half = (V1 - np.outer(a, b) / d) / s[:-1]
    return half @ half.T


SOLVE_WLS, SOLVE_OLS = partial(with_given, wls), partial(with_given, ols)
WLS = Estimator(
    "wls", "weighted least squares with given gains", Gains.GIVEN, SOLVE_WLS, plain_fit(SOLVE_WLS), in_paper=True
)
OLS = Estimator(
    "ols", "ordinary least squares with given gains", Gains.GIVEN, SOLVE_OLS, plain_fit(SOLVE_OLS), in_paper=True
)
TWO_STAGE = Estimator(
    "2sls", "two-stage least squares", Gains.ESTIMATED, lambda gains: two_stage, plain_fit(lambda gains: two_stage)
)
TLS = Estimator(
    "tls",
    "total least squares (the paper's)",
    Gains.ESTIMATED,
    lambda gains: tls,
    plain_fit(lambda gains: tls),
    in_paper=True,
    takes_priors=False,
)
