"""A low-pass filter of the current: beside its delay, the second derivative of the torque behind such a filter.

The torque is the model's: the measured current is correlated with its own noise. Beside the delay ``T``, a filter
``1 / (1 + s T)`` adds about ``(s T)^2 / 2 / (1 + s T)``: the shape is taken at the delay, and its size is estimated.
"""

from __future__ import annotations

import numpy as np

from gtau.estimation.effects.effect import Effect, EffectColumn, FitWindow, Torques, Words
from gtau.estimation.estimators.estimator import Fit
from gtau.model.kernel import recur
from gtau.signals.preparation.filters import differentiate

PLAUSIBLE = 1e-4  # s2: a filter of 14 ms (experience)
LAG = 0.008  # s, of the shape at least; longer lags have their own


def _torques(at: FitWindow) -> Torques:
    rate, filtered = at.window.run.rate, at.unmoved.copy()
    lags = np.maximum(LAG, -at.fit.solution.delays[: len(filtered)])  # a filter delays by its lag
    for row, past in zip(filtered, np.exp(-1 / (lags * rate)).tolist(), strict=True):
        recur(np.array([[1 - past, 0.0, 0.0, -past, 0.0]]), row[None])
    _, change = differentiate(filtered.T, rate)
    return at.decimated(change.T[None])


def _say(fit: Fit, column: EffectColumn, size: float) -> Words:
    what = f"a low-pass filter of the {fit.kind} of '{column.joint}'"
    return what, f"log the {fit.kind} before any filter, and move more slowly"


EFFECT = Effect("current lag", _torques, lambda fit: [EffectColumn(PLAUSIBLE, "s2")], _say, of_motion=True)
