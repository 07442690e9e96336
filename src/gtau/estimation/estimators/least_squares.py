"""Ordinary and weighted least squares with given drive gains (eqs. 24 to 28).

Choose ``wls`` for logs of true torques, or if the gains are known better than a payload can determine them: each
joint is weighted by its own residual standard deviation (eq. 28). ``ols`` (eq. 24) weights all torque errors
alike; it is there for comparison. All noise is the current's, of its own standard deviation in every joint,

    e_j = v(t - d_j) - (W_theta theta + known) / g_j .
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.estimators.estimator import Estimator, Fit, FitSystem, Gains, Solution, Solve
from gtau.estimation.estimators.newton import Weigh, solve
from gtau.estimation.regression.dataset import System
from gtau.estimation.regression.problem import Problem
from gtau.progress import Progress, silent


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
        raise GtauError(
            f"{name} least squares did not converge, so the data do not determine the delays of the currents: "
            f"{scarcity(problem)}check that position and current columns belong together, and add runs that move "
            "every joint."
        )
    return solution


def scarcity(problem: Problem) -> str:
    """Count equations and unknowns, and advise how to get more equations."""
    rows = int(problem.total_rows.sum())
    unknowns = len(problem.parameters) + 2 * len(problem.joints)
    return f"after filtering there are {rows} equations for {unknowns} unknowns; log longer runs, at a higher rate, "


def with_given(solver: Callable[[Problem, np.ndarray], Solution], gains: np.ndarray | None) -> Solve:
    """Fix the gains of a solver to those given, (n,)."""
    assert gains is not None
    return lambda problem: solver(problem, np.append(gains, np.ones(len(problem.channels) - len(gains))))


def fit_by(solve: Solve, system: System, free_gains: bool, solution: Solution | None = None) -> Fit:
    """Fit by ``solve``, whose ``solution`` for ``system`` may be refined."""
    solution = solve(system.problem) if solution is None else solution
    solve_fixed = partial(wls, gains=solution.gains, delays=solution.delays)
    return Fit(system, solution, solve, solve_fixed, free_gains)


def plain_fit(solver: Callable[[np.ndarray | None], Solve]) -> FitSystem:
    """Make the fit of an estimator that only solves the problem."""

    def fit(system: System, gains: np.ndarray | None = None, progress: Progress = silent) -> Fit:
        return fit_by(solver(gains), system, gains is None)

    return fit


SOLVE_WLS, SOLVE_OLS = partial(with_given, wls), partial(with_given, ols)
WLS = Estimator(
    "wls", "weighted least squares with given gains", Gains.GIVEN, SOLVE_WLS, plain_fit(SOLVE_WLS), in_paper=True
)
OLS = Estimator(
    "ols", "ordinary least squares with given gains", Gains.GIVEN, SOLVE_OLS, plain_fit(SOLVE_OLS), in_paper=True
)
