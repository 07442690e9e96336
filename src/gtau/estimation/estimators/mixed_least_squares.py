"""Mixed LS-TLS: the regressor is exact, the currents are noisy.

Choose it where the regressor is much less noisy than the currents and maximum likelihood does not converge: it is a
singular value decomposition, without iterations.
"""

from __future__ import annotations

import numpy as np

from gtau.estimation.estimators.estimator import Estimator, Fit, Gains, Given
from gtau.estimation.estimators.homogeneous import scaled, solution_of, total_matrix, total_rows_of
from gtau.estimation.estimators.least_squares import fit_free
from gtau.estimation.estimators.solution import Solution
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.problem import Problem
from gtau.estimation.regression.system import System
from gtau.estimation.regression.triangle import triangle


def mixed(problem: Problem) -> Solution:
    """Solve mixed LS-TLS: exact regressor, noisy currents, rows scaled by each joint's current residual.

    The exact columns are eliminated by a QR factorisation; the gains are the direction in which the
    current columns are left smallest, relative to their noise.
    """
    n, n_theta = len(problem.joints), problem.n_theta
    noise = np.sqrt(problem.total_rows / problem.total_rows.mean())

    def solver(W: np.ndarray) -> np.ndarray:
        exact = [*range(n_theta), n_theta + n]
        R = triangle(W[:, [*exact, *range(n_theta, n_theta + n)]])
        m = len(exact)
        gains = np.linalg.svd(R[m:, m:] / noise)[2][-1] / noise
        scales = np.linalg.norm(R[:m, :m], axis=0)
        rest = np.linalg.solve(R[:m, :m] / scales, -R[:m, m:] @ gains) / scales
        return scaled(np.concatenate([rest[:-1], gains, rest[-1:]]))

    weights = 1 / problem.own_sigma
    blocks = total_matrix(problem, weights)
    W_tot = triangle(*blocks)
    chi = solver(W_tot)
    # scaled rows hold currents with errors of one size, which enter the equations through the gains
    squares = chi[n_theta:-1] ** 2
    size = np.sum((W_tot @ chi) ** 2) / (squares @ problem.total_rows * (1 - len(chi) / problem.total_rows.sum()))
    back = np.linalg.pinv(triangle(W_tot[:, :-1]))
    middle = np.zeros((len(chi) - 1, len(chi) - 1))
    for j, R in enumerate(problem.triangles):
        white = total_rows_of(problem, R, j, weights[j])[:, :-1] @ back
        middle += squares[j] * white.T @ white
    return solution_of(problem, chi, size * back @ middle @ back.T, blocks, solver, {})


def _fit(dataset: Dataset, system: System, given: Given) -> Fit:
    return fit_free(mixed, dataset, system)


MIXED = Estimator(
    "mixed",
    "mixed LS-TLS (regressor exact, currents noisy)",
    Gains.ESTIMATED,
    lambda given: mixed,
    _fit,
    takes_priors=False,
)
