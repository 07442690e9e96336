"""A low-pass filter of the current: the second derivative of the torque beside its delay, to first order.

The derivative is of the model's torque: the measured current is correlated with its own noise.
"""

from __future__ import annotations

from gtau.estimation.effects.effect import Effect, EffectColumn, FitWindow, Torques, Words
from gtau.estimation.estimators.estimator import Fit
from gtau.signals.preparation.filters import differentiate

PLAUSIBLE = 1e-4  # s2: a filter of 14 ms (experience)


def _torques(at: FitWindow) -> Torques:
    _, change = differentiate(at.unmoved.T, at.window.run.rate)
    return at.decimated(change.T[None])


def _say(fit: Fit, column: EffectColumn, size: float) -> Words:
    what = f"a low-pass filter of the current of '{column.joint}'"
    return what, "log the current before any filter, and move more slowly"


EFFECT = Effect("current lag", _torques, lambda fit: [EffectColumn(PLAUSIBLE, "s2")], _say)
