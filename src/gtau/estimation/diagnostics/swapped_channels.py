"""Swapped channels: each of two joints' motions explains the other's current best."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from gtau.estimation.diagnostics.linearisation import central_windows, least_squares_step
from gtau.estimation.diagnostics.verdict import Refutation
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.rows import stream_rows
from gtau.estimation.thresholds.refutation import SWAPPED


def unexplained(dataset: Dataset) -> np.ndarray:
    """Compute the share of each joint's current (columns) that each joint's regressor (rows) leaves unexplained.

    Each joint is fitted by itself, with other parameters for each payload.
    """
    n, regressor = len(dataset.model.actuated), dataset.model.columns(dataset.base.standard)
    loads = [None if run.payload is None else run.payload.name for run in dataset.runs]
    kinds = list(dict.fromkeys(loads))
    rows: list[list[np.ndarray]] = [[] for _ in range(n)]
    currents: list[list[np.ndarray]] = [[] for _ in range(n)]
    for run, piece in central_windows(dataset):
        mine = np.array([loads[run] == kind for kind in kinds], dtype=float)
        for part in stream_rows(dataset.model, regressor, piece, dataset.preparation.at(piece.run.rate).decimator):
            for j in range(n):
                own = part.entries[regressor.rows == j][:, part.keep[j]].T
                rows[j].append(np.kron(mine, own))
                currents[j].append(part.currents[0, :n, part.keep[j]])
    left = np.zeros((n, n))
    for j in range(n):
        W, V = np.concatenate(rows[j]), np.concatenate(currents[j])
        rest = V + W @ least_squares_step(W, V)
        left[j] = np.linalg.norm(rest, axis=0) / np.maximum(np.linalg.norm(V, axis=0), 1e-300)
    return left


def swapped_channels(dataset: Dataset) -> tuple[Refutation, ...]:
    """Find the pairs of joints whose currents (or torques) look swapped."""
    left, joints = unexplained(dataset), dataset.model.actuated
    columns = "torques" if dataset.runs[0].kind == "torque" else "currents"
    return tuple(
        Refutation(
            (j, k),
            f"the {columns} of '{joints[j]}' and '{joints[k]}' look swapped: "
            f"{100 * max(left[j, k], left[k, j]):.2g} % of them would stay unexplained if they were exchanged, "
            f"{100 * min(left[j, j], left[k, k]):.2g} % as they are",
            f"check that position and {columns[:-1]} columns belong together, in all runs",
        )
        for j, k in combinations(range(len(joints)), 2)
        if left[j, k] < SWAPPED * left[j, j] and left[k, j] < SWAPPED * left[k, k]
    )
