"""Torques of one joint in another scale: links that joints share would have another inertia at each."""

from __future__ import annotations

from gtau.estimation.effects.effect import Effect, EffectColumn, FitWindow, Torques, Words
from gtau.estimation.estimators.estimator import Fit

PLAUSIBLE = 0.1  # relative error of one joint's torques, or of its given gain: experience


def _torques(at: FitWindow) -> Torques:
    return lambda rows: at.torques(rows)[:, :, None]


def _say(fit: Fit, column: EffectColumn, size: float) -> Words:
    what = f"torques of '{column.joint}' in another scale than the torques of the other joints"
    return what, "check the gear ratio, the torque constant and the unit of its torques"


EFFECT = Effect(
    "torque scale", _torques, lambda fit: [] if fit.free_gains else [EffectColumn(PLAUSIBLE)], _say, description=True
)
