"""A torque constant that changes along the runs."""

from __future__ import annotations

from gtau.estimation.effects.effect import Effect, EffectColumn, FitWindow, Torques, Words
from gtau.estimation.estimators.estimator import Fit

PLAUSIBLE = 0.005  # relative change along a run: 0.001 a kelvin of the magnets (data sheets of servo motors)
LARGEST = 0.04  # as of a run


def _torques(at: FitWindow) -> Torques:
    return lambda rows: (at.torques(rows) * at.along_run(rows.time))[:, :, None]


def _say(fit: Fit, column: EffectColumn, size: float) -> Words:
    what = f"the torque constant of '{column.joint}' {'falling' if size > 0 else 'rising'} along the runs"
    return what, "let the robot warm up before the runs"


EFFECT = Effect("gain drift", _torques, lambda fit: [EffectColumn(PLAUSIBLE)], _say, harmless=LARGEST)
