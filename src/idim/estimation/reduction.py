"""Essential parameters: the base parameters that the data say something about (paper, section 5.2)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from idim.estimation.problem import Problem
from idim.estimation.solution import Solution

SIGNIFICANT = 2.0  # standard deviations from zero


def essential(
    problem: Problem,
    candidates: tuple[str, ...],
    solve: Callable[[Problem], Solution],
    ratio: float | None = None,
) -> tuple[Problem, Solution]:
    """Cancel the parameter of largest relative deviation, again and again.

    With a ``ratio`` until the paper's rule ``max(rel) / min(rel) < ratio`` holds over ``candidates``. As
    kept parameters absorb what the cancelled ones did, that over-prunes where the best parameter is
    very well known; so without one, until every parameter is two standard deviations away from zero.

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

    Returns
    -------
    Problem, Solution
        Of the parameters that are left.
    """
    solution = solve(problem)
    # errors correlated in time make real deviations larger than the formula's: by how much is found once
    larger = np.sqrt(np.diag(solution.jackknife) / np.maximum(np.diag(solution.covariance), 1e-300))
    inflation = dict(zip(problem.parameters, larger, strict=False))
    while True:
        index = [k for k, name in enumerate(problem.parameters) if name in candidates]
        value = np.abs(solution.theta[index])
        std = np.sqrt(np.diag(solution.covariance)[index]) * [inflation[problem.parameters[k]] for k in index]
        relative = std / np.maximum(value, 1e-300)
        worst = int(np.argmax(relative))
        allowed = 1 / SIGNIFICANT if ratio is None else ratio * relative.min()
        if relative[worst] <= allowed or len(index) == 1:
            return problem, solution
        problem = problem.without([problem.parameters[index[worst]]])
        solution = solve(problem)
