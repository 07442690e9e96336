"""A log on a uniform grid, what is missing interpolated and marked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gtau.errors import GtauError
from gtau.signals.clock import Clock
from gtau.signals.samples import MAX_MISSING, Samples, counted
from gtau.signals.storage import Store, block, spans, store

MAX_GAP = 0.1  # s; longer ones cannot be bridged without inventing a motion
MISSING_STEP = 1.5  # steps longer than so many mean steps have lost a sample
LANDMARK = 4096  # samples from one that is known by its place in the log to the next
SURROUNDINGS = 64  # samples to either side that a spline is made from: what lies beyond acts by less than 1e-19


@dataclass(frozen=True)
class UniformSamples:
    """Samples on a uniform grid; where ``valid`` (N, n) is false they were interpolated or clipped."""

    time: np.ndarray
    position: np.ndarray
    command: np.ndarray
    valid: np.ndarray
    notes: tuple[str, ...]
    findings: Findings


@dataclass(frozen=True, eq=False)
class Findings:
    """What was found in the whole of a log, and any part of it depends on.

    Attributes
    ----------
    clock : Clock
        Of its samples.
    clipped : tuple
        Joints' numbers with the levels at which their commands are clipped.
    wraps : ndarray
        (n,) whether a joint's angle jumped by turns.
    rows, instants, position : ndarray
        Of one complete sample in ``LANDMARK``: its row (K,) in the log, instant (K,) in s, and position (K, n) without
        jumps.
    last : int
        Row of the last sample.
    """

    clock: Clock
    clipped: tuple[tuple[int, float], ...]
    wraps: np.ndarray
    rows: np.ndarray
    instants: np.ndarray
    position: np.ndarray
    last: int


def uniform(
    samples: Samples, wraps: np.ndarray, clipped: Sequence[tuple[int, float]], clock: Clock, notes: list[str]
) -> UniformSamples:
    """The samples at the instants of their ``clock``, the joints' ``clipped`` levels masked.

    Raises
    ------
    GtauError
        A gap is longer than 0.1 s and three steps, or more than 5 % of the samples are missing.
    """
    source, period = samples.source, clock.period
    if clock.longest > max(MAX_GAP, 3 * period):
        raise GtauError(
            f"{source.name}, {samples.place(clock.before_longest)}: {clock.longest:.3g} s are missing after "
            f"{samples.time[clock.before_longest]:.9g} s; cut the log there into two runs."
        )
    count = clock.count
    time = store(clock.time(*span) for span in spans(count))
    instants = clock.instants(samples.time)
    findings = Findings(
        clock=clock,
        clipped=tuple(clipped),
        wraps=wraps,
        rows=_landmarks(samples.rows),
        instants=_landmarks(instants),
        position=_landmarks(samples.position),
        last=int(samples.rows[-1]),
    )
    n = len(source.joints)
    if clock.gapless:
        valid = store((unclipped(block(samples.command, *span), clipped) for span in spans(count)), (n,), bool)
        return UniformSamples(time, samples.position, samples.command, valid, tuple(notes), findings)
    positions, commands, masks, missing = Store((n,)), Store((n,)), Store((n,), bool), 0
    for span in spans(count):
        position, command, valid, lacking = resampled(samples, instants, clipped, clock, *span)
        positions.append(position)
        commands.append(command)
        masks.append(valid)
        missing += lacking
    if missing > MAX_MISSING * count:
        raise GtauError(
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
    return UniformSamples(time, positions.array(), commands.array(), masks.array(), tuple(notes), findings)


def _landmarks(array: np.ndarray) -> np.ndarray:
    return np.concatenate([block(array, k, k + 1) for k in range(0, len(array), LANDMARK)])


def resampled(
    samples: Samples, instants: np.ndarray, clipped: Sequence[tuple[int, float]], clock: Clock, start: int, stop: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Positions and commands (M, n) at some of the clock's samples, what is valid, and how many were missing.

    They are interpolated between samples at ``instants``, of which there must be some before and after.
    """
    from scipy.interpolate import CubicSpline

    grid = clock.time(start, stop)
    begin, end = np.searchsorted(instants, grid[[0, -1]], side="right")
    begin, end = max(0, begin - SURROUNDINGS), end + SURROUNDINGS
    known, command = block(instants, begin, end), block(samples.command, begin, end)
    position = CubicSpline(known, block(samples.position, begin, end))(grid)
    step = np.diff(known)
    before = np.clip(np.searchsorted(known, grid, side="right") - 1, 0, len(step) - 1)
    near = np.minimum(np.abs(grid - known[before]), np.abs(known[before + 1] - grid)) < 0.01 * clock.period
    there = near | (step[before] <= MISSING_STEP * clock.period)
    good = unclipped(command, clipped)
    # Lines for the commands: a spline would overshoot where the current is noisy.
    command = np.column_stack([np.interp(grid, known, each) for each in command.T])
    return position, command, there[:, None] & good[before] & good[before + 1], int((~there).sum())


def unclipped(command: np.ndarray, clipped: Sequence[tuple[int, float]]) -> np.ndarray:
    """Where commands (M, n) do not stand at a level at which they are clipped."""
    good = np.ones(command.shape, dtype=bool)
    for j, level in clipped:
        good[:, j] &= command[:, j] != level
    return good
