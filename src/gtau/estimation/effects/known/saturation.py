"""A torque constant that falls with the current, ``tau abs(tau)``.

Iron saturates, and some drives log currents before they limit them. A payload then scales the gain at the largest
currents, and the other parameters absorb the rest so well that the size of the residuals hardly shows it: with a
constant that falls by 10 per cent the gain is 12 per cent off. The shape of the residuals does show it.
"""

from __future__ import annotations

import numpy as np

from gtau.estimation.effects.effect import Effect, EffectColumn, FitWindow, Torques, Words, rms_torques
from gtau.estimation.estimators.estimator import Fit

PLAUSIBLE = 0.03  # relative fall up to twice the rms current: 0 to 0.05 (data sheets of servo motors)
LARGE = 2.0  # rms currents: where the fall is stated


def _torques(at: FitWindow) -> Torques:
    # at every sample: the square of a decimated torque lacks what friction adds where it reverses
    tau = at.unmoved
    return at.decimated((np.abs(tau) * tau / (LARGE * rms_torques(at.fit)[:, None]))[None])


def _say(fit: Fit, column: EffectColumn, size: float) -> Words:
    what = f"the torque constant of '{column.joint}' {'falling' if size > 0 else 'rising'} with its current"
    return what, (
        "check that the log holds the actual current, and add runs with another payload or slower motions; friction "
        "that grows with the load has the same effect"
    )


UNIT = f"relative, at {LARGE:g} times the rms current"
EFFECT = Effect("saturation", _torques, lambda fit: [EffectColumn(PLAUSIBLE, UNIT, least=0.0)], _say)
