"""Another gravity: a base that is tilted. Torques are linear in gravity, so its changes are candidate columns."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gtau.estimation.diagnostics.hypotheses.hypothesis import Candidates, Hypothesis
from gtau.estimation.diagnostics.linearisation import CandidateColumns, alongside
from gtau.estimation.diagnostics.plausibility import other_clock
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.rows import stream_rows
from gtau.estimation.thresholds import CLOCK_REVERSED, CLOCK_SIZE, PLAUSIBLE_GRAVITY, PLAUSIBLE_TILT
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.signals.preparation import InMemoryRun

DEGREE = np.pi / 180
ADVICE = (
    "check the direction of gravity, that the base is level, the sampling rate, which runs carry the payload, and on "
    "which body"
)


def _candidates(fit: Fit) -> Candidates | None:
    dataset = fit.dataset
    robot, n = dataset.robot, len(dataset.model.actuated)
    gravity = np.array(robot.gravity)
    size = float(np.linalg.norm(gravity))
    if not size:
        return None
    _, _, Vt = np.linalg.svd(gravity[None, :])
    changes = [*Vt[1:] * size * DEGREE, gravity / 100]  # m/s2 a degree, and a per cent
    models = [InverseDynamics(replace(robot, gravity=tuple(gravity + change))) for change in changes]
    own = dataset.model.columns(dataset.base.standard)
    others = [(model, model.columns(dataset.base.standard)) for model in models]

    def offer(window: InMemoryRun, values: np.ndarray) -> CandidateColumns:
        def stream() -> Iterator[np.ndarray]:
            streams = [
                stream_rows(model, regressor, window, dataset.preparation.at(window.run.rate).decimator)
                for model, regressor in ((dataset.model, own), *others)
            ]
            for before, *tilted in zip(*streams, strict=True):
                torques = own.torques(before.entries, values, n)
                moved = [r.torques(rows.entries, values, n) for rows, (_, r) in zip(tilted, others, strict=True)]
                yield np.stack([each - torques for each in moved], axis=-1)

        return alongside(stream())

    names = [f"gravity tilted towards ({tilt[0]:.2g}, {tilt[1]:.2g}, {tilt[2]:.2g})" for tilt in Vt[1:]]
    plausible = np.array([[PLAUSIBLE_TILT], [PLAUSIBLE_TILT], [PLAUSIBLE_GRAVITY]])

    def describe(sizes: np.ndarray, shares: np.ndarray) -> tuple[str, str]:
        x, y, z = gravity + sizes @ np.array(changes)
        factor = 1 + sizes[-1] / 100
        # as where gravity points up
        reversed_ = factor < CLOCK_REVERSED or bool(np.any(fit.solution.gains < 0))
        if shares[-1] > CLOCK_SIZE and not reversed_:
            why, advice = other_clock(factor, dataset.runs)
            return f"another clock: {why}", advice
        return f"another gravity, about ({x:.1f}, {y:.1f}, {z:.1f}) m/s2", ADVICE

    return Candidates((*names, "the strength of gravity"), ("deg", "deg", "%"), plausible, offer, describe)


GRAVITY = Hypothesis(
    "gravity",
    True,
    _candidates,
    ADVICE,
    description=True,
)
