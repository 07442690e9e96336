"""Signals that were logged faster than they were updated: held values are no samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gtau.signals.samples import Samples, ahead
from gtau.signals.storage import block

SPORADIC = 4  # equal samples in a row, at most, that are stale ones; more of them are a rest
LONGEST = 200  # samples for which a slower signal is held, at most
REGULAR = 0.6  # share of the samples in runs of equal ones of nearly one length, where a signal is slower than the log
JUMP = 3.0  # quanta by which a signal jumps after it was held; a slow one that is rounded goes by one
REPORTED = 1e-3  # share of samples that are stale, which is worth a note


@dataclass(frozen=True)
class Held:
    """How the columns of a group, positions or commands, are held.

    ``period`` is the usual number of samples from one value to the next, 1 where it is updated with every one.
    ``quanta`` (n,) are the columns' smallest changes.
    """

    period: int
    quanta: tuple[float, ...]

    @property
    def longest(self) -> int:
        """Longest run of equal samples that counts as held."""
        return SPORADIC if self.period == 1 else int(np.ceil(1.5 * self.period))

    def fresh(self, values: np.ndarray) -> np.ndarray:
        """Which samples (M,) of consecutive ``values`` (M, n) were new; rests and slow rounded motions are new too."""
        same = np.concatenate([[False], (values[1:] == values[:-1]).all(axis=1)])
        found = np.ones(len(values), dtype=bool)
        if not same.any():
            return found
        first = np.flatnonzero(~same)  # of each run of equal samples
        length = np.diff(np.r_[first, len(values)])
        jump = np.zeros(len(first))
        jump[:-1] = np.max(np.abs(values[first[1:]] - values[first[:-1]]) / self.quanta, axis=1)
        stale = (length > 1) & (length <= self.longest) & (jump >= JUMP)
        for start, count in zip(first[stale], length[stale], strict=True):
            found[start + 1 : start + count] = False
        return found


@dataclass(frozen=True)
class Holds:
    """How the positions and the commands of a log are held, and the samples of each that are stale."""

    position: Held
    command: Held
    stale: tuple[int, int] = (0, 0)

    @property
    def none(self) -> bool:
        """Whether every sample is new."""
        return self.stale == (0, 0)

    def notes(self, count: int, rate: float) -> list[str]:
        """What to report of a log of ``count`` samples at ``rate`` Hz."""
        found = []
        groups = (self.position, self.stale[0], "positions"), (self.command, self.stale[1], "commands")
        for each, stale, what in groups:
            if stale and each.period > 1:
                found.append(
                    f"the {what} are held: new ones come at about {rate / each.period:.4g} Hz, every {each.period} "
                    "samples; interpolated between them"
                )
            elif stale > REPORTED * count:
                found.append(f"{stale} samples of the {what} are stale (repeat the one before): interpolated")
        return found


def holds_of(samples: Samples) -> Holds:
    """Find how the signals of a log are held; it goes by twice."""
    groups = []
    for array in (samples.position, samples.command):
        quanta = np.full(array.shape[1], np.inf)
        lengths = np.zeros(LONGEST + 1, dtype=int)  # how many runs of equal samples there are of each length
        run = 1
        for start, stop in ahead(len(array)):
            change = np.abs(np.diff(block(array, start, stop), axis=0))
            quanta = np.minimum(quanta, np.min(np.where(change > 0, change, np.inf), axis=0, initial=np.inf))
            ends = np.flatnonzero(change.any(axis=1))
            if ends.size:
                runs = np.diff(ends, prepend=-run)
                lengths += np.bincount(np.minimum(runs, LONGEST + 1), minlength=LONGEST + 2)[: LONGEST + 1]
                run = len(change) - int(ends[-1])
            else:
                run += len(change)
        groups.append(Held(_period(lengths), tuple(np.where(np.isfinite(quanta), quanta, 1.0).tolist())))
    stale = [
        sum(int((~each.fresh(block(array, start, stop))).sum()) for start, stop in ahead(len(array)))
        for each, array in zip(groups, (samples.position, samples.command), strict=True)
    ]
    return Holds(groups[0], groups[1], (stale[0], stale[1]))


def _period(lengths: np.ndarray) -> int:
    """Usual length of runs of equal samples, where most samples stand in runs of nearly that length; otherwise 1."""
    held = lengths * np.arange(len(lengths))
    if not held.any():
        return 1
    period = int(np.argmax(held))
    near = held[int(np.floor(0.75 * period)) : int(np.ceil(1.25 * period)) + 1].sum()
    return period if period > 1 and near > REGULAR * held.sum() else 1
