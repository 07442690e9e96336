"""Test whether a joint whose position never changes in a run has moved, as of an encoder that was not read.

A joint that a brake holds leaves the equations of the others as they are. One that moves unseen has turned the links
behind it, so that in this run the model of no neighbour explains its current, which it does in other runs.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.equations import SIGNAL
from gtau.estimation.thresholds.estimates import MISFIT
from gtau.estimation.thresholds.logs import UNSEEN_MISFIT, UNSEEN_RATIO
from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.signals.samples import extremes


def frozen_encoders(fit: Fit) -> tuple[Finding, ...]:
    """Find the joints that never move in a run, by their positions, but whose motion its other joints feel."""
    runs, n = fit.dataset.runs, len(fit.gains)
    moving = np.array([np.subtract(*extremes(run.position)[::-1]) > 0 for run in runs])
    acting = np.array([np.subtract(*extremes(run.command)[::-1])[:n] > 0 for run in runs])
    return tuple(_frozen(fit, moving, acting)) if np.any(acting & ~moving) else ()


def _frozen(fit: Fit, moving: np.ndarray, acting: np.ndarray) -> Iterator[Finding]:
    joints, runs = fit.system.problem.joints, fit.dataset.runs
    shares = unexplained_by_run(fit)
    for run, joint in np.argwhere(acting & ~moving).tolist():
        usual = shares[moving[:, joint]].max(axis=0, initial=0.0)
        least = np.where(usual > 0, np.maximum(UNSEEN_RATIO * usual, UNSEEN_MISFIT), MISFIT)
        worst = int(np.argmax(shares[run] / least))
        if shares[run, worst] > least[worst]:
            share, named = float(shares[run, worst]), (joints[joint], joints[worst])
            values = {"run": runs[run].name, "kind": runs[run].kind, "share": share, "usual": float(usual[worst])}
            yield Finding(F.FROZEN, named, values=values, size=share)


def unexplained_by_run(fit: Fit) -> np.ndarray:
    """Compute the share of each joint's current that its own equations leave unexplained in each run, (runs, n)."""
    problem, unit_runs = fit.system.problem, fit.system.block_positions[:, 0]
    found = np.zeros((len(fit.dataset.runs), len(problem.joints)))
    for run, joint in np.ndindex(*found.shape):
        rows = problem.blocks[unit_runs == run, joint].reshape(-1, problem.blocks.shape[-1])
        W, v = rows[:, problem.own_columns[joint]], rows[:, SIGNAL]
        W = W / np.maximum(np.linalg.norm(W, axis=0), 1e-300)
        rest = v - W @ np.linalg.lstsq(W, v, rcond=1e-9)[0]
        found[run, joint] = np.linalg.norm(rest) / max(float(np.linalg.norm(v)), 1e-300)
    return found
