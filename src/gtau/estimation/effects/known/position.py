"""A torque that repeats at the same positions: cables, springs, slow ripple.

Each joint may have any function of its own position, piecewise linear over its range in all runs.
"""

from __future__ import annotations

import numpy as np

from gtau.estimation.effects.effect import Effect, EffectColumn, FitWindow, Torques, Words, hats, rms_torques
from gtau.estimation.estimators.estimator import Fit

PLAUSIBLE = 0.01  # of the rms torque: ripple of 0.5 to 2 % (data sheets of servo motors), cables of a dVRK 5 %
KNOTS = 24


def _torques(at: FitWindow) -> Torques:
    columns = hats(at.window.samples().q, np.linspace(*at.fit.dataset.travels, KNOTS))
    return at.decimated(columns * rms_torques(at.fit)[:, None])


def _say(fit: Fit, column: EffectColumn, size: float) -> Words:
    what = f"a torque of '{column.joint}' that repeats at the same positions (cables, a spring or slow ripple)"
    return what, (
        "use other paths in the loaded and unloaded runs; describe a spring or balancer in the robot file "
        "('stiffness: true' of the joint, or a spring between two points)"
    )


COLUMNS = [EffectColumn(PLAUSIBLE, "of its torque")] * KNOTS
EFFECT = Effect("torque of position", _torques, lambda fit: COLUMNS, _say, function=True)
