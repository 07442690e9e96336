"""A log on a uniform grid, what is missing interpolated and marked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gtau.errors import GtauError
from gtau.signals.clock import Clock
from gtau.signals.held import Holds
from gtau.signals.notes import Kind, Note
from gtau.signals.samples import MAX_MISSING, Samples, counted
from gtau.signals.storage import Store, block, spans, store

MAX_GAP = 0.1  # s; longer ones cannot be bridged without inventing a motion
MISSING_STEP = 1.5  # steps longer than so many mean steps have lost a sample
# Steps over which positions are interpolated without a mask: the cubic is then off by 3 % of an oscillation of ten
# samples, the fastest that logs should hold, and by 4e-4 of one of thirty.
BRIDGED = 3
MAX_BRIDGED = 0.3  # part of a log that may be missing in such steps
SURROUNDINGS = 64  # samples to either side that a spline is made from: what lies beyond acts by less than 1e-19


@dataclass(frozen=True)
class UniformSamples:
    """Samples on a uniform grid; where ``valid`` (N, c) is false a command's were interpolated or clipped."""

    time: np.ndarray
    position: np.ndarray
    command: np.ndarray
    valid: np.ndarray
    notes: tuple[Note, ...]


@dataclass(frozen=True)
class Resampling:
    """How a log is put on a uniform grid.

    The ``clock`` of its samples, columns of the commands with the levels at which they are ``clipped``, how positions
    and commands are held, and by how much commands lag (``delay``, s).
    """

    clock: Clock
    clipped: tuple[tuple[int, float], ...]
    holds: Holds
    delay: float = 0.0

    @property
    def direct(self) -> bool:
        """Whether the samples stand on the grid already."""
        return self.clock.gapless and self.holds.none and not self.delay


def uniform(samples: Samples, instants: np.ndarray, grid: Resampling, given: bool, notes: list[Note]) -> UniformSamples:
    """Put samples taken at their ``instants`` onto a uniform ``grid``; of a clock that was ``given`` or found.

    Raises
    ------
    GtauError
        A gap is longer than 0.1 s and three steps, or too many samples are missing.
    """
    source, clock, period = samples.source, grid.clock, grid.clock.period
    if clock.longest > max(MAX_GAP, 3 * period):
        raise GtauError(
            f"{source.name}, {samples.place(clock.before_longest)}: {clock.longest:.3g} s are missing after "
            f"{samples.time[clock.before_longest]:.9g} s; cut the log there into two runs (from: and to:)."
        )
    count = clock.count
    time = store(clock.time(*span) for span in spans(count))
    n, c = len(source.joints), samples.command.shape[1]
    if grid.direct:
        valid = store((unclipped(block(samples.command, *span), grid.clipped) for span in spans(count)), (c,), bool)
        notes += _of_clock(clock, given)
        return UniformSamples(time, samples.position, samples.command, valid, tuple(notes))
    positions, commands, masks = Store((n,)), Store((c,)), Store((c,), bool)
    missing, masked = 0, 0
    for span in spans(count):
        position, command, valid, lacking = resampled(samples, instants, grid, *span)
        positions.append(position)
        commands.append(command)
        masks.append(valid)
        missing, masked = missing + lacking[0], masked + lacking[1]
    if masked > MAX_MISSING * count or missing > MAX_BRIDGED * count:
        raise GtauError(
            f"{source.name} lacks {missing} of {count} samples (steps of {clock.shortest * 1e3:.3g} to "
            f"{clock.longest * 1e3:.3g} ms); record it at a steady rate."
        )
    if missing:
        what = f"interpolated {counted(missing, 'missing sample')}"
        what += f", and masked {masked} of them in gaps of more than {BRIDGED} samples" if masked else ""
        notes.append(Note(Kind.REPAIR, what, "log every cycle of the controller", share=missing / count))
    notes += _of_clock(clock, given)
    notes += grid.holds.notes(count, clock.rate)
    if grid.delay:
        what = f"moved the commands {grid.delay * 1e3:.4g} ms forward, as preparation.delay says"
        notes.append(Note(Kind.READING, what))
    return UniformSamples(time, positions.array(), commands.array(), masks.array(), tuple(notes))


def _of_clock(clock: Clock, given: bool) -> list[Note]:
    """List what to report of a clock that is not simply the time column."""
    why = "as preparation.clock says" if given else "which makes the positions smoother"
    if not clock.regular:
        if not given:
            why = "the time stamps are trusted, as a regular clock makes the positions no smoother"
        what = (
            f"resampled from irregular steps of {clock.shortest * 1e3:.3g} to {clock.longest * 1e3:.3g} ms "
            f"to a uniform {clock.rate:.2f} Hz: {why}"
        )
        return [Note(Kind.READING, what)]
    if not clock.late:
        return []
    how = "come in packets" if clock.packets else "scatter"
    if clock.packets and not given:
        why = "as packets are"
    what = (
        f"time stamps {how}, up to {clock.late * 1e3:.3g} ms late: the samples were taken at a regular "
        f"{clock.rate:.2f} Hz instead, {why}"
    )
    return [Note(Kind.READING, what)]


def resampled(
    samples: Samples, instants: np.ndarray, resampling: Resampling, start: int, stop: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, tuple[int, int]]:
    """Resample positions and commands (M, n) at the clock's samples; mark valid ones, count missing and masked.

    They are interpolated between fresh samples at ``instants``, of which there must be some before and after.
    """
    from scipy.interpolate import CubicSpline

    clock, holds = resampling.clock, resampling.holds
    grid = clock.time(start, stop)
    begin, end = np.searchsorted(instants, grid[[0, -1]], side="right")
    around = SURROUNDINGS + holds.longest
    begin, end = max(0, begin - around), end + around
    known, command = block(instants, begin, end), block(samples.command, begin, end)
    position = block(samples.position, begin, end)
    later = np.concatenate([[True], np.diff(known) > 0])
    fresh = later & holds.position.fresh(position)
    bridged = max(BRIDGED * clock.period, clock.whole, 1.5 * holds.position.period * clock.period)
    lacking, masked = _gaps(known[later], grid, clock.whole), _gaps(known[fresh], grid, bridged)
    good = unclipped(command, resampling.clipped)
    before = np.clip(np.searchsorted(known, grid, side="right") - 1, 0, len(known) - 2)
    # Lines for the commands: a spline would overshoot where the current is noisy.
    values = np.column_stack(
        [
            np.interp(grid + resampling.delay, known[later & new], each)
            for columns, new in holds.fresh_commands(command)
            for each in command[later & new, columns].T
        ]
    )
    return (
        CubicSpline(known[fresh], position[fresh])(grid),
        values,
        ~masked[:, None] & good[before] & good[before + 1],
        (int(lacking.sum()), int((lacking & masked).sum())),
    )


def _gaps(known: np.ndarray, grid: np.ndarray, longest: float) -> np.ndarray:
    """Mark the instants of the ``grid`` within steps longer than ``longest`` between ``known`` ones."""
    step = np.diff(known)
    before = np.clip(np.searchsorted(known, grid, side="right") - 1, 0, len(step) - 1)
    period = (grid[-1] - grid[0]) / max(len(grid) - 1, 1)
    near = np.minimum(np.abs(grid - known[before]), np.abs(known[before + 1] - grid)) < 0.01 * period
    return ~near & (step[before] > longest * (1 + 1e-9))


def unclipped(command: np.ndarray, clipped: Sequence[tuple[int, float]]) -> np.ndarray:
    """Mark where commands (M, n) are not clipped at a level."""
    good = np.ones(command.shape, dtype=bool)
    for j, level in clipped:
        good[:, j] &= command[:, j] != level
    return good
