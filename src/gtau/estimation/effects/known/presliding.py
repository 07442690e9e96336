"""Friction after a reversal, while contacts bend.

Stop operators of several widths take the place of the sign of the speed, as friction of any width is nearly their sum.
"""

from __future__ import annotations

import numpy as np

from gtau.estimation.effects.effect import Effect, EffectColumn, FitWindow, Torques, Words, friction_torques
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.rows import stop

PLAUSIBLE = 0.1  # of the friction at the rms speed: experience; 0.3 moves gains by 0.2 standard deviations at most
# Of the joint's range in the logs. Without the shortest, presliding over 1.5 mrad leaves a delay of -0.57 ms instead of
# -0.13 (true 0), and the gain is as right.
LENGTHS = (0.001, 0.003, 0.01, 0.03, 0.1)


def _torques(at: FitWindow) -> Torques:
    low, high = at.fit.dataset.travels
    whole, first = at.window.part_of or (at.window, 0)  # which knows the reversals before the window
    lengths = np.outer(np.where(high > low, high - low, 1.0), LENGTHS)
    states = [stop(q, widths, np.sign(qd[:1])) for q, qd, widths in zip(whole.q.T, whole.qd.T, lengths, strict=True)]
    missing = np.stack(states, axis=1)[..., first : first + len(at.window)] - np.sign(at.window.qd.T)
    return at.decimated(missing * friction_torques(at.fit)[:, None])


def _say(fit: Fit, column: EffectColumn, size: float) -> Words:
    what = f"friction of '{column.joint}' that follows its reversals over some travel (presliding, hysteresis)"
    return what, "use motions with fewer reversals, or larger ones"


COLUMNS = [EffectColumn(PLAUSIBLE, "of its torque")] * len(LENGTHS)
EFFECT = Effect("presliding", _torques, lambda fit: COLUMNS, _say, function=True)
