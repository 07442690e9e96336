"""Friction of another shape: cubic in speed, growing with the load, or Stribeck's.

The load is the model's, without friction, as in the term ``fl``. That of the measured current is the current itself
where friction exceeds the load, so it would explain the noise of the current and any drive gain.
"""

from __future__ import annotations

import numpy as np

from gtau.estimation.diagnostics.hypotheses.hypothesis import (
    Candidates,
    Hypothesis,
    friction_levels,
    rms_speeds,
    rms_torques,
)
from gtau.estimation.diagnostics.hypotheses.window_motion import window_motion
from gtau.estimation.diagnostics.linearisation import CandidateColumns, at_full_rate
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.friction import transmitted
from gtau.estimation.thresholds.plausible_sizes import (
    PLAUSIBLE_CUBIC,
    PLAUSIBLE_LOAD_FRICTION,
    PLAUSIBLE_STRIBECK,
    STRIBECK_SPEED,
)
from gtau.signals.preparation import InMemoryRun


def _candidates(fit: Fit) -> Candidates:
    joints, speeds = fit.dataset.model.actuated, rms_speeds(fit)
    fv, fs = friction_levels(fit)
    level = np.maximum(fv * speeds + fs, 0.02 * rms_torques(fit))
    model, base = fit.dataset.model, fit.dataset.base
    regressor, acting = model.columns(base.standard), transmitted(base.names)
    absent = {term: np.array([f"{term}_{j}" not in fit.system.friction.terms for j in joints]) for term in ("f3", "fl")}

    def offer(window: InMemoryRun, values: np.ndarray) -> CandidateColumns:
        of = window.samples()
        ratio, sign = of.qd / np.where(speeds > 0, speeds, 1.0), np.sign(of.qd)
        cubic = level * ratio**3 / 3 * absent["f3"]
        torques = regressor.torques_along(model.layout, window_motion(model, window), values * acting)
        load = np.abs(torques.T) * sign * absent["fl"]
        stribeck = level * np.exp(-np.abs(ratio) / STRIBECK_SPEED) * sign
        return at_full_rate(window, fit.dataset, np.stack([cubic.T, load.T, stribeck.T]))

    plausible = np.array([PLAUSIBLE_CUBIC, PLAUSIBLE_LOAD_FRICTION, PLAUSIBLE_STRIBECK])
    return Candidates(
        ("cubic friction of {subject}", "load-dependent friction of {subject}", "Stribeck friction of {subject}"),
        ("of its friction", "of its load", "of its friction"),
        np.repeat(plausible[:, None], len(joints), axis=1),
        offer,
    )


FRICTION_SHAPE = Hypothesis(
    "friction shape", False, _candidates, "add runs at other speeds, or with other loads, to separate it from the rest"
)
