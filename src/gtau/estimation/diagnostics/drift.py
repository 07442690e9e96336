"""Drift within a run: whether currents and model part company between its beginning and its end.

Friction of a joint that warms up, or a drive whose gain does, changes in the course of a run. Differences
between runs are part of the model (see :mod:`gtau.estimation.regression.friction`); those within a run are not, and
no deviation shows them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gtau.estimation.estimators.newton import modelled, residuals
from gtau.estimation.estimators.solution import Solution
from gtau.estimation.regression.problem import Problem

ENOUGH = 8  # stretches of a run in which the joint moves


@dataclass(frozen=True)
class Drift:
    """By how much of itself a joint's current grows along a run against the model, and how significant that is."""

    run: int
    change: float
    t: float


NONE = Drift(0, 0.0, 0.0)


def worst_drifts(problem: Problem, solution: Solution, block_positions: np.ndarray) -> tuple[Drift, ...]:
    """The most significant drift of every joint.

    The residual of each unit is laid along the current that the model gives it; a line through these
    shares over a run, weighted by the size of the current, has the drift as its slope.

    Parameters
    ----------
    problem, solution : Problem, Solution
        What was solved.
    block_positions : ndarray
        Of the units, (U, 2): number of the run, and time from its beginning (0) to its end (1).
    """
    state = solution.iterate
    e = residuals(problem.blocks, state, problem.n_theta)  # (U, n, p)
    tau = modelled(problem.blocks, state.theta) * state.b[:, None]
    weight = np.einsum("ujp,ujp->uj", tau, tau)
    share = np.einsum("ujp,ujp->uj", tau, e) / np.where(weight > 0, weight, 1.0)
    found = []
    for j in range(len(problem.joints)):
        of_joint = [NONE]
        for run in np.unique(block_positions[:, 0]):
            mine = np.flatnonzero((block_positions[:, 0] == run) & (weight[:, j] > 0))
            if len(mine) < ENOUGH:
                continue
            root = np.sqrt(weight[mine, j])
            X = np.column_stack([block_positions[mine, 1], np.ones(len(mine))]) * root[:, None]
            y = share[mine, j] * root
            line = np.linalg.lstsq(X, y, rcond=None)[0]
            rest = y - X @ line
            std = np.sqrt(rest @ rest / (len(mine) - 2) * np.linalg.inv(X.T @ X)[0, 0])
            of_joint.append(Drift(int(run), float(line[0]), float(line[0] / max(std, 1e-300))))
        found.append(max(of_joint, key=lambda drift: abs(drift.t)))
    return tuple(found)
