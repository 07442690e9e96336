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

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.verdict import MISFIT
from gtau.estimation.estimators.newton import Iterate, solve
from gtau.estimation.estimators.solution import Solution
from gtau.estimation.estimators.two_stage import two_stage
from gtau.estimation.regression.problem import Problem


def ols(problem: Problem, gains: np.ndarray) -> Solution:
    """Ordinary least squares with given ``gains`` (n,): every joint's torque error counts alike (eq. 24)."""
    return _with_given(problem, gains, lambda state, errors: np.abs(1 / state.b), "ordinary")


def wls(problem: Problem, gains: np.ndarray) -> Solution:
    """Weighted least squares with given ``gains`` (n,): joints weighted by their own error level (eq. 28)."""
    weights = 1 / problem.own_sigma
    return _with_given(problem, gains, lambda state, errors: weights, "weighted")


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
    GtauError
        Where the iteration does not settle though the model explains the currents. (Where it does not explain them,
        the verdicts say so.)
    """
    first = two_stage(problem)
    start = Iterate(first.theta, 1 / first.gains, first.delays)

    def weights(state: Iterate, errors: np.ndarray) -> np.ndarray:
        return 1 / np.maximum(np.sqrt(errors / problem.total_rows), problem.smallest_sigma)

    solution = solve(problem, start, weights, True, prior)
    if not solution.settled and np.all(solution.sigma < MISFIT * problem.signal):
        raise GtauError(
            "the maximum-likelihood iteration did not settle, so the data do not fix the drive gains: "
            f"{_scarcity(problem)}check the signs and units of positions and currents, add runs that move every joint "
            "or a heavier payload, or use --method wls with prior_gains."
        )
    return solution


def _with_given(
    problem: Problem, gains: np.ndarray, weigh: Callable[[Iterate, np.ndarray], np.ndarray], name: str
) -> Solution:
    start = Iterate(np.zeros(problem.n_theta), 1 / np.asarray(gains, dtype=float), problem.own_delays)
    solution = solve(problem, start, weigh, free_gains=False)
    if not solution.settled:
        raise GtauError(
            f"{name} least squares did not settle, so the data do not fix the delays of the currents: "
            f"{_scarcity(problem)}check that position and current columns belong together, and add runs that move "
            "every joint."
        )
    return solution


def _scarcity(problem: Problem) -> str:
    rows, unknowns = int(problem.total_rows.sum()), problem.n_theta + 2 * len(problem.joints)
    return f"after filtering there are {rows} equations for {unknowns} unknowns; log longer runs, at a higher rate, "
