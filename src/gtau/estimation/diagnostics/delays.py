"""Which delays of the currents the data tell.

A delay is read off the current's rate of change. Where a joint moves slowly, that is mostly noise, which looks the
same at any delay. What the expansion ``v - d v' + d^2/2 v''`` makes of the noise then places the minimum, and gives it
a curvature of its own: the deviation means nothing.
"""

from __future__ import annotations

import numpy as np

from gtau.estimation.diagnostics.verdict import GOOD, Outcome, Verdict
from gtau.estimation.estimators.solution import Solution
from gtau.estimation.regression.problem import Problem
from gtau.estimation.thresholds import DELAY_MOTION


def moving_share(problem: Problem, solution: Solution) -> tuple[np.ndarray, np.ndarray]:
    """The share of motion in the mean square of each joint's rate of current, and its standard error, (n,) each.

    The rest is noise n, of which ``n n''`` takes away on average what ``n'^2`` adds (parts integrated). The error is
    that of a ratio, from its scatter over the units.
    """
    model, currents = problem.blocks[..., : problem.n_theta + 1], problem.blocks[..., problem.n_theta + 1 :]
    v, rate, change = np.moveaxis(currents, -1, 0)  # (U, n, p) each
    e = v - model @ np.append(solution.theta, 1.0) / solution.gains[:, None]
    whole = np.einsum("ujp,ujp->uj", rate, rate)
    of_motion = whole + np.einsum("ujp,ujp->uj", e, change)
    total = np.maximum(whole.sum(axis=0), 1e-300)
    share = of_motion.sum(axis=0) / total
    return share, np.linalg.norm(of_motion - share * whole, axis=0) / total


def delay_verdicts(problem: Problem, solution: Solution) -> tuple[Verdict, ...]:
    """Verdict on the delay of every joint's current."""
    lost = Verdict(
        Outcome.NOT_IDENTIFIABLE,
        "the current's rate of change may all be noise",
        "take it for unknown, or move this joint faster; the drive gain does not rest on it",
    )
    return tuple(
        GOOD if share > DELAY_MOTION * error else lost
        for share, error in zip(*moving_share(problem, solution), strict=True)
    )
