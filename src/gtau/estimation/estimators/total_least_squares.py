"""The paper's total least squares (eqs. 33 to 39), which assumes equal noise in every column of ``W_tot``.

Choose it to follow the paper, or to compare with published results. On real logs its assumption seldom holds, and
gains may be absurd where maximum likelihood gives accurate ones.

``W_tot = [-W_theta  V_tau  -known]`` and ``chi_tot = [theta g 1]``: all unknowns are on one side, and the known
payload fixes the scale.
"""

from __future__ import annotations

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.estimators.estimator import Estimator, Gains, Solution
from gtau.estimation.estimators.least_squares import plain_fit
from gtau.estimation.regression.factors import delayed_signal, leave_one_out, modelled, triangle
from gtau.estimation.regression.problem import Problem


def tls(problem: Problem) -> Solution:
    """Solve by the paper's total least squares (eqs. 33 to 39), joints weighted by sigma_W; raises GtauError."""
    r, joints = problem.total_rows.sum(), range(len(problem.joints))
    own_sigma_W = [_own_sigma_W(problem, j) for j in joints]
    units = [triangle(*(problem.total_rows_of(unit[j], j) / own_sigma_W[j] for j in joints)) for unit in problem.units]
    W_tot = triangle(*units)  # eq. (33): the same singular values and right singular vectors as all rows
    _, s, Vt = np.linalg.svd(W_tot)  # eq. (35)
    chi = _scaled(Vt[-1])  # V_c solves the closest compatible system, eqs. (34) and (36)
    sigma_W = s[-1] / np.sqrt(r - len(s))  # eq. (38), of errors as in eq. (37)
    n, unknowns = len(problem.joints), problem.unknowns
    covariance = np.zeros((len(unknowns), len(unknowns)))
    covariance[:-n, :-n] = sigma_W**2 * (1 + chi[:-1] @ chi[:-1]) * _inverse_of_compatible(s, Vt.T)  # eq. (39)
    theta, gains = chi[unknowns.theta], chi[unknowns.gains]
    errors = np.zeros(n)
    for j, R in enumerate(problem.triangles):
        errors[j] = np.sum((delayed_signal(R, problem.own_delays[j]) - modelled(R, theta) / gains[j]) ** 2)
    sigma = np.sqrt(errors / np.maximum(problem.total_rows - (len(chi) - 1) / n, 1))

    def replicates() -> np.ndarray:
        shifts = np.array([(_scaled(np.linalg.svd(W)[2][-1]) - chi)[:-1] for W in leave_one_out(units)])
        return np.hstack([shifts, np.zeros((len(units), n))])  # all units have the same delays

    statistics = {"singular_ratio": float(s[-2] / s[-1]), "sigma_W": float(sigma_W)}
    values = np.append(chi[:-1], problem.own_delays)
    return Solution(unknowns, values, sigma, covariance, replicates, statistics)


def _scaled(direction: np.ndarray) -> np.ndarray:
    """Scale a solution to a last entry of 1: the known payload fixes the scale."""
    if abs(direction[-1]) < 1e-12 * np.linalg.norm(direction):
        raise GtauError(
            "the data do not determine the scale of the drive gains: the known payload does not show in the currents; "
            "use a heavier payload or motions that lift and accelerate it."
        )
    return np.asarray(direction / direction[-1])


def _own_sigma_W(problem: Problem, j: int) -> float:
    """Compute sigma_W of joint j from the TLS of its own equations (eq. 38)."""
    R = problem.triangles[j]
    current = delayed_signal(R, problem.own_delays[j])
    s = np.linalg.svd(np.column_stack([R[:, problem.own_columns[j]], current]), compute_uv=False)
    return float(s[-1] / np.sqrt(max(problem.total_rows[j] - len(s), 1)))


def _inverse_of_compatible(s: np.ndarray, V: np.ndarray) -> np.ndarray:
    """Compute ``(W^T W)^-1`` of eq. (39) for the compatible system's first c-1 columns, without forming W^T W.

    With V partitioned as ``[[V1, a], [b^T, d]]``, orthogonality gives ``V1^-T = V1 - a b^T / d``.
    """
    V1, a, b, d = V[:-1, :-1], V[:-1, -1], V[-1, :-1], V[-1, -1]
    half = (V1 - np.outer(a, b) / d) / s[:-1]
    return half @ half.T


TLS = Estimator(
    "tls",
    "total least squares (the paper's)",
    Gains.ESTIMATED,
    lambda gains: tls,
    plain_fit(lambda gains: tls),
    in_paper=True,
    takes_priors=False,
)
