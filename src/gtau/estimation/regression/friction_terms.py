"""Formulas of the friction terms: the columns of their parameters in the equations, and the law that predicts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from gtau.robots.parameter import KINDS, TERMS


class Sliding(NamedTuple):
    """State of a joint, numbers, arrays or expressions, on which its friction depends.

    ``speed`` in rad/s or m/s; ``direction`` is the sign of the speed, or the state of presliding; ``load`` the size of
    the torque that the joint transmits, N m or N; ``falling`` is ``exp(-|speed| / v_s)``, 0 without a v_s; ``above``
    the temperature above the mean.
    """

    speed: Any
    direction: Any
    load: Any = 0.0
    falling: Any = 0.0
    above: Any = 0.0


FORMULAS: Mapping[str, Callable[[Sliding], Any]] = {
    "fv": lambda at: at.speed,
    "fs": lambda at: at.direction,
    "fb": lambda at: at.falling * at.direction,
    "fl": lambda at: at.load * at.direction,
    "f3": lambda at: at.speed * at.speed * at.speed,  # a power would take ten times as long
}
"""Friction of a joint per unit of each parameter."""
SLOPES: Mapping[str, Callable[[float], float]] = {"f3": lambda speed: 3 * speed**2}
"""Derivatives by the speed of the terms of actuated joints that are extrapolated beyond the logged speeds."""


def column(kind: str, at: Sliding) -> Any:
    """Evaluate the column of a kind of friction; the column of a temperature slope is its kind's times ``above``."""
    if slope_of := KINDS[kind].slope_of:
        return at.above * FORMULAS[slope_of](at)
    return FORMULAS[kind](at)


def term_columns(speed: np.ndarray, effort: np.ndarray) -> np.ndarray:
    """Evaluate the columns (terms, n, N) of ``TERMS`` for joints that slide under the torques ``effort`` (n, N)."""
    at = Sliding(speed, np.sign(speed), np.abs(effort))
    return np.stack([FORMULAS[kind](at) for kind in TERMS])
