"""Another gravity: a base that is tilted. Torques are linear in gravity, so its changes are candidate columns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gtau.estimation.diagnostics.hypotheses.hypothesis import Candidates, Hypothesis
from gtau.estimation.diagnostics.hypotheses.window_motion import window_motion
from gtau.estimation.diagnostics.linearisation import CandidateColumns, at_full_rate
from gtau.estimation.diagnostics.plausibility import other_clock
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.thresholds.plausible_sizes import PLAUSIBLE_GRAVITY, PLAUSIBLE_TILT
from gtau.estimation.thresholds.refutation import CLOCK_REVERSED, CLOCK_SIZE
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.signals.preparation import InMemoryRun

DEGREE = np.pi / 180
ADVICE = (
    "check the direction of gravity, that the base is level, the sampling rate, which runs carry the payload, and on "
    "which body"
)


def _candidates(fit: Fit) -> Candidates | None:
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
    _candidates,
    ADVICE,
    description=True,
)
