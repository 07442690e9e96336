"""Essential parameters: the base parameters that the data say something about (paper, section 5.2)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from idim.estimation.problem import Problem
from idim.estimation.solution import Solution

RATIO = 30.0


def essential(
    problem: Problem,
    candidates: tuple[str, ...],
    solve: Callable[[Problem], Solution],
    ratio: float = RATIO,
) -> tuple[Problem, Solution]:
    """Cancel the parameter of largest relative deviation until the ratio rule holds.

    The rule is ``max(rel) / min(rel) < ratio`` over ``candidates``. Kept parameters absorb what the
    cancelled ones did, so a small ratio over-prunes.

    Parameters
    ----------
    problem : Problem
        With all parameters.
    candidates : tuple of str
        Parameters that may be cancelled.
    solve : callable
        Estimator: with the gains fixed, or jointly with them as the paper does.
    ratio : float
        The paper's r_sigma, 10 to 30.

    Returns
    -------
    Problem, Solution
        Of the parameters that are left.
    """
    while True:
        solution = solve(problem)
        index = [k for k, name in enumerate(problem.parameters) if name in candidates]
        value = np.abs(solution.theta[index])
        relative = np.sqrt(np.diag(solution.covariance)[index]) / np.maximum(value, 1e-300)
        worst = int(np.argmax(relative))
        if relative[worst] < ratio * relative.min() or len(index) == 1:
            return problem, solution
        problem = problem.without([problem.parameters[index[worst]]])
