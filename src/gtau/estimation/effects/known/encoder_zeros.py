"""A constant error of a joint's position."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gtau.estimation.effects.effect import STEP, Effect, EffectColumn, FitWindow, Torques, Words, encoders, geared
from gtau.estimation.estimators.estimator import Fit

PLAUSIBLE = 0.5  # degrees or mm: experience; xMate7 Pro: joint 2 +1.05 +- 0.15 deg against its file
LARGEST = {"deg": 12.0, "mm": 100.0}  # a Sawyer's zero off by 5.73 degrees is found as 5.44 +- 0.27
SI = {"deg": np.pi / 180, "mm": 1e-3}


def _torques(at: FitWindow) -> Torques:
    window, joints = at.window, np.eye(len(at.fit.dataset.model.actuated))
    steps = [STEP * SI[_unit(at.fit, joint)] * joints[place] for joint, place in encoders(at.fit).items()]
    return at.with_positions(((window.q + step, window.qd, window.qdd) for step in steps), at.smooth)


def _unit(fit: Fit, joint: str) -> str:
    return "deg" if fit.dataset.robot.joint(joint).turns else "mm"


def _columns(fit: Fit) -> Iterator[EffectColumn]:
    gears = geared(fit)
    for joint in encoders(fit):
        (ratio, moved), unit = gears[joint], _unit(fit, joint)
        gear = SI[_unit(fit, moved)] / (SI[unit] * ratio)
        yield EffectColumn(PLAUSIBLE * gear, unit, joint, largest=LARGEST[_unit(fit, moved)] * gear)


def _say(fit: Fit, column: EffectColumn, size: float) -> Words:
    what = f"an error in the zero of encoder '{column.joint}'"
    return what, "compare the encoder with the robot's zero position (the size is what its positions lack)"


EFFECT = Effect("encoder zeros", _torques, _columns, _say, shared=True, description=True, of_motion=True)
