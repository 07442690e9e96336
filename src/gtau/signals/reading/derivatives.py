"""Derivatives among the columns of a log: velocities of any unit, and columns without names."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gtau.errors import GtauError
from gtau.signals.reading.column_names import Group
from gtau.signals.reading.formats import LogTable

DERIVATIVE = 0.9  # correlation with a numerical derivative from which a column is taken for the velocity
ADDED = 50  # samples over which velocities are integrated
WRAPS = 5.0  # steps that 95 % stay below; a larger one by a turn is a wrap (300 to 1000 of a Gen3), not a motion in deg


def rate_of_derivative(position: np.ndarray, velocity: np.ndarray) -> float | None:
    """Find the rate, Hz, at which the integrated velocities match the positions; None where none does.

    Over some samples, as from one to the next a position moves little more than its noise, which makes the rate small:
    of 240 logs simulated at 97 Hz with noise of up to a step, central differences found 56 to 97 Hz, this 96.8 to 97.3.
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


def unnamed_groups(
    table: LogTable, values: Mapping[str, np.ndarray], time: tuple[str, ...], joints: int
) -> tuple[tuple[Group, ...], str]:
    """Group columns without names, velocities being derivatives of the columns n to their left; say which they are."""
    stamps = values[time[0]] if time else None
    names, rest = table.columns, table.columns[len(time) :]
    widths = [joints] if joints else range(1, min(len(rest) // 2, 12) + 1)
    scores = {
        n: float(np.median([correlation(values[rest[k]], values[rest[n + k]], stamps) for k in range(n)]))
        for n in widths
        if 2 * n <= len(rest)
    }
    if len(names) == 1:
        raise GtauError(
            f"{table.path} holds a single column without a header; put time, positions and currents of a run side by "
            "side in one file, with names in its first line (t,q1,q2,current1,current2)."
        )
    width = max(scores, key=scores.__getitem__, default=0)
    if scores.get(width, 0.0) <= DERIVATIVE:
        lacks, advice = "has no header", "write a first line with names (t,q1,q2,current1,current2)"
        if not table.numbered:
            lacks, advice = "is one array without names", "save arrays with names (t, q, current) in its place"
        raise GtauError(
            f"{table.path} {lacks}, and among its {len(names)} columns no positions are recognised by their "
            f"velocities; {advice}{'' if joints else ', or give the robot (--robot ROBOT)'}."
        )
    kinds = ["position", "velocity"]
    blocks = [rest[k : k + width] for k in range(0, len(rest) - len(rest) % width, width)]
    for block in blocks[2:]:
        still = any(not np.ptp(values[name]) for name in block)
        slopes = [correlation(values[qd], values[column], stamps) for qd, column in zip(blocks[1], block, strict=True)]
        kinds.append("other" if still else "acceleration" if np.median(slopes) > DERIVATIVE else "command")
    groups = [
        Group(kind, f"block {k + 1}", {str(i + 1): name for i, name in enumerate(block)})
        for k, (kind, block) in enumerate(zip(kinds, blocks, strict=True))
    ]
    return tuple(groups), f"columns {groups[1].listed} are the velocities (correlation {scores[width]:.3f})"
