"""Elastic joints: the motor, whose position is logged, leads its link by the torque over the stiffness.

The deflection of a joint moves the links behind it, so it changes the torques of all joints.
"""

from __future__ import annotations

import numpy as np

from gtau.estimation.effects.effect import STEP, Effect, EffectColumn, FitWindow, Levels, Torques, Words
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.assembly import is_transmitted
from gtau.signals.preparation.filters import differentiate

PLAUSIBLE = 1.0  # mrad, or mm, at the rms torque: 50 N m on a strain-wave gear of 2e4 N m/rad are 2.5 mrad
SI = 1e-3


def _torques(at: FitWindow) -> Torques:
    window, motors = at.window, at.fit.dataset.robot.motors
    joints = np.eye(len(at.fit.gains))[[joint in motors for joint in at.fit.dataset.model.actuated]]
    transmitted = at.values * is_transmitted(at.fit.dataset.base.names)
    leads = at.torques_along(at.motion, transmitted).T * SI / Levels(at.fit).torques
    rates, changes = differentiate(leads, window.run.rate)
    motions, steps = (window.q, window.qd, window.qdd), (leads, rates, changes)
    deflected = (
        tuple(motion - STEP * step * joint for motion, step in zip(motions, steps, strict=True)) for joint in joints
    )
    return at.with_positions(deflected)


def _columns(fit: Fit) -> list[EffectColumn]:
    motors = (joint for joint in fit.dataset.model.actuated if joint in fit.dataset.robot.motors)
    return [EffectColumn(PLAUSIBLE, "mrad or mm at its rms torque", joint) for joint in motors]


def _say(fit: Fit, column: EffectColumn, size: float) -> Words:
    return f"an elastic joint '{column.joint}'", "move more slowly, or log the position behind the gear"


EFFECT = Effect("elasticity", _torques, _columns, _say, shared=True)
