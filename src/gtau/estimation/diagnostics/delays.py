"""Which delays of the currents are identifiable.

A delay is read off the current's rate of change. Where a joint moves slowly, that is mostly noise, which looks the
same at any delay. What the expansion ``v - d v' + d^2/2 v''`` makes of the noise then places the minimum, and gives it
a curvature of its own: the standard deviation means nothing.
"""

from __future__ import annotations

import numpy as np

from gtau.estimation.diagnostics.verdict import GOOD, Outcome, Verdict
from gtau.estimation.estimators.estimator import Solution
from gtau.estimation.regression.equations import SIGNALS, modelled
from gtau.estimation.regression.problem import Problem
from gtau.estimation.thresholds.logs import DELAY_MOTION, DELAY_STD


def moving_share(problem: Problem, solution: Solution) -> tuple[np.ndarray, np.ndarray]:
    """Compute the share of motion in the mean square of each channel's rate of change, and its standard error, (c,).

    The rest is noise n, of which ``n n''`` takes away on average what ``n'^2`` adds (parts integrated). The error is
    that of a ratio, from its scatter over the units.
    """
    v, rate, change = np.moveaxis(problem.blocks[..., SIGNALS], -1, 0)  # (U, c, p) each
    e = v - modelled(problem.blocks, solution.theta) / solution.gains[:, None]
    whole = np.einsum("ujp,ujp->uj", rate, rate)
    of_motion = whole + np.einsum("ujp,ujp->uj", e, change)
    total = np.maximum(whole.sum(axis=0), 1e-300)
    share = of_motion.sum(axis=0) / total
    return share, np.linalg.norm(of_motion - share * whole, axis=0) / total


def delay_verdicts(problem: Problem, solution: Solution, std: np.ndarray, period: float) -> tuple[Verdict, ...]:
    """Judge the delay of every channel: of the joints' currents, and of torque sensors.

    Parameters
    ----------
    problem, solution : Problem, Solution
        What was solved.
    std : ndarray
        Standard deviations of the delays (c,), s.
    period : float
        Of the samples, s; a delay within one is believed whatever its relative standard deviation.
    """
    noise = Verdict(
        Outcome.NOT_IDENTIFIABLE,
        "the current's rate of change may be nothing but noise",
        "treat it as unknown, or move this joint faster; the drive gain does not depend on it",
    )
    found = []
    for share, error, delay, deviation in zip(*moving_share(problem, solution), solution.delays, std, strict=True):
        if share <= DELAY_MOTION * error:
            found.append(noise)
        elif abs(delay) > period and deviation > DELAY_STD * abs(delay):
            found.append(
                Verdict(
                    Outcome.WEAK,
                    f"its standard deviation is {1e3 * deviation:.2g} ms",
                    "treat it as a nuisance parameter, or move this joint faster",
                )
            )
        else:
            found.append(GOOD)
    return tuple(found)
