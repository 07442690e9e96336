"""Errors of measured wrenches: an offset of a sensor that was not tared, and the point about which a moment is stated.

An offset is constant along the sensor's own axes. A point of application is a lever, ``m = m_at + at x f``, so that one
which is off adds a moment proportional to the force.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gtau.estimation.effects.effect import Effect, EffectColumn, FitWindow, Torques, Words
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.rows import external_torques
from gtau.robots.placement import WRENCH

OFFSET = 0.01  # of the rms force or moment: 0.1 to 1 % of the range of a tared six-axis sensor; 17 % not tared
POINT = 2.0  # mm: experience; 20 for a plate or flange
MILLIMETRE = 1e-3


def _bodies(fit: Fit) -> list[str]:
    return [frame.body for frame in fit.dataset.runs[0].wrenches]


def _offsets(at: FitWindow) -> Torques:
    unit = np.eye(len(WRENCH) * len(_bodies(at.fit)))
    return _felt(at, np.broadcast_to(unit[:, :, None], (*unit.shape, len(at.window))))


def _offset_columns(fit: Fit) -> Iterator[EffectColumn]:
    if not (bodies := _bodies(fit)):
        return
    squares = [np.mean(run.command[:, run.given] ** 2, axis=0) for run in fit.dataset.runs]
    levels = np.sqrt(np.mean(squares, axis=0).reshape(-1, 2, 3).sum(axis=2))
    for body, body_levels in zip(bodies, levels, strict=True):
        for quantity, unit, level in zip(("moment", "force"), ("N m", "N"), body_levels, strict=True):
            yield from (
                EffectColumn(float(OFFSET * level), unit, subject=body, about=f"{quantity} {axis}") for axis in "xyz"
            )


def _say_offset(fit: Fit, column: EffectColumn, size: float) -> Words:
    what = f"an offset in the {column.about} of the wrench on '{column.subject}'"
    return what, "tare the unloaded force sensor before each run, or subtract its unloaded reading"


def _points(at: FitWindow) -> Torques:
    bodies = np.arange(len(_bodies(at.fit)))
    measured = at.window.samples().command.T[at.window.run.given]
    force = measured.reshape(len(bodies), 2, 1, 3, -1)[:, 1]  # that acts 1 mm further back
    errors = np.zeros((len(bodies), 3, len(bodies), 6, measured.shape[1]))
    errors[bodies, :, bodies, :3] = -MILLIMETRE * np.cross(np.eye(3)[:, :, None], force, axis=-2)
    return _felt(at, errors.reshape(3 * len(bodies), *measured.shape))


def _point_columns(fit: Fit) -> list[EffectColumn]:
    return [EffectColumn(POINT, "mm", subject=body, about=axis) for body in _bodies(fit) for axis in "xyz"]


def _say_point(fit: Fit, column: EffectColumn, size: float) -> Words:
    what = f"the reference point of the moment on '{column.subject}', off in {column.about}"
    return what, "measure the position of the sensor, and correct 'at' of that wrench"


def _felt(at: FitWindow, errors: np.ndarray) -> Torques:
    """Compute the joint torques that errors (m, 6 k, N) of the wrench readings cause."""
    run = at.window.run
    padded = np.zeros((len(errors), len(run.channels), errors.shape[-1]))
    padded[:, run.given] = errors
    return at.decimated(external_torques(at.fit.dataset.model, run, at.motion, padded))


WRENCH_OFFSETS = Effect("wrench offsets", _offsets, _offset_columns, _say_offset, shared=True, description=True)
WRENCH_POINTS = Effect("wrench points", _points, _point_columns, _say_point, shared=True, description=True)
EFFECTS = WRENCH_OFFSETS, WRENCH_POINTS
WRENCH_ERRORS = frozenset(effect.name for effect in EFFECTS)
