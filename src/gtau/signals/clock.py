"""The clock behind a time column.

Time stamps are true, and samples were taken at irregular instants; or samples were taken at a regular rate, and their
stamps are late, as those of messages are that were received, polled or came in packets. The positions decide: they
are smooth in true time.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from gtau.signals.clock_gaps import PACKET, find_gaps, parts_of, sampled_steps
from gtau.signals.smoothness import cubic_residuals
from gtau.signals.storage import block, spans, store

# How much smoother the positions must be by the other clock. In the shared logs the Panda's positions are 20 times
# smoother at a regular rate, the UR10e's 3.6 times by their stamps; where neither, jitter does not matter (0.9 to 1.1).
SMOOTHER = 1.25
PASSES = 5  # in which period and gaps settle
DECIMALS = 10.0 ** np.arange(6)


@dataclass(frozen=True)
class Clock:
    """When the samples of a log were taken.

    Attributes
    ----------
    period : float
        Of a regular clock, or mean step, s.
    regular : bool
        Instants are multiples of the period, by which the time column is corrected; otherwise they are the stamps.
    gapless : bool
        Regular, and no sample is missing.
    start : float
        Instant of the first sample, s.
    count : int
        Samples of that period from the start to the last one.
    shortest, longest : float
        Steps between samples, s.
    before_longest : int
        Sample before the longest step.
    whole : float
        Longest step, s, that lacks no sample.
    gaps : tuple
        Of a regular clock: pairs of a sample and how many are missing before it; -1 where it repeats the one before.
    late : float
        How late stamps of a regular clock are at most, compared with the earliest, s; 0 where only rounded.
    packets : bool
        Samples came in packets with the same stamps, or nearly so.
    """

    period: float
    regular: bool
    gapless: bool
    start: float
    count: int
    shortest: float
    longest: float
    before_longest: int
    whole: float
    gaps: tuple[tuple[int, int], ...] = ()
    late: float = 0.0
    packets: bool = False

    @property
    def rate(self) -> float:
        """Samples a second, Hz."""
        return 1 / self.period

    def time(self, first: int, stop: int) -> np.ndarray:
        """Compute times of samples, s, by their numbers from the start."""
        return self.start + self.period * np.arange(first, stop)

    def instants(self, time: np.ndarray, first: int = 0) -> np.ndarray:
        """Compute the instants (N,), s, of samples by this clock from their times; ``first`` numbers the first."""
        if not self.regular:
            return time
        return store(self.start + self.period * self._numbers(first + a, first + b) for a, b in spans(len(time)))

    def _numbers(self, first: int, stop: int) -> np.ndarray:
        """Enumerate samples in the clock, missing ones counted."""
        samples, missing = self._sums
        number = np.arange(first, stop)
        return np.asarray(number + missing[np.searchsorted(samples, number, side="right")], dtype=float)

    @cached_property
    def _sums(self) -> tuple[np.ndarray, np.ndarray]:
        """Samples with gaps before them, and how many are missing in all before each and behind the last."""
        pairs = np.array(self.gaps, dtype=int).reshape(-1, 2)
        return pairs[:, 0], np.concatenate([[0], np.cumsum(pairs[:, 1])])


def clock_of(time: np.ndarray, position: np.ndarray, given: Literal["stamps", "regular"] | None = None) -> Clock:
    """Find the clock of a time column (N,) in s that never goes back, and of the positions (N, n) at these times.

    Where the samples leave a straight line by no more than the rounding of the time column, the clock is regular.
    Otherwise the positions decide between the stamps and a regular clock, unless it is ``given``.
    """
    steps = sampled_steps(time)
    mean = _mean_step(steps)
    packets = bool(np.mean(steps < 0.1 * mean) > PACKET)
    usual = float(mean if packets else np.median(steps))
    for _ in range(PASSES):  # the usual step of stamps that are late is not the period
        gaps = find_gaps(time, position, usual, packets)
        if gaps and (without := find_gaps(time, None, usual, packets)) != gaps:
            # Steps of the motion that grow and shrink within some samples look like gaps: the stamps then run away.
            late_by = [_line(time, usual, each)[2] for each in (gaps, without)]
            gaps = gaps if late_by[0] <= late_by[1] + usual else without
        period, offset, late, rounded = _line(time, usual, gaps)
        settled = rounded or abs(period / usual - 1) < 1e-5
        usual = period
        if settled:
            break
    straight = rounded or late <= 1e-3 * period
    regular = Clock(
        period=period,
        regular=True,
        gapless=not gaps,
        start=float(time[0]) if straight else float(time[0]) + offset,
        count=len(time) + sum(missing for _, missing in gaps),
        shortest=period,
        longest=period * (1 + max((missing for _, missing in gaps), default=0)),
        before_longest=max(gaps, key=lambda gap: gap[1], default=(1, 0))[0] - 1,
        whole=1.5 * period,
        gaps=gaps,
        late=0.0 if straight else late,
        packets=packets,
    )
    if given == "regular" or (given is None and (straight or packets)):
        return regular
    if steps.min() == 0 and given is None:
        return regular
    stamps = _by_stamps(time, steps)
    if given == "stamps" or _roughness(time, position, regular) > _roughness(time, position, stamps) / SMOOTHER:
        return stamps
    return regular


def _by_stamps(time: np.ndarray, steps: np.ndarray) -> Clock:
    """Make the clock of true stamps."""
    period = float((time[-1] - time[0]) / (len(time) - 1))
    shortest, longest, before, at = np.inf, 0.0, 0, 0
    for part in _overlapping(time):
        step = np.diff(part)
        k = int(np.argmax(step))
        if step[k] > longest:
            longest, before = float(step[k]), at + k
        shortest, at = min(shortest, float(step.min())), at + len(step)
    return Clock(
        period=period,
        regular=False,
        gapless=False,
        start=float(time[0]),
        count=int((time[-1] - time[0]) / period * (1 + 1e-12)) + 1,
        shortest=shortest,
        longest=longest,
        before_longest=before,
        whole=1.5 * max(period, float(np.quantile(steps, 0.95))),
    )


def _mean_step(steps: np.ndarray) -> float:
    """Average the steps without pauses, which are five times as long as all but one in a hundred."""
    pause = 5 * np.quantile(steps, 0.99)
    return float(np.mean(steps[steps <= pause] if pause > 0 else steps))


def _line(time: np.ndarray, usual: float, gaps: tuple[tuple[int, int], ...]) -> tuple[float, float, float, bool]:
    """Fit period and offset (s) of the stamps by least squares; say how late they are, and if by rounding."""
    numbered = Clock(usual, True, not gaps, 0.0, 0, 0.0, 0.0, 0, 0.0, gaps)
    sums, samples = np.zeros(4), len(time)
    for start, stop in spans(samples):
        number = numbered._numbers(start, stop)
        rest = block(time, start, stop) - time[0] - usual * number
        sums += number.sum(), rest.sum(), number @ number, number @ rest
    x, y, xx, xy = sums.tolist()
    slope = (xy - x * y / samples) / (xx - x * x / samples)
    period, offset = usual + slope, (y - slope * x) / samples
    low, high, resolution = np.inf, -np.inf, np.zeros(len(DECIMALS))
    for start, stop in spans(samples):
        elapsed = block(time, start, stop) - time[0]
        off = elapsed - period * numbered._numbers(start, stop) - offset
        low, high = min(low, float(off.min())), max(high, float(off.max()))
        scaled = elapsed * DECIMALS[:, None]
        resolution = np.maximum(resolution, np.abs(scaled - np.round(scaled)).max(axis=1))
    rounded = max(-low, high) <= max(1e-3 * period, min(_last_decimal(resolution), 0.5 * period))
    # The earliest stamps are the least late ones: the clock is shifted to them.
    return period, offset if rounded else offset + low, high - low, rounded


def _last_decimal(off: np.ndarray) -> float:
    """Find the last decimal of a time column, s; a microsecond where it is finer, which no motion notices.

    A clock that counts from 1970 is right to 2e-7 s in a float.
    """
    exact = np.flatnonzero(off < 0.03)
    return 1 / float(DECIMALS[exact[0]]) if exact.size else 1e-6


def _roughness(time: np.ndarray, position: np.ndarray, clock: Clock) -> float:
    """Measure how far positions usually are from cubics through their neighbours by a clock, where joints are fast.

    The geometric mean over the joints, in m or rad; of a long log in parts spread over it.
    """
    off, speeds = [], []
    for start, stop in parts_of(len(time)):
        instants = np.asarray(clock.instants(block(time, start, stop), start))
        found = block(position, start, stop)
        off.append(np.abs(cubic_residuals(instants, found, clock.period)))
        speeds.append(np.abs(found[4:] - found[:-4]))
    distance, speed = np.concatenate(off), np.concatenate(speeds)
    roughness = []
    for j in range(position.shape[1]):
        fast = speed[:, j] > np.median(speed[:, j])
        if fast.any():
            roughness.append(np.median(distance[fast, j]) + 1e-4 * np.median(speed[fast, j]))
    return float(np.exp(np.mean(np.log(roughness)))) if roughness else 0.0


def _overlapping(time: np.ndarray) -> Iterator[np.ndarray]:
    """Yield blocks that begin with the last sample of the one before."""
    return (block(time, max(start - 1, 0), stop) for start, stop in spans(len(time)))
