"""Currents that lag behind the torque by more than a delay, or transmissions that give way.

A low-pass filter of the current and the elasticity of a transmission both add the second derivative of the torque
to the equations, to first order. It is taken of the model's torque: that of the measured current is correlated with the
noise in the current itself.
"""

from __future__ import annotations

import numpy as np

from gtau.estimation.diagnostics.hypotheses.hypothesis import Candidates, Hypothesis
from gtau.estimation.diagnostics.hypotheses.window_motion import window_motion
from gtau.estimation.diagnostics.linearisation import CandidateColumns, at_full_rate
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.thresholds.plausible_sizes import PLAUSIBLE_LAG
from gtau.signals.filters import differentiate
from gtau.signals.preparation import InMemoryRun


def _candidates(fit: Fit) -> Candidates:
    model, n = fit.dataset.model, len(fit.gains)
    regressor = model.columns(fit.dataset.base.standard)

    def offer(window: InMemoryRun, values: np.ndarray) -> CandidateColumns:
        torques = regressor.torques_along(model.layout, window_motion(model, window), values)
        _, change = differentiate(torques.T, window.run.rate)
        return at_full_rate(window, fit.dataset, change.T[None])

    return Candidates(
        ("a low-pass filter of the current of {subject}, or an elastic transmission",),
        ("s2",),
        np.full((1, n), PLAUSIBLE_LAG),
        offer,
    )


CURRENT_LAG = Hypothesis("current lag", False, _candidates, "log the current before any filter, and move more slowly")
