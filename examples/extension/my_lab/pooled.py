"""Maximum likelihood where all channels have the same noise."""

import numpy as np

from gtau.estimation.estimators.estimator import Estimator, Gains, Solution, Solve
from gtau.estimation.estimators.least_squares import plain_fit
from gtau.estimation.estimators.maximum_likelihood import ml
from gtau.estimation.estimators.newton import solve
from gtau.estimation.regression.problem import Problem


def pooled(problem: Problem) -> Solution:
    """Solve for parameters, gains and delays, all rows weighted alike."""
    rows = problem.total_rows.sum()

    def weights(squares: np.ndarray) -> np.ndarray:
        return np.full(len(squares), np.sqrt(rows / squares.sum()))

    return solve(problem, ml(problem).values, weights, free_gains=True)


def solver(gains: np.ndarray | None) -> Solve:
    """Take no gains as given."""
    return pooled


POOLED = Estimator("pooled", "maximum likelihood with one noise", Gains.ESTIMATED, solver, plain_fit(solver))
