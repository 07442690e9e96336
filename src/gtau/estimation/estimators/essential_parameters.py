"""Essential parameters: the base parameters that are significant (paper, section 5.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gtau.estimation.estimators.estimator import Fit, Solution, Solve
from gtau.estimation.regression.problem import Problem


def essential_parameters(
    problem: Problem,
    candidates: tuple[str, ...],
    solve: Solve,
    ratio: float | None = None,
    correlated: bool = True,
) -> tuple[Problem, Solution, np.ndarray]:
    """Cancel the parameter of largest relative standard deviation, repeatedly.

    With a ``ratio`` until the paper's rule ``max(rel) / min(rel) < ratio`` holds over ``candidates``. As
    kept parameters absorb the cancelled ones, that over-prunes if the best parameter is
    very accurate; so without one, until the Bayesian information criterion keeps every parameter: it
    must be ``sqrt(log r)`` standard deviations (about 3) away from zero. (At two, groups of nearly
    dependent parameters stay with absurd values that cancel each other.)

    Parameters
    ----------
    problem : Problem
        With all parameters.
    candidates : tuple of str
        Parameters that may be cancelled.
    solve : callable
        Estimator: with the gains fixed, or jointly with them as the paper does.
    ratio : float, optional
        The paper's r_sigma, 10 to 30.
    correlated : bool
        Allow for autocorrelated errors, by the initial ratio of the jackknife to the formula.

    Returns
    -------
    Problem, Solution
        Of the remaining parameters.
    std : ndarray
        Their standard deviations (n_theta,) in the rule's last step, zero for cancelled ones.
    """
    solution = solve(problem)
    formula = np.maximum(np.diag(solution.covariance), 1e-300)
    larger = np.sqrt(np.diag(solution.jackknife) / formula) if correlated else np.ones(len(formula))
    inflation = dict(zip(problem.parameters, larger, strict=False))
    significant = 1 / np.sqrt(np.log(problem.total_rows.sum()))
    while True:
        index = [k for k, name in enumerate(problem.parameters) if name in candidates]
        std = np.sqrt(np.diag(solution.covariance)[: problem.n_theta])
        std = std * [inflation[name] for name in problem.parameters]
        relative = (std / np.maximum(np.abs(solution.theta), 1e-300))[index]
        worst = int(np.argmax(relative))
        allowed = significant if ratio is None else ratio * relative.min()
        if relative[worst] <= allowed or len(index) == 1:
            return problem, solution, std
        problem = problem.without([problem.parameters[index[worst]]])
        solution = solve(problem)


@dataclass(frozen=True, eq=False)
class Essential:
    """The essential parameters: the reduced problem, its solution, and their standard deviations (n_theta,).

    ``loss`` is the growth of the worst joint's residual without the cancelled ones, per cent.
    """

    problem: Problem
    solution: Solution
    std: np.ndarray
    loss: float


def reduce_fit(fit: Fit, covariance: np.ndarray, ratio: float | None, correlated: bool, joint: bool) -> Essential:
    """Cancel base parameters until the essential ones are left.

    Parameters
    ----------
    fit : Fit
        With all base parameters.
    covariance : ndarray
        Of its (theta, gains, delays).
    ratio, correlated : float, bool
        See :func:`essential_parameters`.
    joint : bool
        Estimate the gains again at each step, as the paper does, or keep them.
    """
    problem = fit.system.problem
    candidates = tuple(name for name in fit.dataset.base.names if name in problem.parameters)
    solve = fit.solve if joint else fit.solve_fixed
    kept, reduced, std = essential_parameters(problem, candidates, solve, ratio, correlated)
    if ratio is None:
        # kept parameters absorb the cancelled ones: only the standard deviation with all of them is valid
        std = np.sqrt(np.diag(covariance))[[problem.parameters.index(name) for name in kept.parameters]]
    return Essential(kept, reduced, std, 100 * float(np.max(reduced.sigma / fit.solution.sigma) - 1))
