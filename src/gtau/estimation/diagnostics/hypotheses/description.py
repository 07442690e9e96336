"""Errors of the description of robot and logs: encoder zeros and gravity.

An encoder's zero adds a constant to its joint's position. Torques are linear in gravity, so a tilted base and another
strength of gravity are candidate columns.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.hypotheses.hypothesis import Candidates, Hypothesis, shifted_motion, window_motion
from gtau.estimation.diagnostics.linearisation import CandidateColumns, at_full_rate
from gtau.estimation.diagnostics.log_checks import other_clock
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.thresholds.estimates import (
    CLOCK_REVERSED,
    CLOCK_SIZE,
    PLAUSIBLE_GRAVITY,
    PLAUSIBLE_TILT,
    PLAUSIBLE_ZERO,
)
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.signals.preparation import InMemoryRun

DEGREE, MILLIMETRE = np.pi / 180, 1e-3
STEP = 0.1  # of the unit: the torques' change is linear over this


def _encoder_zeros(fit: Fit) -> Candidates:
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
    "encoder zeros", True, _encoder_zeros, "check the zeros of the encoders against the robot's own", description=True
)


DEGREE = np.pi / 180
ADVICE = (
    "check the direction of gravity, that the base is level, the sampling rate, which runs carry the payload, and on "
    "which body"
)


def _gravity(fit: Fit) -> Candidates | None:
    dataset = fit.dataset
    robot = dataset.robot
    gravity = np.array(robot.gravity)
    size = float(np.linalg.norm(gravity))
    if not size:
        return None
    _, _, Vt = np.linalg.svd(gravity[None, :])
    changes = [*Vt[1:] * size * DEGREE, gravity / 100]  # m/s2 a degree, and a per cent
    models = [InverseDynamics(replace(robot, gravity=tuple(gravity + change))) for change in changes]
    model, standard = dataset.model, dataset.base.standard
    own, others = model.columns(standard), [each.columns(standard) for each in models]

    def offer(window: InMemoryRun, values: np.ndarray) -> CandidateColumns:
        motion = window_motion(model, window)  # gravity does not change it
        before = own.torques_along(model.layout, motion, values)
        torques = [each.torques_along(model.layout, motion, values) - before for each in others]
        return at_full_rate(window, dataset, np.stack(torques))

    names = [f"gravity tilted towards ({tilt[0]:.2g}, {tilt[1]:.2g}, {tilt[2]:.2g})" for tilt in Vt[1:]]
    plausible = np.array([[PLAUSIBLE_TILT], [PLAUSIBLE_TILT], [PLAUSIBLE_GRAVITY]])

    def describe(sizes: np.ndarray, shares: np.ndarray) -> tuple[str, str]:
        x, y, z = gravity + sizes @ np.array(changes)
        factor = 1 + sizes[-1] / 100
        # as where gravity points up
        reversed_ = factor < CLOCK_REVERSED or bool(np.any(fit.gains < 0))
        if shares[-1] > CLOCK_SIZE and not reversed_:
            why, advice = other_clock(factor, dataset.runs)
            return f"another clock: {why}", advice
        return f"another gravity, about ({x:.1f}, {y:.1f}, {z:.1f}) m/s2", ADVICE

    return Candidates((*names, "gravity of another strength"), ("deg", "deg", "%"), plausible, offer, describe)


GRAVITY = Hypothesis(
    "gravity",
    True,
    _gravity,
    ADVICE,
    description=True,
)
