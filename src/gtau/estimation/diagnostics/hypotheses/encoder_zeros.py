"""Encoders whose zero is off: each joint's position with a constant added."""

from __future__ import annotations

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.hypotheses.hypothesis import Candidates, Hypothesis
from gtau.estimation.diagnostics.hypotheses.window_motion import shifted_motion, window_motion
from gtau.estimation.diagnostics.linearisation import CandidateColumns, at_full_rate
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.thresholds.plausible_sizes import PLAUSIBLE_ZERO
from gtau.signals.preparation import InMemoryRun

DEGREE, MILLIMETRE = np.pi / 180, 1e-3
STEP = 0.1  # of the unit: the torques' change is linear over this


def _candidates(fit: Fit) -> Candidates:
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
        tuple(f"an error in the zero of encoder '{joint}'" for joint in model.actuated),
        tuple("deg" if turn else "mm" for turn in turns),
        np.full((n, 1), PLAUSIBLE_ZERO),
        offer,
    )


ENCODER_ZEROS = Hypothesis(
    "encoder zeros", True, _candidates, "check the zeros of the encoders against the robot's own", description=True
)
