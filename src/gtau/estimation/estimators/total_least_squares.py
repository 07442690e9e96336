"""The paper's total least squares (eqs. 33 to 39), which takes every column of ``W_tot`` for equally noisy.

Choose it to follow the paper, or to compare with published results. On real logs its assumption seldom holds, and
gains may come out absurd where maximum likelihood finds them.
"""

from __future__ import annotations

import numpy as np

from gtau.estimation.estimators.estimator import Estimator, Fit, Gains, Given
from gtau.estimation.estimators.homogeneous import scaled, solution_of, total_matrix
from gtau.estimation.estimators.least_squares import fit_free
from gtau.estimation.estimators.solution import Solution
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.problem import Problem, delayed
from gtau.estimation.regression.system import System
from gtau.estimation.regression.triangle import triangle


def tls(problem: Problem) -> Solution:
    """Solve by the paper's total least squares (eqs. 33 to 39), rows weighted by each joint's sigma_W.

    Raises
    ------
    GtauError
        Where the known payload does not show in the currents, so that nothing sets the scale.
    """
    r, weights = problem.total_rows.sum(), 1 / np.array([_own_sigma_W(problem, j) for j in range(len(problem.joints))])
    blocks = total_matrix(problem, weights)  # eq. (33)
    W_tot = triangle(*blocks)  # the same singular values and right singular vectors as all rows
    _, s, Vt = np.linalg.svd(W_tot)  # eq. (35)
    chi = scaled(Vt[-1])  # V_c solves the closest compatible system, eqs. (34) and (36)
    sigma_W = s[-1] / np.sqrt(r - len(s))  # eq. (38), of errors as in eq. (37)
    covariance = sigma_W**2 * (1 + chi[:-1] @ chi[:-1]) * _inverse_of_compatible(s, Vt.T)  # eq. (39)
    statistics = {"singular_ratio": float(s[-2] / s[-1]), "sigma_W": float(sigma_W)}
    return solution_of(problem, chi, covariance, blocks, lambda W: scaled(np.linalg.svd(W)[2][-1]), statistics)


def _own_sigma_W(problem: Problem, j: int) -> float:
    """Compute sigma_W of joint j from the TLS of its own equations (eq. 38)."""
    R = problem.triangles[j]
    current = R[:, problem.n_theta + 1 :] @ delayed(problem.own_delays[j])
    s = np.linalg.svd(np.column_stack([R[:, problem.own_columns[j]], current]), compute_uv=False)
    return float(s[-1] / np.sqrt(max(problem.total_rows[j] - len(s), 1)))


def _inverse_of_compatible(s: np.ndarray, V: np.ndarray) -> np.ndarray:
    """Compute ``(W^T W)^-1`` of eq. (39) for the compatible system's first c-1 columns, without forming W^T W.

    With V partitioned as ``[[V1, a], [b^T, d]]``, orthogonality gives ``V1^-T = V1 - a b^T / d``.
    """
    V1, a, b, d = V[:-1, :-1], V[:-1, -1], V[-1, :-1], V[-1, -1]
    half = (V1 - np.outer(a, b) / d) / s[:-1]
    return half @ half.T


def _fit(dataset: Dataset, system: System, given: Given) -> Fit:
    return fit_free(tls, dataset, system)


TLS = Estimator(
    "tls",
    "total least squares (the paper's)",
    Gains.ESTIMATED,
    lambda given: tls,
    _fit,
    in_paper=True,
    takes_priors=False,
)
