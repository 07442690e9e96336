"""A drive gain of its own in each run, which drifts from run to run as the motor's magnets warm up.

A payload is weighed by how loaded and unloaded runs differ, so a motor that got warmer, by 2 per cent of its torque
constant, can move the gain by 5. All that the payload does not add to is the same in all runs, and shows it.
"""

from __future__ import annotations

from gtau.estimation.effects.effect import Effect, EffectColumn, FitWindow, Torques, Words
from gtau.estimation.estimators.estimator import Fit

PLAUSIBLE = 0.01  # relative change between runs: 0.001 a kelvin of the magnets (data sheets of servo motors)
LARGEST = 0.04  # beyond it no magnet is that warm: neodymium loses 0.1 % a kelvin, and motors warm up by 40 K


def _torques(at: FitWindow) -> Torques:
    return lambda rows: at.torques(rows)[:, :, None]


def _columns(fit: Fit) -> list[EffectColumn]:
    return [EffectColumn(PLAUSIBLE)] if fit.free_gains and len(fit.dataset.runs) > 1 else []


def _say(fit: Fit, column: EffectColumn, size: float) -> Words:
    what = f"a {fit.kind} of '{column.joint}' that is {'larger' if size > 0 else 'smaller'} in run '{column.about}'"
    loads = "check which runs carry the payload, its mass and the clock; otherwise " if fit.system.payloads else ""
    return what, (
        f"{loads}let the robot warm up, and alternate loaded and unloaded runs: a motor's torque constant falls as it "
        "warms up"
    )


EFFECT = Effect("gain of a run", _torques, _columns, _say, in_runs=True, harmless=LARGEST)
