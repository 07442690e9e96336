"""Torques of the model along positions that are moved: what wrong zeros and scales of encoders would add."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.effects.linearisation import CandidateColumns, FitWindow, motion_along
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.rows import instants

STEP = 0.1  # of the unit: the torques' change is linear over this


def position_units(fit: Fit) -> list[str]:
    """List the unit of each actuated joint's zero: degrees or millimetres."""
    return ["deg" if fit.dataset.robot.joint(joint).turns else "mm" for joint in fit.dataset.model.actuated]


def with_positions(at: FitWindow, factors: np.ndarray, shifts: np.ndarray) -> CandidateColumns:
    """Move the positions of each joint in turn by factors and shifts, both (., n), a ``STEP`` of its unit."""
    model, window = at.fit.dataset.model, at.window
    before = at.torques_along(at.motion, at.values)
    columns = np.zeros((len(shifts), *before.shape))
    for column, factor, shift in zip(columns, factors, shifts, strict=True):
        q, qd, qdd = window.q * factor + shift, window.qd * factor, window.qdd * factor
        moved, labels = replace(window, q=q, qd=qd, qdd=qdd, part_of=None), instants(window.run.name, window.time)
        try:  # from each configuration, so that loops are closed as before
            path = model.near(at.motion.c, np.ascontiguousarray(q.T), labels)
            after = at.torques_along(motion_along(model, moved, path), at.values)
        except GtauError:
            continue  # the loops do not close there: nothing is said of this joint
        column[:] = (after - before) / STEP
    return at.decimated(columns)
