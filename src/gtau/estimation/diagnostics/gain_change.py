"""Gains that differ between runs: whether the currents of some runs are out of scale with those of the others.

Friction may differ between runs, and has values of its own in each (see :mod:`gtau.estimation.regression.friction`); a
drive gain may not, as a payload is weighed by how loaded and unloaded runs differ. A motor that got warmer, by 2 per
cent of its torque constant, can move the gain by 5. All that the payload does not add to is the same in all runs, and
shows it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gtau.estimation.diagnostics.linearisation import LinearisedWindow
from gtau.estimation.diagnostics.score_test import score_tests
from gtau.estimation.estimators.estimator import Solution
from gtau.estimation.estimators.newton import jacobian, jacobian_of_known, residuals, to_gains
from gtau.estimation.regression.equations import KNOWN, modelled
from gtau.estimation.regression.problem import Problem
from gtau.estimation.thresholds.estimates import DOMINANT, TIE


@dataclass(frozen=True, eq=False)
class GainChange:
    """By what share of itself a joint's current is larger in some ``runs`` than in the others; how significant.

    ``share`` of the residual variance of all joints goes where each has such a change in these runs; ``moves`` (n,) is
    by what share of itself each gain moves when this joint's change is modelled.
    """

    runs: tuple[int, ...]
    change: float
    t: float
    share: float
    moves: np.ndarray


def gain_changes(problem: Problem, solution: Solution, block_positions: np.ndarray) -> tuple[GainChange, ...]:
    """Find the most significant change of every joint between one run, or the loaded ones, and the others.

    The current of the model is offered once more in these runs alone, see :func:`score_tests`.

    Parameters
    ----------
    problem, solution : Problem, Solution
        What was solved, with gains that were estimated.
    block_positions : ndarray
        Of the jackknife blocks, (U, 2): number of the run, and time from its beginning (0) to its end (1).
    """
    n, (runs, of_block) = len(problem.joints), np.unique(block_positions[:, 0].astype(int), return_inverse=True)
    loaded = np.zeros(len(runs), dtype=bool)
    np.logical_or.at(loaded, of_block, np.any(problem.blocks[..., KNOWN], axis=(1, 2)))
    groups = np.unique(np.vstack([np.eye(len(runs), dtype=bool), loaded]), axis=0)
    groups = groups[~groups.all(axis=1) & groups.any(axis=1)]
    if not len(groups):
        return (GainChange((), 0.0, 0.0, 0.0, np.zeros(n)),) * n
    known = jacobian_of_known(problem, problem.n_theta + 2 * len(problem.channels))
    offers = [(slice(None), False)]
    (found,) = score_tests(lambda: _windows(problem, solution, groups[:, of_block]), offers, known)
    shares = found.share.sum(axis=1)
    worst = _first_largest(np.abs(found.t[:, :n]))
    if shares.max() > DOMINANT:  # the same runs for all joints
        worst[:] = _first_largest(shares)
    T = to_gains(solution.iterate, problem.n_theta, True)
    return tuple(
        GainChange(
            tuple(runs[groups[k]].tolist()),
            float(found.size[k, j]),
            float(found.t[k, j]),
            float(shares[k]),
            (T @ found.slopes[k, j])[problem.gain_rows] * found.size[k, j] / solution.gains[:n],
        )
        for j, k in enumerate(worst)
    )


def _first_largest(values: np.ndarray) -> np.ndarray:
    """Find the first of the largest values along the first axis, whatever rounding does to equal ones.

    Of two runs one is larger as significantly as the other is smaller.
    """
    return np.asarray(np.argmax(values >= (1 - TIE) * values.max(axis=0), axis=0))


def _windows(problem: Problem, solution: Solution, members: np.ndarray) -> Iterator[LinearisedWindow]:
    """Build the jackknife blocks, each joint offered its model's current again in each group (groups, U)."""
    state = solution.iterate
    weights = 1 / np.maximum(solution.sigma, problem.smallest_sigma)
    for block, mine in zip(problem.blocks, members.T, strict=True):
        e, J = residuals(block, state), jacobian(block, state, problem, True)
        current = modelled(block, state.theta) * state.b[:, None]
        yield LinearisedWindow(
            e * weights[:, None], J * weights[:, None, None], -(current * weights[:, None])[..., None] * mine
        )
