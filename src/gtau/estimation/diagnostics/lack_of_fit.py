"""Whether residuals are autocorrelated: the model then lacks something."""

from __future__ import annotations

import numpy as np

from gtau.estimation.estimators.estimator import Solution
from gtau.estimation.regression.problem import Problem


def lack_of_fit(problem: Problem, solution: Solution) -> float:
    """Divide standard deviations by the jackknife by those for independent residuals; median over the parameters.

    Near 1 where the residuals are white; well above where they are autocorrelated, as the model lacks something.
    """
    known = np.diag(solution.covariance)[: problem.n_theta]
    ratio = np.diag(solution.jackknife)[: problem.n_theta][known > 0] / known[known > 0]
    return float(np.sqrt(np.median(ratio))) if ratio.size else 1.0
