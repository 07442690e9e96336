"""Maximum likelihood of parameters, drive gains and delays in the domain of the current references.

The default, and the estimator to choose unless there is a reason for another. All noise is taken to be the current's,

    e_j = v(t - d_j) - (W_theta theta + known) / g_j ,

of a standard deviation sigma_j of its own in every channel, estimated from its residuals alone: of the currents, and
of torque sensors, whose gain is 1. Known parameters are further equations, with their own standard deviations. (From
torque residuals of the homogeneous system a gain could buy small residuals by collapsing to zero.)
"""

from __future__ import annotations

import numpy as np

from gtau.estimation.estimators.estimator import Estimator, Gains, Solution, Solve
from gtau.estimation.estimators.least_squares import plain_fit, two_stage, with_given, wls
from gtau.estimation.estimators.newton import solve
from gtau.estimation.regression.problem import Problem


def ml(problem: Problem) -> Solution:
    """Maximise the likelihood of parameters, drive gains and delays from 2SLS, converged or not."""
    return solve(problem, two_stage(problem).values, problem.weights, True)


def ml_or_wls(gains: np.ndarray | None) -> Solve:
    """Maximise the likelihood, or solve weighted least squares where the gains are given."""
    return ml if gains is None else with_given(wls, gains)


ML = Estimator(
    "ml", "maximum likelihood in the current domain", Gains.ESTIMATED, lambda gains: ml, plain_fit(lambda gains: ml)
)
