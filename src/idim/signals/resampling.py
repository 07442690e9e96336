"""A log on a uniform grid, what is missing interpolated and marked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from idim.errors import IdimError
from idim.signals.clock import Clock
from idim.signals.samples import MAX_MISSING, Samples, counted
from idim.signals.storage import Store, block, spans, store

MAX_GAP = 0.1  # s; longer ones cannot be bridged without inventing a motion
MISSING_STEP = 1.5  # steps longer than so many mean steps have lost a sample
SURROUNDINGS = 64  # samples to either side that a spline is made from: what lies beyond acts by less than 1e-19


@dataclass(frozen=True)
class UniformSamples:
    """Samples on a uniform grid; where ``valid`` (N, n) is false they were interpolated or clipped."""

    time: np.ndarray
    position: np.ndarray
    command: np.ndarray
    valid: np.ndarray
    notes: tuple[str, ...]


def uniform(samples: Samples, clipped: list[tuple[int, float]], clock: Clock, notes: list[str]) -> UniformSamples:
    """The samples at the instants of their ``clock``, the joints' ``clipped`` levels masked.

    Raises
    ------
    IdimError
        A gap is longer than 0.1 s and three steps, or more than 5 % of the samples are missing.
    """
    source, period = samples.source, clock.period
    if clock.longest > max(MAX_GAP, 3 * period):
        raise IdimError(
            f"{source.name}, {samples.place(clock.before_longest)}: {clock.longest:.3g} s are missing after "
            f"{samples.time[clock.before_longest]:.9g} s; cut the log there into two runs."
        )
    count = clock.count
    time = store(clock.start + period * np.arange(*span) for span in spans(count))

    def good(command: np.ndarray) -> np.ndarray:
        unclipped = np.ones(command.shape, dtype=bool)
        for j, level in clipped:
            unclipped[:, j] &= command[:, j] != level
        return unclipped

    n = len(source.joints)
    if clock.regular and count == len(samples.time):
        valid = store((good(block(samples.command, *span)) for span in spans(count)), (n,), bool)
        return UniformSamples(time, samples.position, samples.command, valid, tuple(notes))

    from scipy.interpolate import CubicSpline

    positions, commands, masks, missing = Store((n,)), Store((n,)), Store((n,), bool), 0
    for span in spans(count):
        grid = block(time, *span)
        begin, end = np.searchsorted(clock.instants, grid[[0, -1]], side="right")
        begin, end = max(0, begin - SURROUNDINGS), end + SURROUNDINGS
        known, command = block(clock.instants, begin, end), block(samples.command, begin, end)
        # Lines for the commands: a spline would overshoot where the current is noisy.
        positions.append(CubicSpline(known, block(samples.position, begin, end))(grid))
        commands.append(np.column_stack([np.interp(grid, known, each) for each in command.T]))
        step = np.diff(known)
        before = np.clip(np.searchsorted(known, grid, side="right") - 1, 0, len(step) - 1)
        near = np.minimum(np.abs(grid - known[before]), np.abs(known[before + 1] - grid)) < 0.01 * period
        there = near | (step[before] <= MISSING_STEP * period)
        unclipped = good(command)
        masks.append(there[:, None] & unclipped[before] & unclipped[before + 1])
        missing += int((~there).sum())
    if missing > MAX_MISSING * count:
        raise IdimError(
            f"{source.name} lacks {missing} of {count} samples (steps of {clock.shortest * 1e3:.3g} to "
            f"{clock.longest * 1e3:.3g} ms); record it at a steady rate."
        )
    if missing:
        notes.append(f"interpolated and masked {counted(missing, 'missing sample')}")
    if not clock.regular:
        notes.append(
            f"resampled from irregular steps of {clock.shortest * 1e3:.3g} to {clock.longest * 1e3:.3g} ms "
            f"to a uniform {clock.rate:.2f} Hz"
        )
    return UniformSamples(time, positions.array(), commands.array(), masks.array(), tuple(notes))
