"""The clock behind a time column."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gtau.signals.storage import block, spans, store


@dataclass(frozen=True)
class Clock:
    """When the samples of a log were taken.

    ``regular``: their instants are multiples of the ``period``, by which time columns are then corrected, and none is
    missing where the log is ``gapless``; otherwise the period is the mean one. ``count`` samples of that period begin
    at ``start`` and reach to the last one. ``usual``, ``shortest`` and ``longest`` step, and the sample before the
    latter. Times in s.
    """

    period: float
    usual: float
    regular: bool
    gapless: bool
    start: float
    count: int
    shortest: float
    longest: float
    before_longest: int

    @property
    def rate(self) -> float:
        """Samples a second, Hz."""
        return 1 / self.period

    def time(self, first: int, stop: int) -> np.ndarray:
        """Times of samples, s, by their numbers from the start."""
        return self.start + self.period * np.arange(first, stop)

    def instants(self, time: np.ndarray, first: float | None = None) -> np.ndarray:
        """When samples were taken by this clock (N,), s, from their times; the ``first`` of them, if not ``start``."""
        if not self.regular or self.gapless:
            return time
        begin = 0.0 if first is None else round((first - self.start) / self.period)
        return store(self.start + self.period * (begin + number) for number, _ in _numbered(time, self.usual))


def clock_of(time: np.ndarray) -> Clock:
    """The clock of a time column (N,) in s that only grows.

    It is regular when the samples leave the straight line by no more than the rounding of the time column,
    and then the line is the better clock.
    """
    samples, start = len(time), float(time[0])
    usual = float(np.median([np.median(np.diff(part)) for part in _overlapping(time)]))
    # The line by least squares, as what it departs from the one of the usual step.
    sums = np.zeros(4)
    for number, elapsed in _numbered(time, usual):
        rest = elapsed - usual * number
        sums += number.sum(), rest.sum(), number @ number, number @ rest
    x, y, xx, xy = sums.tolist()
    slope = (xy - x * y / samples) / (xx - x * x / samples)
    period, offset = usual + slope, (y - slope * x) / samples
    off, last, resolution = 0.0, 0, np.zeros(len(DECIMALS))
    for number, elapsed in _numbered(time, usual):
        off, last = max(off, float(np.abs(elapsed - period * number - offset).max())), int(number[-1])
        scaled = elapsed * DECIMALS[:, None]
        resolution = np.maximum(resolution, np.abs(scaled - np.round(scaled)).max(axis=1))
    if off > max(1e-3 * period, min(_last_decimal(resolution), 0.5 * period)):
        count = int((time[-1] - start) / period) + 1
        return Clock(period, usual, False, False, start, count, **_steps(time))
    clock = Clock(period, usual, True, last + 1 == samples, start, last + 1, period, period, 0)
    return clock if clock.gapless else replace(clock, **_steps(clock.instants(time)))


DECIMALS = 10.0 ** np.arange(6)


def _last_decimal(off: np.ndarray) -> float:
    """Last decimal of a time column, s; a microsecond where it is finer, which no motion notices.

    A clock that counts from 1970 is right to 2e-7 s in a float.
    """
    exact = np.flatnonzero(off < 0.03)
    return 1 / float(DECIMALS[exact[0]]) if exact.size else 1e-6


def _overlapping(time: np.ndarray) -> Iterator[np.ndarray]:
    """Blocks that begin with the last sample of the one before."""
    return (block(time, max(start - 1, 0), stop) for start, stop in spans(len(time)))


def _numbered(time: np.ndarray, usual: float) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Blocks of numbers of the samples in a clock of the ``usual`` step, missing ones counted, and times elapsed."""
    number, before = -1.0, float(time[0]) - usual
    for span in spans(len(time)):
        part = block(time, *span)
        numbers = number + np.cumsum(np.maximum(np.round(np.diff(part, prepend=before) / usual), 1.0))
        number, before = float(numbers[-1]), float(part[-1])
        yield numbers, part - time[0]


def _steps(instants: np.ndarray) -> dict[str, Any]:
    """Shortest and longest step, and the sample before the latter."""
    shortest, longest, before, at = np.inf, 0.0, 0, 0
    for part in _overlapping(instants):
        step = np.diff(part)
        k = int(np.argmax(step))
        if step[k] > longest:
            longest, before = float(step[k]), at + k
        shortest, at = min(shortest, float(step.min())), at + len(step)
    return {"shortest": shortest, "longest": longest, "before_longest": before}
