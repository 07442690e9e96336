"""Friction of any shape in speed: Stribeck's, cubic, or different by direction.

Each joint may have any function of its own speed, piecewise linear in ``atan(2 qd / rms qd)``: fine near rest.
"""

from __future__ import annotations

import numpy as np

from gtau.estimation.effects.effect import (
    Effect,
    EffectColumn,
    FitWindow,
    Torques,
    Words,
    friction_torques,
    hats,
    rms_speeds,
)
from gtau.estimation.estimators.estimator import Fit

PLAUSIBLE = 0.1  # of the friction at the rms speed: experience
KNOTS = 20


def _torques(at: FitWindow) -> Torques:
    bent, n = np.arctan(2 * at.window.samples().qd / rms_speeds(at.fit)) / (np.pi / 2), len(at.fit.gains)
    columns = hats(bent, np.repeat(np.linspace(-1, 1, KNOTS)[:, None], n, axis=1))
    return at.decimated(columns * friction_torques(at.fit)[:, None])


def _say(fit: Fit, column: EffectColumn, size: float) -> Words:
    what = f"friction of '{column.joint}' that is not viscous and Coulomb friction alone"
    return what, "add runs at other speeds to separate it from other effects"


COLUMNS = [EffectColumn(PLAUSIBLE, "of its torque")] * KNOTS
EFFECT = Effect("friction of any shape", _torques, lambda fit: COLUMNS, _say, function=True)
