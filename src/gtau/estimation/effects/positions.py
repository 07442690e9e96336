"""Torques of the model along positions that are moved: what wrong zeros, scales and elastic joints would add."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.effects.linearisation import FitWindow, Torques, motion_along
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.rows import instants

Moved = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Positions, velocities and accelerations (N, n)."""
STEP = 0.1  # of the unit: the torques' change is linear over this


def position_units(fit: Fit) -> list[str]:
    """List the unit of each actuated joint's zero: degrees or millimetres."""
    return ["deg" if fit.dataset.robot.joint(joint).turns else "mm" for joint in fit.dataset.model.actuated]


def with_positions(at: FitWindow, moved: Iterable[Moved]) -> Torques:
    """Compute how torques change along motions that are moved by a ``STEP`` of their unit, a column each."""
    model, window = at.fit.dataset.model, at.window
    before, labels = at.torques_along(at.motion, at.values), instants(window.run.name, window.time)
    columns = []
    for q, qd, qdd in moved:
        other = replace(window, q=q, qd=qd, qdd=qdd, part_of=None)
        try:  # from each configuration, so that loops are closed as before
            path = model.near(at.motion.c, np.ascontiguousarray(q.T), labels)
            after = at.torques_along(motion_along(model, other, path), at.values)
        except GtauError:
            after = before  # the loops do not close there: nothing is said of this joint
        columns.append((after - before) / STEP)
    return at.decimated(np.array(columns))
