"""Maximum likelihood of parameters, drive gains and delays in the domain of the current references.

The default, and the estimator to choose unless there is a reason for another. All noise is taken to be the current's,

    e_j = v(t - d_j) - (W_theta theta + known) / g_j ,

of a standard deviation sigma_j of its own in every channel, estimated from its residuals alone: of the currents, and
of torque sensors, whose gain is 1. Known parameters are further equations, with their own standard deviations. (From
torque residuals of the homogeneous system a gain could buy small residuals by collapsing to zero.)
"""

from __future__ import annotations

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.estimators.estimator import Estimator, Gains, Solution, Solve
from gtau.estimation.estimators.least_squares import plain_fit, scarcity, two_stage, with_given, wls
from gtau.estimation.estimators.newton import solve
from gtau.estimation.regression.factors import KNOWN, MODEL
from gtau.estimation.regression.problem import Problem

MISFIT = 0.25  # share of a joint's current that is unexplained, gains estimated
HIDDEN_KNOWN = 0.01  # share of the known parameters' torque that nothing unknown explains: below, a refusal names it


def likeliest(problem: Problem) -> Solution:
    """Iterate from 2SLS towards the maximum of the likelihood, converged or not.

    Friction terms are chosen by this: a UR10e's pair with a current halved in one run does not converge with all of
    them, but does with the ones that the data support, and the cause is then named.
    """
    return solve(problem, two_stage(problem).values, problem.weights, True)


def ml(problem: Problem) -> Solution:
    """Maximise the likelihood of parameters, drive gains and delays, started from 2SLS.

    Raises GtauError where the iteration does not converge though the model explains the currents (where it does not
    explain them, the verdicts say so), or if only known parameters with little effect fix the scale.
    """
    solution = likeliest(problem)
    if solution.converged:
        return solution
    loaded = bool(problem.blocks[..., KNOWN].any())
    alone = len(problem.known) and problem.unknown_gains.all() and not (loaded or problem.wrenches)
    if alone and (share := own_share(problem)) < HIDDEN_KNOWN:
        raise GtauError(
            "the maximum-likelihood iteration did not converge, as the known parameters hardly fix the scale of the "
            f"drive gains: unknown ones explain all but {100 * share:.2g} % of their torque in these motions; give "
            "priors of those too (friction and offsets among them), log faster motions, add a payload or torque "
            "sensors, or use --method wls with prior_gains."
        )
    if np.all(solution.sigma < MISFIT * problem.balance(solution.theta)):
        scale = "a heavier payload" if loaded else "a payload, torque sensors or more known parameters"
        if problem.wrenches:  # what a body that is always carried does to its sensor is what its own inertia would do
            scale = f"one in which another wrench acts on {', '.join(problem.wrenches)} (without the tool, say)"
        advice = f"{scarcity(problem)}check the signs and units of positions and currents"
        if alone:
            advice = (
                "the known parameters, on which alone their scale rests, contradict the data or are too uncertain; "
                "check 'priors', 'prior_inertias' and the inertias in the robot's file"
            )
        raise GtauError(
            "the maximum-likelihood iteration did not converge, so the data do not determine the drive gains: "
            f"{advice}, add runs that move every joint or {scale}, or use --method wls with prior_gains."
        )
    return solution


def own_share(problem: Problem) -> float:
    """Compute the share of known parameters' torque that no unknown ones reproduce: near zero, any scale fits."""
    from scipy.linalg import null_space

    W = np.concatenate([R[:, MODEL] for R in problem.triangles])
    known, values = problem.known[:, :-1], problem.known[:, -1]
    alone, members = np.zeros(len(problem.parameters)), known.any(axis=0)
    alone[members] = np.linalg.lstsq(known[:, members], values, rcond=None)[0]
    unknown = W @ null_space(known)  # directions of theta without a prior
    norms = np.linalg.norm(unknown, axis=0)
    unknown = unknown[:, norms > 0] / norms[norms > 0]
    torque = W @ alone
    rest = torque - unknown @ np.linalg.lstsq(unknown, torque, rcond=None)[0]
    return float(np.linalg.norm(rest) / (np.linalg.norm(torque) or 1.0))


def ml_or_wls(gains: np.ndarray | None) -> Solve:
    """Maximise the likelihood, or solve weighted least squares where the gains are given."""
    return ml if gains is None else with_given(wls, gains)


ML = Estimator(
    "ml",
    "maximum likelihood in the current domain",
    Gains.ESTIMATED,
    lambda gains: likeliest,
    plain_fit(lambda gains: ml),
)
