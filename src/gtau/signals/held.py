"""Signals that were logged faster than they were updated: held values are no samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from gtau.signals.notes import Kind, Note
from gtau.signals.samples import Samples, ahead
from gtau.signals.storage import block

# After stale samples a signal has come as far as meanwhile: it is not slower over them than around them by this factor.
# At constant acceleration the factor is 6 after rest and 4 around a reversal.
AS_BEFORE = 3.0
SPORADIC = 4  # equal samples in a row, at most, that are stale ones; more of them are a rest or a slow rounded motion,
FROZEN = 20  # unless up to so many stand where nearly every sample is new:
AROUND, NEW = 4, 1.5  # so many changes to either side come after so many samples on average
LONGEST = 200  # samples for which a slower signal is held, at most
REGULAR = 0.6  # share of the samples in runs of equal ones of nearly one length, where a signal is slower than the log
JUMP = 3.0  # quanta by which a signal jumps after it was held; a slow one that is rounded goes by one
REPORTED = 1e-3  # share of samples that are stale, from which on they are interpolated and reported
GROUPS = ("positions", "commands", "torque sensors", "wrenches")


@dataclass(frozen=True)
class Held:
    """How the columns of a group, positions, commands, torque sensors or wrenches, are held.

    ``period`` is the usual number of samples from one value to the next, 1 where it is updated with every one.
    ``quanta`` (n,) are the columns' smallest changes. ``by_chance`` says that repeated values are no more than noise
    and reversals make, so that all samples are new.
    """

    period: int
    quanta: tuple[float, ...]
    by_chance: bool = False

    @property
    def longest(self) -> int:
        """Longest run of equal samples that counts as held."""
        if self.by_chance:
            return 1
        return FROZEN if self.period == 1 else int(np.ceil(1.5 * self.period))

    def fresh(self, values: np.ndarray) -> np.ndarray:
        """Mark new samples (M,) of consecutive ``values`` (M, n); rests and slow rounded motions count as new."""
        same = np.concatenate([[False], (values[1:] == values[:-1]).all(axis=1)])
        found = np.ones(len(values), dtype=bool)
        if not same.any():
            return found
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
            found[start + 1 : start + count] = False
        return found


@dataclass(frozen=True)
class Holds:
    """How the groups of columns of a log are held, in the order of :data:`GROUPS`; None where it has no such columns.

    ``stale`` are the samples of each that repeat the one before, and ``widths`` its columns.
    """

    groups: tuple[Held | None, ...]
    stale: tuple[int, ...]
    widths: tuple[int, ...]

    @property
    def position(self) -> Held:
        """How the positions are held."""
        assert self.groups[0] is not None
        return self.groups[0]

    @property
    def none(self) -> bool:
        """Whether every sample is new."""
        return not any(self.stale)

    @property
    def longest(self) -> int:
        """Longest runs of equal samples that count as held, of all groups together."""
        return sum(each.longest for each in self.groups if each is not None)

    def fresh_commands(self, values: np.ndarray) -> list[tuple[slice, np.ndarray]]:
        """Pair the columns of the commands, and of the sensors and wrenches, with their new samples (M,)."""
        spans = _spans(self.widths[1:])
        return [
            (span, each.fresh(values[:, span]))
            for span, each in zip(spans, self.groups[1:], strict=True)
            if each is not None
        ]

    def notes(self, count: int, rate: float) -> list[Note]:
        """List what to report of a log of ``count`` samples at ``rate`` Hz."""
        found = []
        for each, stale, what in zip(self.groups, self.stale, GROUPS, strict=True):
            if each is None or not stale:
                continue
            if each.period > 1:
                slow = (
                    f"the {what} are held: new ones come at about {rate / each.period:.4g} Hz, every {each.period} "
                    "samples; interpolated between them"
                )
                found.append(Note(Kind.HELD, slow, f"log the {what} at the rate at which they change"))
            else:
                few = f"{stale} samples of the {what} are stale (repeat the one before): interpolated"
                found.append(Note(Kind.REPAIR, few, "log in the controller's own cycle", share=stale / count))
        return found


def holds_of(samples: Samples) -> Holds:
    """Find how the signals of a log are held; it goes by three times."""
    n, source = len(samples.source.joints), samples.source
    widths = (n, n, len(source.sensors), source.components)
    found = [_held(samples.position, slice(None)), *(_held(samples.command, each) for each in _spans(widths[1:]))]
    groups = tuple(held if width else None for (held, _), width in zip(found, widths, strict=True))
    return Holds(groups, tuple(stale for _, stale in found), widths)


def _spans(widths: Sequence[int]) -> list[slice]:
    """Find the columns of groups that stand side by side."""
    ends = np.cumsum([0, *widths]).tolist()
    return [slice(*pair) for pair in pairwise(ends)]


def _held(array: np.ndarray, columns: slice) -> tuple[Held, int]:
    """Find how a group's columns (N, n) are held, and count its stale samples."""
    n = len(range(array.shape[1])[columns])
    if not n:
        return Held(1, ()), 0
    smallest = np.full(n, np.inf)
    for span in ahead(len(array)):
        change = np.abs(np.diff(block(array, *span)[:, columns], axis=0))
        smallest = np.minimum(smallest, np.min(np.where(change > 0, change, np.inf), axis=0, initial=np.inf))
    quanta = np.where(np.isfinite(smallest), smallest, 1.0)
    lengths = np.zeros(LONGEST + 1, dtype=int)  # how many runs of equal samples before a jump there are of each length
    run, near = 1, 0
    for span in ahead(len(array)):
        change = np.max(np.abs(np.diff(block(array, *span)[:, columns], axis=0)) / quanta, axis=1, initial=0.0)
        near += int(((change[:-1] > 0) & (change[:-1] < 1.5) & (change[1:] >= JUMP)).sum())
        ends = np.flatnonzero(change)
        if ends.size:
            runs = np.diff(ends, prepend=-run)[change[ends] >= JUMP]
            lengths += np.bincount(np.minimum(runs, LONGEST + 1), minlength=LONGEST + 2)[: LONGEST + 1]
            run = len(change) - int(ends[-1])
        else:
            run += len(change)
    held = Held(_period(lengths), tuple(quanta.tolist()))
    stale = sum(int((~held.fresh(block(array, *span)[:, columns])).sum()) for span in ahead(len(array)))
    # Noise of some quanta repeats a sample as often as it goes by one quantum in any of the other 3^n - 1 directions.
    chance = 2 * near / (3.0**n - 1) + REPORTED * len(array)
    return (held, stale) if stale > chance else (replace(held, period=1, by_chance=True), 0)


def _period(lengths: np.ndarray) -> int:
    """Find the usual length of runs of equal samples, where most runs are nearly as long; otherwise 1."""
    held = lengths * np.arange(len(lengths))
    if not held.any():
        return 1
    period = int(np.argmax(held))
    near = held[int(np.floor(0.75 * period)) : int(np.ceil(1.25 * period)) + 1].sum()
    return period if period > 1 and near > REGULAR * held.sum() else 1
