"""Degrees of freedom of the jackknife standard deviations, for intervals by the t distribution.

As many as there are blocks, less one, if all blocks carry as much information on a parameter. Often a few carry nearly
all: Coulomb friction of a passive joint shows where that joint reverses. Its standard deviation then rests on these
few alone. The information of each block follows from the motions (Satterthwaite's rule, as Bell and McCaffrey use it):

    (sum s_u^2)^2 / sum s_u^4

with s_u^2 the variance that leaving out block u contributes, for independent residuals. Known parameters belong to no
block; what their standard deviations contribute counts as known.
"""

from __future__ import annotations

import numpy as np

from gtau.estimation.estimators.newton import jacobian, jacobian_of_known, stacked, to_gains, whitening
from gtau.estimation.estimators.solution import Solution
from gtau.estimation.regression.problem import Problem


def degrees_of_freedom(problem: Problem, solution: Solution, free_gains: bool) -> np.ndarray:
    """Find the degrees of freedom of the standard deviations of (theta, gains, delays), (n_theta + 2 c,).

    Parameters
    ----------
    problem, solution : Problem, Solution
        What was solved.
    free_gains : bool
        Whether the gains are estimated, or given.
    """
    state, blocks = solution.iterate, len(problem.blocks)
    weights = 1 / np.maximum(solution.sigma, problem.smallest_sigma)

    def rows(blocks: np.ndarray) -> np.ndarray:
        J = jacobian(blocks, state, problem, free_gains) * weights[:, None, None]
        return np.asarray(J.reshape(-1, J.shape[-1]))

    of_data = rows(stacked(problem))
    every = np.concatenate([of_data, jacobian_of_known(problem, of_data.shape[1])])
    back = whitening(every, np.zeros(len(problem.channels)))
    named = to_gains(state, problem.n_theta, free_gains) @ back
    variances = []
    for block in problem.blocks:
        J = rows(block) @ back
        left = np.eye(J.shape[1]) - J.T @ J
        try:
            of_rows = np.linalg.solve(left, J.T)
        except np.linalg.LinAlgError:  # what only this block identifies
            of_rows = np.linalg.pinv(left, rcond=1e-10, hermitian=True) @ J.T
        variances.append(np.sum((named @ of_rows) ** 2, axis=1))
    total, squares = np.sum(variances, axis=0), np.sum(np.square(variances), axis=0)
    share = np.divide(total**2, squares, out=np.full(len(total), float(blocks)), where=squares > 0)
    return np.asarray(np.clip(share - 1, 1.0, blocks - 1.0))
