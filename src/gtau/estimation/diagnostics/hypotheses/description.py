"""Errors of the description of robot and logs: encoder zeros and gravity.

An encoder's zero adds a constant to its joint's position. Torques are linear in gravity, so a tilted base and another
strength of gravity are candidate columns.
"""

from __future__ import annotations

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.finding import Finding
from gtau.estimation.diagnostics.finding import FindingKind as F
from gtau.estimation.diagnostics.hypotheses.hypothesis import Candidates, Hypothesis, shifted_motion, window_motion
from gtau.estimation.diagnostics.linearisation import CandidateColumns, at_full_rate
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.plausibility import stated_rate
from gtau.estimation.thresholds.estimates import (
    CLOCK_REVERSED,
    CLOCK_SIZE,
    PLAUSIBLE_GRAVITY,
    PLAUSIBLE_TILT,
    PLAUSIBLE_ZERO,
)
from gtau.signals.preparation import InMemoryRun

DEGREE, MILLIMETRE = np.pi / 180, 1e-3
STEP = 0.1  # of the unit: the torques' change is linear over this


def _encoder_zeros(fit: Fit) -> Candidates:
    """Add a constant error of a joint's position."""
    dataset = fit.dataset
    model, n = dataset.model, len(dataset.model.actuated)
    turns = [dataset.robot.joint(joint).kind == "revolute" for joint in model.actuated]
    unit = np.array([DEGREE if turn else MILLIMETRE for turn in turns])
    regressor = model.columns(dataset.base.standard)

    def offer(window: InMemoryRun, values: np.ndarray) -> CandidateColumns:
        motion = window_motion(model, window)
        before = regressor.torques_along(model.layout, motion, values)
        columns = np.zeros((n, *before.shape))
        for k, shift in enumerate(np.diag(STEP * unit)):
            try:
                moved = shifted_motion(model, window, shift, motion.c[:, 0])
            except GtauError:
                continue  # the loops do not close there: nothing is said of this zero
            columns[k] = (regressor.torques_along(model.layout, moved, values) - before) / STEP
        return at_full_rate(window, dataset, columns)

    return Candidates(
        [Finding(F.ENCODER_ZERO, (joint,)) for joint in model.actuated],
        tuple("deg" if turn else "mm" for turn in turns),
        np.full((n, 1), PLAUSIBLE_ZERO),
        offer,
    )


ENCODER_ZEROS = Hypothesis("encoder zeros", True, _encoder_zeros, description=True)


def _gravity(fit: Fit) -> Candidates | None:
    """Add a tilt of the base, or another strength of gravity (a wrong clock)."""
    dataset = fit.dataset
    gravity = np.array(dataset.robot.gravity)
    size = float(np.linalg.norm(gravity))
    if not size:
        return None
    _, _, Vt = np.linalg.svd(gravity[None, :])
    changes = [*Vt[1:] * size * DEGREE, gravity / 100]  # m/s2 a degree, and a per cent
    model, n = dataset.model, len(dataset.model.actuated)
    regressor = model.gravity_torques(dataset.base.standard)

    def offer(window: InMemoryRun, values: np.ndarray) -> CandidateColumns:
        entries = regressor(model.layout, window_motion(model, window), values)
        return at_full_rate(window, dataset, np.stack([regressor.torques(entries, each, n) for each in changes]))

    tilts = [Finding(F.GRAVITY_TILT, values={"towards": tilt.tolist()}) for tilt in Vt[1:]]
    plausible = np.array([[PLAUSIBLE_TILT], [PLAUSIBLE_TILT], [PLAUSIBLE_GRAVITY]])

    def describe(sizes: np.ndarray, shares: np.ndarray) -> Finding:
        factor = 1 + sizes[-1] / 100
        # as where gravity points up
        reversed_ = factor < CLOCK_REVERSED or bool(np.any(fit.gains < 0))
        if shares[-1] > CLOCK_SIZE and not reversed_:
            return Finding(F.CLOCK, values={"factor": float(factor), "rate": stated_rate(dataset.runs[0])})
        return Finding(F.GRAVITY, values={"gravity": (gravity + sizes @ np.array(changes)).tolist()})

    return Candidates([*tilts, Finding(F.GRAVITY_STRENGTH)], ("deg", "deg", "%"), plausible, offer, describe)


GRAVITY = Hypothesis(
    "gravity",
    True,
    _gravity,
    description=True,
)
