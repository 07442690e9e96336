"""Verdicts on drive gains.

A cross-validated torque says nothing about a wrong gain, as both sides of the equation carry it. What
does show one is a large deviation under the block jackknife, an estimate that moves when another
estimator uses the same data, and joints whose equations hold alone but not together.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gtau.estimation.diagnostics.drift import worst_drifts
from gtau.estimation.diagnostics.gain_change import worst_differences
from gtau.estimation.diagnostics.verdict import GOOD, Outcome, Verdict
from gtau.estimation.estimators.solution import Solution, jackknife
from gtau.estimation.estimators.two_stage import two_stage
from gtau.estimation.regression.problem import Problem
from gtau.estimation.thresholds import ALONE, APART, DOMINANT, DRIFT, DRIFTING, LOST_GAIN, MISFIT, SCALED, WEAK_GAIN


def gain_verdicts(
    problem: Problem,
    solution: Solution,
    std: np.ndarray,
    block_positions: np.ndarray,
    runs: Sequence[str],
    repeating: bool = False,
) -> tuple[Verdict, ...]:
    """Verdict on every drive gain.

    Parameters
    ----------
    problem, solution : Problem, Solution
        What was solved, and how.
    std : ndarray
        Standard deviations of the gains (n,).
    block_positions, runs : ndarray, sequence of str
        Where the problem's units stand (U, 2), and the names of the runs.
    repeating : bool
        Whether errors repeat at the same positions. A joint's own equations then take up more of them than all
        together do, and each run takes up its own, which is no sign of a wrong description or of other gains.
    """
    misfit, alone = solution.sigma / problem.signal, problem.own_sigma / solution.sigma
    if repeating:
        alone = np.ones_like(alone)
    # on the same delays: where motions are slow, a joint's own equations hardly tell its delay
    other, gains = two_stage(problem, solution.delays), slice(problem.n_theta, problem.n_theta + len(problem.joints))
    between = np.sqrt(np.diag(jackknife((solution.replicates() - other.replicates())[:, gains])))
    apart = np.abs(solution.gains - other.gains) / np.maximum(std, between)
    blocks = np.sqrt(np.diag(solution.jackknife))[gains]
    relative = np.maximum(std, blocks) / np.abs(solution.gains)  # formulas take errors for independent
    drifts, differences = (
        worst_drifts(problem, solution, block_positions),
        worst_differences(problem, solution, block_positions),
    )
    reversed_ = solution.gains < 0
    found = [
        _gain_verdict(misfit[j], alone[j], apart[j], relative[j], bool(np.all(reversed_)), solution.settled)
        for j in range(len(problem.joints))
    ]
    for j, (drift, difference) in enumerate(zip(drifts, differences, strict=True)):
        differs = abs(difference.t) > DRIFTING and abs(difference.change) > DRIFT
        # out of scale, not reversed or in another unit, which other verdicts tell better
        scaled = differs and difference.share > DOMINANT and abs(difference.change) < SCALED
        if found[j].outcome not in (Outcome.GOOD, Outcome.WEAK) and not scaled:
            continue
        if abs(drift.t) > DRIFTING and abs(drift.change) > DRIFT:
            found[j] = Verdict(
                Outcome.CONTRADICTORY,
                f"in the course of run '{runs[drift.run]}' the current changes by {100 * drift.change:.2g} % against "
                "the model",
                "let the robot warm up before the runs, and divide long runs into shorter ones, each with its own "
                "friction",
            )
        elif differs and not repeating:
            named = "run " + " and ".join(f"'{runs[k]}'" for k in difference.runs)
            found[j] = Verdict(
                Outcome.CONTRADICTORY,
                f"in {named} its current is {100 * abs(difference.change):.2g} % "
                f"{'larger' if difference.change > 0 else 'smaller'} than the other runs tell",
                "check which runs carry the payload, its mass and the clock; otherwise let the robot warm up, and make "
                "loaded and unloaded runs in turn, as a motor's torque constant falls while it gets warmer",
            )
        elif found[j] == GOOD and reversed_[j]:
            found[j] = Verdict(
                Outcome.GOOD,
                "it is negative",
                "its current counts against its motion: reverse the sign of one of the two if that is not meant",
            )
    return tuple(found)


def lack_of_fit(problem: Problem, solution: Solution) -> float:
    """Deviations by the jackknife over those that independent errors would give, the median over the parameters.

    Near 1 where the errors are noise; well above where they hang together in time, as the model lacks something.
    """
    known = np.diag(solution.covariance)[: problem.n_theta]
    ratio = np.diag(solution.jackknife)[: problem.n_theta][known > 0] / known[known > 0]
    return float(np.sqrt(np.median(ratio))) if ratio.size else 1.0


def _gain_verdict(
    misfit: float, alone: float, apart: float, relative: float, all_negative: bool, settled: bool
) -> Verdict:
    if all_negative:
        return Verdict(
            Outcome.CONTRADICTORY,
            "all drive gains are negative",
            "check the sign of the currents and positions, gravity, which runs carry the payload, and on which body",
        )
    if misfit > MISFIT:
        return Verdict(
            Outcome.CONTRADICTORY,
            f"the model leaves {100 * misfit:.0f} % of this joint's current unexplained",
            "check that its position and current columns belong together, in all runs, and their signs and units",
        )
    if alone < ALONE:
        return Verdict(
            Outcome.CONTRADICTORY,
            f"this joint's equations alone are met {1 / alone:.1f} times better than together with the other joints'",
            "check the order and signs of the joints, the direction of gravity and the robot's geometry",
        )
    if not settled:
        return Verdict(
            Outcome.NOT_IDENTIFIABLE,
            "the iteration did not settle, so the data do not fix it",
            "see to the contradictory joints first",
        )
    if relative > LOST_GAIN:
        return Verdict(
            Outcome.NOT_IDENTIFIABLE,
            f"its standard deviation is {100 * relative:.0f} % of it",
            "use a heavier payload, and motions in which this joint lifts or accelerates it; check the direction of "
            "gravity, which runs carry the payload, and on which body",
        )
    if apart > APART:
        return Verdict(
            Outcome.CONTRADICTORY,
            f"two estimators differ by {apart:.1f} standard deviations on the same data",
            "check the signs and the payload of every run, and gravity; otherwise add runs of other motions, as "
            "friction that grows with the load looks alike",
        )
    if relative > WEAK_GAIN:
        return Verdict(
            Outcome.WEAK,
            f"its standard deviation is {100 * relative:.1f} %",
            "use a heavier payload, longer runs, or motions in which this joint lifts or accelerates it more; "
            "if other joints are weak too, check which runs carry the payload, on which body, and gravity",
        )
    return GOOD
