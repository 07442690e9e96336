"""Which delays of the currents the data tell.

A delay is read off the current's rate of change. Where a joint moves slowly, that is mostly noise, which looks the
same at any delay. What the expansion ``v - d v' + d^2/2 v''`` makes of the noise then places the minimum, and gives it
a curvature of its own: the deviation means nothing.
"""

from __future__ import annotations

import numpy as np

from idim.estimation.problem import Problem
from idim.estimation.solution import Solution
from idim.estimation.verdicts import GOOD, Outcome, Verdict

TOLD = 0.5  # of the square of the current's rate of change, that motion must make


def moving_share(problem: Problem, solution: Solution) -> np.ndarray:
    """The share of motion in the mean square of each joint's rate of current, (n,).

    The rest is noise n, of which ``n n''`` takes away on average what ``n'^2`` adds (parts integrated).
    """
    shares = []
    for R, gain in zip(problem.triangles, solution.gains, strict=True):
        model, (v, rate, change) = R[:, : problem.n_theta + 1], R[:, problem.n_theta + 1 :].T
        e = v - model @ np.append(solution.theta, 1.0) / gain
        shares.append(1 + (e @ change) / max(rate @ rate, 1e-300))
    return np.array(shares)


def delay_verdicts(problem: Problem, solution: Solution) -> tuple[Verdict, ...]:
    """Verdict on the delay of every joint's current."""
    return tuple(
        GOOD
        if share > TOLD
        else Verdict(
            Outcome.NOT_IDENTIFIABLE,
            "most of the current's rate of change is noise",
            "take it for unknown, or move this joint faster; the drive gain does not rest on it",
        )
        for share in moving_share(problem, solution)
    )
