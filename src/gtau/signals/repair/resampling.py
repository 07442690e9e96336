"""Resampling of a log to a uniform grid; missing and held values are interpolated and masked.

Signals logged faster than they are updated contain repeated values, which are not new samples.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np
from numpy.typing import ArrayLike

from gtau.errors import GtauError
from gtau.findings import Finding, counted, moment
from gtau.signals.reading.formats import reading, repair
from gtau.signals.reading.samples import MAX_MISSING, Samples
from gtau.signals.repair.clock import Clock
from gtau.signals.storage import Store, block, blocks, spans, steps, store

AS_BEFORE = 3.0  # times that a signal may be slower over stale samples than around them
SPORADIC = 4  # equal samples in a row, at most, that are stale ones; more of them are a rest or a slow rounded motion,
FROZEN = 20  # unless up to FROZEN stand where nearly every sample is new:
AROUND, NEW = 4, 1.5  # AROUND changes to either side come after NEW samples each, on average
LONGEST = 200  # samples for which a slower signal is held, at most
REGULAR = 0.6  # share of the samples in runs of equal ones of nearly one length, where a signal is slower than the log
JUMP = 3.0  # quanta by which a signal jumps after it was held; a slow one that is rounded changes by one
REPORTED = 1e-3  # share of samples that are stale, from which on they are interpolated and reported
MAX_GAP = 0.1  # s; longer ones cannot be bridged without inventing a motion
MISSING_STEP = 1.5  # mean steps; longer steps have lost a sample
BRIDGED = 3  # steps over which positions are interpolated without a mask
MAX_BRIDGED = 0.3  # part of a log that may be missing in such steps
POSITIONS = "positions"  # beside the groups of channels
SURROUNDINGS = 64  # samples to either side that a spline is made from: what lies beyond acts by less than 1e-19

Clips = Sequence[tuple[int, float]]
"""Channels (numbers) with the levels at which they are clipped."""


@dataclass(frozen=True)
class Held:
    """Sample-and-hold of a group of columns: of the positions, or of channels that a log updates together.

    ``period`` is the usual number of samples from one value to the next; ``quanta`` (n,) are the columns' smallest
    changes. ``stale`` counts the samples that repeat the one before, 0 where noise and reversals explain them all.
    """

    period: int
    quanta: np.ndarray
    stale: int

    @property
    def longest(self) -> int:
        """Longest run of equal samples that counts as held."""
        if not self.stale:
            return 1
        return FROZEN if self.period == 1 else int(np.ceil(1.5 * self.period))

    def fresh(self, values: np.ndarray) -> np.ndarray:
        """Mark new samples (M,) of consecutive ``values`` (M, n); rests and slow rounded motions count as new."""
        fresh = np.ones(len(values), dtype=bool)
        same = np.concatenate([[False], (values[1:] == values[:-1]).all(axis=1)])
        if not same.any() or not self.stale:
            return fresh
        first = np.flatnonzero(~same)  # of each run of equal samples
        length = np.diff(np.r_[first, len(values)])
        jump = np.zeros((len(first), values.shape[1]))  # of each column to the next run
        jump[:-1] = np.abs(values[first[1:]] - values[first[:-1]]) / self.quanta
        moved = jump >= JUMP
        stale = (length > 1) & (length <= self.longest)
        if self.period == 1:
            speed = np.pad(jump / length[:, None], ((1, 1), (0, 0)))
            moved &= AS_BEFORE * speed[1:-1] >= np.maximum(speed[:-2], speed[2:])
            around = np.convolve(length, np.ones(2 * AROUND + 1))[AROUND:-AROUND] - length
            stale &= (length <= SPORADIC) | (around <= 2 * AROUND * NEW)
        stale &= moved.any(axis=1)
        for start, count in zip(first[stale], length[stale], strict=True):
            fresh[start + 1 : start + count] = False
        return fresh


Holds = Mapping[str, Held]
"""Sample-and-hold of the ``positions``, and of each group of channels by its name."""


def holds_of(samples: Samples) -> Holds:
    """Detect sample-and-hold of the positions and of each group of channels, in three passes."""
    groups = {group: _held(samples.command, columns) for group, columns in _groups(samples)}
    return {POSITIONS: _held(samples.position, slice(None)), **groups}


def _groups(samples: Samples) -> Iterator[tuple[str, slice]]:
    start = 0
    for group, channels in groupby(samples.channels, lambda channel: channel.kind.group):
        stop = start + len(list(channels))
        yield group, slice(start, stop)
        start = stop


def _held(array: np.ndarray, columns: slice) -> Held:
    """Detect sample-and-hold of a group's columns (N, n), and count its stale samples."""
    array = array[:, columns]
    n = array.shape[1]
    changes = (np.abs(step) for step in steps(array))
    smallest = np.min([np.min(sizes, axis=0, where=sizes > 0, initial=np.inf) for sizes in changes], axis=0)
    quanta = np.where(np.isfinite(smallest), smallest, 1.0)
    lengths = np.zeros(LONGEST + 2, dtype=int)  # how many runs of equal samples before a jump there are of each length
    run, near = 1, 0
    for step in steps(array):
        change = np.max(np.abs(step) / quanta, axis=1, initial=0.0)
        near += int(((change[:-1] > 0) & (change[:-1] < 1.5) & (change[1:] >= JUMP)).sum())
        ends = np.flatnonzero(change)
        if not ends.size:
            run += len(change)
            continue
        runs = np.diff(ends, prepend=-run)[change[ends] >= JUMP]
        lengths += np.bincount(np.minimum(runs, LONGEST + 1), minlength=len(lengths))
        run = len(change) - int(ends[-1])
    held = Held(_period(lengths[:-1]), quanta, stale=len(array))
    stale = sum(int((~held.fresh(part)).sum()) for part in blocks(array, before=1))
    # Noise of some quanta repeats a sample as often as it steps by one quantum in each of the other 3^n - 1 directions.
    chance = 2 * near / (3.0**n - 1) + REPORTED * len(array)
    return replace(held, stale=stale) if stale > chance else replace(held, period=1, stale=0)


def _period(lengths: np.ndarray) -> int:
    """Find the typical length of runs of equal samples, where most runs have nearly that length; otherwise 1."""
    held = lengths * np.arange(len(lengths))
    if not held.any():
        return 1
    period = int(np.argmax(held))
    near = held[int(np.floor(0.75 * period)) : int(np.ceil(1.25 * period)) + 1].sum()
    return period if period > 1 and near > REGULAR * held.sum() else 1


def long_runs(array: np.ndarray, noise: ArrayLike = 0.0) -> Iterator[tuple[int, int, int]]:
    """Yield column, begin and end of runs of more than FROZEN equal values; those below the ``noise`` count as 0."""
    count, columns = array.shape
    begins = [0] * columns
    for start, stop in spans(count, before=1):
        part = block(array, start, stop)
        part[np.abs(part) < noise] = 0.0
        last = [count] if stop == count else []
        for j, step in enumerate(np.diff(part, axis=0).T):
            edges = np.r_[begins[j], start + 1 + np.flatnonzero(step), last].astype(int)
            for k in np.flatnonzero(np.diff(edges) > FROZEN):
                yield j, int(edges[k]), int(edges[k + 1])
            begins[j] = int(edges[-1])


def uniform(
    samples: Samples, clock: Clock, instants: np.ndarray, holds: Holds, clips: Clips, notes: list[Finding], given: bool
) -> tuple[Samples, np.ndarray]:
    """Put samples taken at their ``instants`` onto the uniform grid of a clock that was ``given`` or found.

    Also mark the commands (N, c) that were neither interpolated nor clipped. The channels' delays are compensated.
    """
    count, c = len(instants) + clock.missing, len(samples.channels)
    shortest, longest, before = clock.extreme_steps(samples.time)
    if longest > max(MAX_GAP, 3 * clock.period):
        raise GtauError(
            f"{samples.name}, {samples.place(before)}: {longest:.3g} s are missing after "
            f"{moment(samples.time[before])}; cut the log there into two runs (from: and to:)."
        )
    time = store(clock.time(*span) for span in spans(count))
    delay = max((channel.delay for channel in samples.channels), key=abs)
    clock_notes = _notes(clock, holds, count, shortest, longest, given)
    if clock.regular and not (clock.gaps or delay or any(held.stale for held in holds.values())):
        # The samples are on the grid already.
        valid = store((_unclipped(part, clips) for part in blocks(samples.command)), (c,), bool)
        notes += clock_notes
        return replace(samples, time=time), valid
    stores, missing, masked = (Store((len(samples.joints),)), Store((c,)), Store((c,), bool)), 0, 0
    for span in spans(count):
        *arrays, lacking, hidden = _resampled(samples, clock, instants, holds, clips, span)
        for rows, array in zip(stores, arrays, strict=True):
            rows.append(array)
        missing, masked = missing + int(lacking.sum()), masked + int((lacking & hidden).sum())
    if masked > MAX_MISSING * count or missing > MAX_BRIDGED * count:
        what = "by stamps that come in packets, " if clock.packets else ""
        remedy = ", or, where no sample is missing, give the rate instead (time: {rate: HZ})" if clock.regular else ""
        raise GtauError(
            f"{samples.name} lacks {missing} of {count} samples ({what}steps of {shortest * 1e3:.3g} to "
            f"{longest * 1e3:.3g} ms); record it at a steady rate{remedy}."
        )
    if missing:
        more = f", and masked {masked} of them in gaps of more than {BRIDGED} samples" if masked else ""
        text = f"interpolated {counted(missing, 'missing sample')}{more}"
        advice = "log every cycle of the controller"
        notes.append(repair("missing samples", missing / count, text=text, advice=advice))
    notes += clock_notes
    if delay:
        text = f"moved the commands {delay * 1e3:.4g} ms forward, as preparation.delay says"
        notes.append(reading("moved commands", text=text))
    position, command, valid = (rows.array() for rows in stores)
    return replace(samples, time=time, position=position, command=command), valid


def _notes(clock: Clock, holds: Holds, count: int, shortest: float, longest: float, given: bool) -> Iterator[Finding]:
    """Note the clock, and the signals that repeat samples, among ``count`` in all."""
    if not clock.regular:
        reason = "the time stamps are used, because a regular clock makes the positions no smoother"
        steps = f"irregular steps of {shortest * 1e3:.3g} to {longest * 1e3:.3g} ms to a uniform {clock.rate:.2f} Hz"
        text = f"resampled from {steps}: {'as preparation.clock says' if given else reason}"
        yield reading("irregular steps", text=text)
    elif clock.late:
        how, reason, advice = "scatter", "which makes the positions smoother", ""
        if clock.packets:
            how, reason = "come in packets", "as packets are"
            advice = "if this rate is wrong, give the right one (time: {rate: HZ})"
        regular = f"a regular {clock.rate:.2f} Hz instead, {'as preparation.clock says' if given else reason}"
        text = f"time stamps {how}, up to {clock.late * 1e3:.3g} ms late: the samples were taken at {regular}"
        yield reading("late time stamps", text=text, advice=advice)
    for signal, held in holds.items():
        if held.period > 1:
            rate = f"{clock.rate / held.period:.4g} Hz, every {held.period} samples"
            text = f"the {signal} are held: updated at about {rate}; interpolated between updates"
            advice = f"log the {signal} at the rate at which they change"
            yield Finding("held signal", text=text, advice=advice)
        elif held.stale:
            text = f"{held.stale} samples of the {signal} are stale (repeat the previous one): interpolated"
            advice = "log in the controller's own cycle"
            yield repair("stale samples", held.stale / count, text=text, advice=advice)


def _resampled(
    samples: Samples, clock: Clock, instants: np.ndarray, holds: Holds, clips: Clips, span: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Resample positions and commands (M, n) at the clock's samples of a span; mark valid, missing and masked ones."""
    from scipy.interpolate import CubicSpline

    grid = clock.time(*span)
    begin, end = np.searchsorted(instants, grid[[0, -1]], side="right")
    around = SURROUNDINGS + sum(held.longest for held in holds.values())
    begin, end = max(0, begin - around), end + around
    known, command = block(instants, begin, end), block(samples.command, begin, end)
    position = block(samples.position, begin, end)
    later = np.concatenate([[True], np.diff(known) > 0])
    fresh = later & holds[POSITIONS].fresh(position)
    bridged = max(BRIDGED * clock.period, clock.longest_step, 1.5 * holds[POSITIONS].period * clock.period)
    lacking = _gaps(known[later], grid, clock.longest_step)
    masked = _gaps(known[fresh], grid, bridged)
    # Lines for the commands: a spline would overshoot where the current is noisy.
    values = np.empty((len(grid), command.shape[1]))
    for group, columns in _groups(samples):
        new = later & holds[group].fresh(command[:, columns])
        for k in range(columns.start, columns.stop):
            values[:, k] = np.interp(grid + samples.channels[k].delay, known[new], command[new, k])
    good = _unclipped(command, clips)
    before = np.clip(np.searchsorted(known, grid, side="right") - 1, 0, len(known) - 2)
    valid = ~masked[:, None] & good[before] & good[before + 1]
    return CubicSpline(known[fresh], position[fresh])(grid), values, valid, lacking, masked


def _gaps(known: np.ndarray, grid: np.ndarray, longest: float) -> np.ndarray:
    """Mark the instants of the ``grid`` within steps longer than ``longest`` between ``known`` ones."""
    step = np.diff(known)
    before = np.clip(np.searchsorted(known, grid, side="right") - 1, 0, len(step) - 1)
    period = (grid[-1] - grid[0]) / max(len(grid) - 1, 1)
    near = np.minimum(np.abs(grid - known[before]), np.abs(known[before + 1] - grid)) < 0.01 * period
    return ~near & (step[before] > longest * (1 + 1e-9))


def _unclipped(command: np.ndarray, clips: Clips) -> np.ndarray:
    good = np.ones(command.shape, dtype=bool)
    for j, level in clips:
        good[:, j] &= command[:, j] != level
    return good
