"""Test whether the logged torques exclude gravity, as with a driver that compensates it.

Fitted with gravity, such torques require links with centres of mass on the axes, whose inertia does not explain them.
So a robot whose fit has hardly any gravity torque is fitted once more without gravity.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gtau.estimation.diagnostics.finding import Finding
from gtau.estimation.diagnostics.finding import FindingKind as F
from gtau.estimation.diagnostics.hypotheses.hypothesis import rms_torques, window_motion
from gtau.estimation.diagnostics.linearisation import central_windows
from gtau.estimation.diagnostics.other_gravity import OtherGravity, fitted, left_of
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.thresholds.torques import AS_WELL, GRAVITY_FELT, NO_GRAVITY, UNFELT


def missing_gravity(fit: Fit, asked: bool = False) -> OtherGravity | Finding | None:
    """Find that a fit without gravity explains more, or, as a finding, that it explains as much; None where less.

    It is tried where the fit hardly feels gravity, or ``asked`` for it.
    """
    felt = float(gravity_shares(fit).max(initial=0.0))
    if felt < UNFELT or not (asked or felt < GRAVITY_FELT):
        return None
    windows = [window for _, window in central_windows(fit.dataset)]
    middle = replace(fit.dataset, prepared=tuple(windows))  # type: ignore[arg-type]  # used as prepared runs
    own = fitted(fit, middle, np.array(fit.dataset.robot.gravity)) if windows else None
    other = None if own is None else fitted(fit, middle, np.zeros(3))
    if own is None or other is None or (left := left_of(other, own)) > AS_WELL:
        return None
    if left > NO_GRAVITY:
        return Finding(F.NO_GRAVITY_SHOWN, values={"felt": felt})
    n, before, after = len(fit.gains), own.solution.sigma, other.solution.sigma
    shares, ratio = before / own.system.problem.balance(own.solution.theta), after / before
    joints = fit.system.problem.joints
    helped = [j for j in range(n) if ratio[j] <= max(np.sqrt(left), ratio[:n].min())]
    explained = {joints[j]: [float(shares[j]), float(shares[j] * ratio[j])] for j in helped}
    moves = other.gains / own.gains - 1 if fit.free_gains else np.zeros(n)
    rows = own.system.problem.total_rows
    cause = Finding(F.WITHOUT_GRAVITY, tuple(explained), values={"left": explained, "remains": left})
    return OtherGravity(cause, 1 - float(rows @ ratio**2 / rows.sum()), moves)


def gravity_shares(fit: Fit) -> np.ndarray:
    """Compute the ratio of rms gravity torque (about its mean) to rms total torque of each joint, (n,)."""
    dataset, n = fit.dataset, len(fit.gains)
    gravity = np.array(dataset.robot.gravity)
    if not gravity.any():
        return np.zeros(n)
    regressor, found = dataset.model.gravity_torques(dataset.base.standard), np.zeros(n)
    for run, window in central_windows(dataset):
        entries = regressor(
            dataset.model.layout, window_motion(dataset.model, window), fit.system.motion(run, fit.solution.theta)
        )
        torques = np.reshape(regressor.torques(entries, gravity, n), (n, -1))
        found = np.maximum(found, torques.std(axis=1))
    return np.asarray(found / np.maximum(rms_torques(fit), 1e-300))
