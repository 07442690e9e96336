"""Lengths of the robot file that differ from the robot's, those that are equal there together."""

from __future__ import annotations

import numpy as np

from gtau.estimation.effects.effect import STEP, Effect, EffectColumn, FitWindow, Torques, Words
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.assembly import known_values
from gtau.robots.geometry import characteristic_length
from gtau.robots.parameter import Parameter

PLAUSIBLE = 1.5e-3  # of the characteristic length: 0.5 mm of a UR10e
LARGEST = 0.05  # of the characteristic length: torques are linear in smaller changes
MILLIMETRE = 1e-3


def _torques(at: FitWindow) -> Torques:
    along, values = at.fit.dataset.variable, _values(at)
    changes = STEP * MILLIMETRE * np.eye(len(along.constants), len(along.constants))
    moved = [along(at.motion, values, change) for change in (*changes, 0 * changes.sum(axis=0))]
    return at.decimated((np.array(moved[:-1]) - moved[-1]) / STEP)


def _values(at: FitWindow) -> np.ndarray:
    """Return values of the parameters: known ones of a payload as such, as base parameters regroup them by lengths."""
    dataset = at.fit.dataset
    values = dict.fromkeys(dataset.variable.names, 0.0) | dict(zip(dataset.base.standard, at.smooth, strict=True))
    for payload in at.fit.system.payloads:
        for kind, value in known_values(payload.payload).items() if payload.run == at.run else ():
            name = Parameter(kind, dataset.robot.tool)
            regrouped = dataset.base.matrix[:, dataset.model.parameter_names.index(name)]
            for standard, factor in zip(dataset.base.standard, regrouped, strict=True):
                values[standard] -= factor * value
            values[name] += value
    return np.array(list(values.values()))


def _columns(fit: Fit) -> list[EffectColumn]:
    length = characteristic_length(fit.dataset.robot) / MILLIMETRE
    return [
        EffectColumn(PLAUSIBLE * length, "mm", about=constant.name, largest=LARGEST * length)
        for constant in fit.dataset.variable.constants
    ]


def _say(fit: Fit, column: EffectColumn, size: float) -> Words:
    longer = "longer" if size > 0 else "shorter"
    what = f"a length ({column.about}) that is {longer} than in the robot file"
    return what, f"measure this length ({column.about}) between the joints' axes, and correct the robot file"


EFFECT = Effect("lengths", _torques, _columns, _say, shared=True, description=True)
