"""Maximum likelihood of parameters, drive gains and delays in the domain of the current references.

``ml`` is the default, and the estimator to choose unless there is a reason for another. Choose ``huber``, in which rows
with large residuals count less, where logs hold outliers, such as collisions or dropouts. All noise is taken to be the
current's,

    e_j = v(t - d_j) - (W_theta theta + known) / g_j ,

of a standard deviation sigma_j of its own in every channel, estimated from its residuals alone: of the currents, and
of torque sensors, whose gain is 1. Known parameters are further equations, with their own standard deviations. (From
torque residuals of the homogeneous system a gain could buy small residuals by collapsing to zero.)

Huber's weights follow from the residuals, so the logs are streamed again with the weights of the previous pass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gtau.estimation.estimators.estimator import Estimator, Fit, Gains, Solution, Solve
from gtau.estimation.estimators.least_squares import fit_by, plain_fit, two_stage, with_given, wls
from gtau.estimation.estimators.newton import solve
from gtau.estimation.regression.dataset import System
from gtau.estimation.regression.factors import delayed
from gtau.estimation.regression.problem import Problem
from gtau.findings import Progress, silent
from gtau.signals.storage import block, rows_at, spans, stride_of

TUNING = 1.345  # of Huber's weights, standard deviations: 95 % efficient without outliers
PASSES = 10
CONVERGED = 1e-4  # relative change of the gains
MAD = 1.4826  # median absolute deviation to standard deviation


def ml(problem: Problem) -> Solution:
    """Maximise the likelihood of parameters, drive gains and delays from 2SLS, converged or not."""
    return solve(problem, two_stage(problem).values, problem.weights, True)


def ml_or_wls(gains: np.ndarray | None) -> Solve:
    """Maximise the likelihood, or solve weighted least squares where the gains are given."""
    return ml if gains is None else with_given(wls, gains)


def reweighted(system: System, solve: Solve, progress: Progress) -> System:
    """Iterate between Huber's weights on the rows and the estimates of ``solve`` until they settle, or PASSES times."""
    sigma, gains = None, None
    for _ in range(PASSES):
        solution = solve(system.problem)
        if gains is not None and np.allclose(solution.gains, gains, rtol=CONVERGED, atol=0):
            break
        gains = solution.gains
        sigma = solution.sigma if sigma is None else sigma
        row_factors = np.hstack([-system.full(solution.theta) / gains[:, None], delayed(solution.delays)])
        runs = range(len(system.dataset.runs))
        weigh = [(np.einsum("jpk,jk->jp", system.map(run), row_factors), TUNING * sigma) for run in runs]
        system = system.again(system.dataset.reduced(system.loads(solution.theta), progress, weigh))
        sigma = robust_sigma([run.residuals for run in system.dataset.factors])
        sigma = np.maximum(sigma, system.unreduced.smallest_sigma)
    return system


def robust_sigma(residuals: Sequence[np.ndarray]) -> np.ndarray:
    """Compute the standard deviation (c,) of residuals (K, c) from their median size, NaN without any."""
    stride = stride_of(sum(map(len, residuals)))
    sizes = np.abs(np.concatenate([rows_at(rows, np.arange(0, len(rows), stride)) for rows in residuals]))
    known = [column[np.isfinite(column)] for column in sizes.T]
    return MAD * np.array([np.median(column) if column.size else np.nan for column in known])


def sandwich_factor(residuals: Sequence[np.ndarray]) -> float:
    """Compute the ratio of the jackknife's steps to those with fixed weights, ``E[w] / E[psi']``, at least 1.

    Leaving out a row changes the weights of the others as well: the curvature of Huber's loss is 1 for the rows below
    the limit and 0 above it, on average ``E[psi'] < E[w]``. The residuals (K, c) come from the last pass.
    """
    limit = TUNING * robust_sigma(residuals)
    weights, curvature = 0.0, 0
    for sizes in (np.abs(block(rows, *span)) for rows in residuals for span in spans(len(rows))):
        below = sizes <= limit
        weights += float(np.nansum(np.where(below, 1.0, limit / np.maximum(sizes, limit)) * np.isfinite(sizes)))
        curvature += int(np.count_nonzero(below))
    return weights / curvature if curvature else 1.0


def _fit(system: System, gains: np.ndarray | None = None, progress: Progress = silent) -> Fit:
    unweighted = system.problem
    system = reweighted(system, ml, progress)
    fixed = ml(system.problem)
    factor = sandwich_factor([run.residuals for run in system.dataset.factors])
    solution = replace(fixed, covariance=factor**2 * fixed.covariance, replicates=lambda: factor * fixed.replicates())
    return replace(fit_by(ml, system, True, solution), unweighted=unweighted)


ML = Estimator(
    "ml", "maximum likelihood in the current domain", Gains.ESTIMATED, lambda gains: ml, plain_fit(lambda gains: ml)
)
HUBER = Estimator(
    "huber", "maximum likelihood with Huber's weights against outliers", Gains.ESTIMATED, lambda gains: ml, _fit
)
