"""Encoders whose zero is off: each joint's position with a constant added."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.hypotheses.hypothesis import Candidates, Hypothesis
from gtau.estimation.diagnostics.linearisation import CandidateColumns, alongside
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.rows import stream_rows
from gtau.estimation.thresholds import PLAUSIBLE_ZERO
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
        def torques(shift: np.ndarray) -> Iterator[np.ndarray]:
            moved = InMemoryRun(window.run, replace(window.all, q=window.all.q + shift))
            for rows in stream_rows(model, regressor, moved, dataset.preparation.at(window.run.rate).decimator):
                yield regressor.torques(rows.entries, values, n)

        def stream() -> Iterator[np.ndarray]:
            shifts = np.diag(STEP * unit)
            streams = [torques(shift) for shift in shifts]
            for before in torques(np.zeros(n)):
                columns = np.zeros((n, before.shape[1], n))
                for k, each in enumerate(streams):
                    try:
                        columns[:, :, k] = (next(each) - before) / STEP
                    except (GtauError, StopIteration):
                        streams[k] = iter(())  # the loops do not close there: nothing is said of this zero
                yield columns

        return alongside(stream())

    return Candidates(
        tuple(f"the zero of encoder '{joint}'" for joint in model.actuated),
        tuple("deg" if turn else "mm" for turn in turns),
        np.full((n, 1), PLAUSIBLE_ZERO),
        offer,
    )


ENCODER_ZEROS = Hypothesis(
    "encoder zeros", True, _candidates, "check the zeros of the encoders against the robot's own", description=True
)
