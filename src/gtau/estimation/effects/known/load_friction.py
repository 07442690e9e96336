"""Friction that grows with a joint's load.

The load is the model's, without friction, as in the term ``fl``: the measured current is the friction itself where
friction exceeds the load, so it would explain the noise of the current and any drive gain. A second column takes the
rotor out of the load, as the gear does not transmit its torque.
"""

from __future__ import annotations

import numpy as np

from gtau.estimation.effects.effect import (
    Effect,
    EffectColumn,
    FitWindow,
    Torques,
    Words,
    rms_torques,
)
from gtau.estimation.estimators.estimator import Fit
from gtau.robots.parameter import Parameter

PLAUSIBLE = 0.05  # friction coefficient of the load: 0.02 to 0.1 in strain-wave gears (UR10e pairs)
ROTOR = 0.01  # of the rms torque: a fifth of it may speed up the rotor, and PLAUSIBLE of that


def _torques(at: FitWindow) -> Torques:
    joints, terms, qd = at.fit.dataset.model.actuated, at.fit.system.terms, at.window.samples().qd
    missing = np.array([Parameter("fl", joint) not in terms for joint in joints])
    load = at.torques_along(at.motion, at.transmitted).T
    qdd, torques = at.window.samples().qdd, rms_torques(at.fit)
    turned = np.sign(load) * np.sign(qd) * qdd * torques / at.fit.dataset.rms_accelerations
    return at.decimated(np.stack([(np.abs(load) * np.sign(qd) * missing).T, turned.T]))


def _say(fit: Fit, column: EffectColumn, size: float) -> Words:
    what = f"load-dependent friction of '{column.joint}'"
    return what, "add runs at other speeds, or with other loads, to separate it from other effects"


COLUMNS = [EffectColumn(PLAUSIBLE, "of its load"), EffectColumn(ROTOR, "of its torque")]
EFFECT = Effect("load-dependent friction", _torques, lambda fit: COLUMNS, _say)
