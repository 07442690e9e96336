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
from gtau.estimation.estimators.newton import jacobian, modelled, residuals
from gtau.estimation.estimators.solution import Solution
from gtau.estimation.regression.problem import Problem
from gtau.estimation.thresholds import DOMINANT


@dataclass(frozen=True)
class Difference:
    """By what share of itself a joint's current is larger in some ``runs`` than in the others; how significant.

    ``share`` of the variance of all joints' errors goes where each has such a difference in these runs.
    """

    runs: tuple[int, ...]
    change: float
    t: float
    share: float


def worst_differences(problem: Problem, solution: Solution, block_positions: np.ndarray) -> tuple[Difference, ...]:
    """The most significant difference of every joint between one run, or the loaded ones, and the others.

    The current of the model is offered once more in these runs alone, see :func:`score_tests`.

    Parameters
    ----------
    problem, solution : Problem, Solution
        What was solved, with gains that were estimated.
    block_positions : ndarray
        Of the units, (U, 2): number of the run, and time from its beginning (0) to its end (1).
    """
    n, (runs, of_unit) = len(problem.joints), np.unique(block_positions[:, 0].astype(int), return_inverse=True)
    loaded = np.zeros(len(runs), dtype=bool)
    np.logical_or.at(loaded, of_unit, np.any(problem.blocks[..., problem.n_theta], axis=(1, 2)))
    groups = np.unique(np.vstack([np.eye(len(runs), dtype=bool), loaded]), axis=0)
    groups = groups[~groups.all(axis=1) & groups.any(axis=1)]
    nothing = Difference((), 0.0, 0.0, 0.0)
    if not len(groups):
        return (nothing,) * n

    found = score_tests(lambda: _pieces(problem, solution), groups[:, of_unit])
    shares = found.share.sum(axis=1)
    worst = np.argmax(np.abs(found.t), axis=0)
    if shares.max() > DOMINANT:  # the same runs for all joints
        worst[:] = np.argmax(shares)
    return tuple(
        Difference(tuple(runs[groups[k]].tolist()), float(found.size[k, j]), float(found.t[k, j]), float(shares[k]))
        for j, k in enumerate(worst)
    )


def _pieces(problem: Problem, solution: Solution) -> Iterator[LinearisedWindow]:
    """The units, each joint offered the current of its model once more."""
    state = solution.iterate
    weights = 1 / np.maximum(solution.sigma, problem.smallest_sigma)
    for block in problem.blocks:
        e, J = residuals(block, state, problem.n_theta), jacobian(block, state, problem, True)
        current = modelled(block, state.theta) * state.b[:, None]
        yield LinearisedWindow(
            e * weights[:, None], J * weights[:, None, None], -(current * weights[:, None])[..., None]
        )
