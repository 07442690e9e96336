"""Another scale of a joint's positions, with velocity and acceleration, as of a wrong gear ratio."""

from __future__ import annotations

import numpy as np

from gtau.estimation.effects.effect import STEP, Effect, EffectColumn, FitWindow, Torques, Words, encoders
from gtau.estimation.estimators.estimator import Fit

PLAUSIBLE = 1.0  # per cent: 5 widened the intervals of an AIRBOT Play, whose positions are noisy, by 60 %
LARGEST = 15.0  # per cent: positions of a Sawyer's joint 10 % large are found as 8.8 +- 0.44
PER_CENT = 1e-2


def _torques(at: FitWindow) -> Torques:
    window, joints = at.window, np.eye(len(at.fit.dataset.model.actuated))
    factors = 1 + STEP * PER_CENT * joints[list(encoders(at.fit).values())]
    motions = ((window.q * factor, window.qd * factor, window.qdd * factor) for factor in factors)
    return at.with_positions(motions, at.smooth)


def _columns(fit: Fit) -> list[EffectColumn]:
    return [EffectColumn(PLAUSIBLE, "%", joint, largest=LARGEST) for joint in encoders(fit)]


def _say(fit: Fit, column: EffectColumn, size: float) -> Words:
    what = f"another scale of the positions of '{column.joint}'"
    return what, "check the gear ratio, encoder resolution and unit of its positions (the size is what they lack)"


EFFECT = Effect("position scales", _torques, _columns, _say, shared=True, description=True, of_motion=True)
