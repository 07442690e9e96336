"""Another offset of the current in each run.

Where a joint feels a nearly constant weight of the payload, such as a vertical axis, an offset looks the same.
"""

from __future__ import annotations

import numpy as np

from gtau.estimation.effects.effect import Effect, EffectColumn, FitWindow, Torques, Words, rms_torques
from gtau.estimation.estimators.estimator import Fit

PLAUSIBLE = 0.01  # of the rms torque


def _torques(at: FitWindow) -> Torques:
    return lambda rows: np.broadcast_to(rms_torques(at.fit)[:, None, None], (len(at.fit.gains), len(rows.time), 1))


def _columns(fit: Fit) -> list[EffectColumn]:
    return [EffectColumn(PLAUSIBLE, "of its torque")] if len(fit.dataset.runs) > 1 else []


def _say(fit: Fit, column: EffectColumn, size: float) -> Words:
    what = f"an offset of '{column.joint}' that is {'larger' if size > 0 else 'smaller'} in run '{column.about}'"
    advice = "zero the current sensors before the runs, let the drives warm up, and alternate loaded and unloaded runs"
    return what, advice


EFFECT = Effect("offset of a run", _torques, _columns, _say, in_runs=True)
