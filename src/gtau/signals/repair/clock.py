"""Sampling clock of a time column.

Either the time stamps are true and sampling was irregular, or sampling was regular and the stamps are late (received
or polled messages, packets). The positions decide: they are smooth in true time. Missing samples of a regular clock are
located by the positions too, or by the surrounding stamps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from gtau.signals.storage import block, spans, steps, store

SMOOTHER = 1.25  # how much smoother the positions must be by the other clock
PASSES = 5  # in which period and gaps converge
DECIMALS = 10.0 ** np.arange(6)
RUNAWAY = 0.3  # share of samples that a clock may lack
LATE = 1.5  # usual steps, beyond which samples may be missing
PACKET = 0.2  # share of samples whose stamps follow within a tenth of a step: they came in packets
FEWEST_AROUND, MOST_AROUND = 20, 400  # samples to either side from which a gap is judged
NEIGHBOURS = 21  # steps whose median is the usual one; where motions change faster, no step is clear
CLEAR = 8.0  # standard deviations of a step of the joints' motion, where it separates one step from two
LONGEST_BY_MOTION = 5.5  # steps over which the speed is taken to be constant
DOUBT = 0.7  # of a step: stamps that move by less have lost no sample
LOOKED_AT = 16, 4096  # parts of a log to evaluate, and samples in each
REACH = 2  # samples to either side of which a prediction is made
# Standard deviation of a sample's distance from the cubic through its four neighbours, at a regular rate, in standard
# deviations of white noise: sqrt(1 + 2 (4^2 + 1) / 36).
WHITE = 1.394

Given = Literal["stamps", "regular"] | None
Gaps = tuple[tuple[int, int], ...]
"""Pairs of a sample and the number of samples missing before it, -1 where it repeats the previous one."""


@dataclass(frozen=True)
class Clock:
    """Sampling instants of a log, s: the stamps, or multiples of the ``period`` where it is ``regular``.

    ``start`` is the instant of the first sample. Steps above ``longest_step`` miss samples. A regular clock has
    ``gaps``, and its stamps are up to ``late`` late relative to the earliest; 0 if only rounded. ``packets``: samples
    came in packets with the same stamps, or nearly so.
    """

    period: float
    regular: bool
    start: float
    longest_step: float
    gaps: Gaps = ()
    late: float = 0.0
    packets: bool = False

    @property
    def rate(self) -> float:
        """Sampling rate, Hz."""
        return 1 / self.period

    @property
    def missing(self) -> int:
        """Number of missing samples."""
        return sum(missing for _, missing in self.gaps)

    def time(self, first: int, stop: int) -> np.ndarray:
        """Compute times of samples, s, from their numbers."""
        return self.start + self.period * np.arange(first, stop)

    def instants(self, time: np.ndarray, first: int = 0) -> np.ndarray:
        """Correct the times of samples by this clock, (N,), s; ``first`` is the number of the first sample."""
        if not self.regular:
            return time
        numbers = _numbering(self.gaps)
        return store(self.start + self.period * numbers(first + a, first + b) for a, b in spans(len(time)))

    def beyond(self, time: np.ndarray, longest: float) -> list[int]:
        """List the samples before which more than ``longest`` (s) passed, by this clock of their stamps."""
        if self.regular:
            return [sample for sample, missing in self.gaps if self.period * (1 + missing) > longest]
        far, start = list[int](), 1
        for step in steps(time):
            far += (start + np.flatnonzero(step > longest)).tolist()
            start += len(step)
        return far

    def extreme_steps(self, time: np.ndarray) -> tuple[float, float, int]:
        """Find the shortest and the longest step, s, and the sample before the latter."""
        if self.regular:
            sample, missing = max(self.gaps, key=lambda gap: gap[1], default=(1, 0))
            return self.period, self.period * (1 + missing), sample - 1
        shortest, longest, before, start = np.inf, 0.0, 0, 0
        for step in steps(time):
            k = int(np.argmax(step))
            if step[k] > longest:
                longest, before = float(step[k]), start + k
            shortest, start = min(shortest, float(step.min())), start + len(step)
        return shortest, longest, before


def _numbering(gaps: Gaps) -> Callable[[int, int], np.ndarray]:
    at, missing = np.array(gaps, dtype=int).reshape(-1, 2).T
    before = np.concatenate([[0], np.cumsum(missing)])  # each gap, and the end

    def numbers(first: int, stop: int) -> np.ndarray:
        number = np.arange(first, stop, dtype=float)
        return np.asarray(number + before[np.searchsorted(at, number, side="right")])

    return numbers


def clock_of(time: np.ndarray, position: np.ndarray, given: Given = None) -> Clock:
    """Identify the clock of a nondecreasing time column (N,), s, from the positions (N, n), unless it is ``given``.

    Where the stamps differ from a straight line by the rounding of the time column at most, the clock is regular.
    """
    sampled = sampled_steps(time)
    regular, straight = _regular(time, position, sampled)
    if given == "regular" or (given is None and (straight or regular.packets)):
        return regular
    period = float((time[-1] - time[0]) / (len(time) - 1))
    longest_step = 1.5 * max(period, float(np.quantile(sampled, 0.95)))
    stamps = Clock(period, regular=False, start=float(time[0]), longest_step=longest_step)
    if given == "stamps":
        return stamps
    rough, stamped = (_roughness(time, position, clock) for clock in (regular, stamps))
    # Equal stamps cannot be right for both samples, so that the remaining stamps must show that they are true.
    true = stamped * SMOOTHER < rough if sampled.min() == 0 else stamped < SMOOTHER * rough
    return stamps if true else regular


def _regular(time: np.ndarray, position: np.ndarray, sampled: np.ndarray) -> tuple[Clock, bool]:
    """Find the regular clock closest to the stamps, and decide whether these are straight, up to their rounding."""
    pause = 5 * np.quantile(sampled, 0.99)  # as long as five steps, of all but one in a hundred
    mean = float(np.mean(sampled[sampled <= pause] if pause > 0 else sampled))
    packets = bool(np.mean(sampled < 0.1 * mean) > PACKET)
    usual = float(mean if packets else np.median(sampled))
    for _ in range(PASSES):  # the median step of late stamps is not the period
        gaps = _find_gaps(time, position, usual, packets)
        if gaps and (without := _find_gaps(time, None, usual, packets)) != gaps:
            # Steps of the motion that grow and shrink within some samples look like gaps: the stamps then run away.
            late_by = [_line(time, usual, choice)[2] for choice in (gaps, without)]
            gaps = gaps if late_by[0] <= late_by[1] + usual else without
        period, offset, late, rounded = _line(time, usual, gaps)
        converged = rounded or abs(period / usual - 1) < 1e-5
        usual = period
        if converged:
            break
    lost = sum(missing for _, missing in gaps)
    if lost > RUNAWAY * len(time) and late > period:
        # Steps that scatter as much as they are long look like gaps, and each gap makes further steps look longer.
        rest = np.flatnonzero(np.diff(time) > pause)
        gaps = tuple((int(k) + 1, round(float(time[k + 1] - time[k]) / mean) - 1) for k in rest)
        period, offset, late, rounded = _line(time, mean, gaps)
    elif packets and gaps:
        # Packets of all sizes look like gaps. Where all samples are there, their stamps stay near a clock without any
        # (14 ms instead of 56 to 76 ms in simulated logs); where a packet was lost, they leave it by that packet.
        gapless = _line(time, float((time[-1] - time[0]) / (len(time) - 1)), ())
        if gapless[2] <= late + gapless[0]:
            gaps, (period, offset, late, rounded) = (), gapless
    start, straight = float(time[0]), rounded or late <= 1e-3 * period
    if straight:
        offset = late = 0.0
    return Clock(period, True, start + offset, 1.5 * period, gaps, late, packets), straight


def _line(time: np.ndarray, usual: float, gaps: Gaps) -> tuple[float, float, float, bool]:
    """Fit period and offset (s) of the stamps by least squares; return their lateness, and whether it is rounding."""
    numbers, sums, samples = _numbering(gaps), np.zeros(4), len(time)
    for start, stop in spans(samples):
        number = numbers(start, stop)
        rest = block(time, start, stop) - time[0] - usual * number
        sums += number.sum(), rest.sum(), number @ number, number @ rest
    x, y, xx, xy = sums.tolist()
    slope = (xy - x * y / samples) / (xx - x * x / samples)
    period, offset = usual + slope, (y - slope * x) / samples
    low, high, resolution = np.inf, -np.inf, np.zeros(len(DECIMALS))
    for start, stop in spans(samples):
        elapsed = block(time, start, stop) - time[0]
        off = elapsed - period * numbers(start, stop) - offset
        low, high = min(low, float(off.min())), max(high, float(off.max()))
        scaled = elapsed * DECIMALS[:, None]
        resolution = np.maximum(resolution, np.abs(scaled - np.round(scaled)).max(axis=1))
    # A microsecond where the last decimal is finer, which no motion notices: a clock that counts from 1970 is right to
    # 2e-7 s in a float.
    exact = np.flatnonzero(resolution < 0.03)
    decimal = 1 / float(DECIMALS[exact[0]]) if exact.size else 1e-6
    rounded = max(-low, high) <= max(1e-3 * period, min(decimal, 0.5 * period))
    # The earliest stamps are the least late: the clock is shifted to them.
    return period, offset if rounded else offset + low, high - low, rounded


def _roughness(time: np.ndarray, position: np.ndarray, clock: Clock) -> float:
    """Compute the typical residual (m or rad) of positions from cubics by a clock, where joints are fast."""
    off, speeds = [], []
    for start, stop in _parts(len(time)):
        instants = clock.instants(block(time, start, stop), start)
        positions = block(position, start, stop)
        off.append(np.abs(cubic_residuals(instants, positions, clock.period)))
        speeds.append(np.abs(positions[4:] - positions[:-4]))
    distance, speed = np.concatenate(off), np.concatenate(speeds)
    roughness = []
    for residual, moved in zip(distance.T, speed.T, strict=True):
        fast = moved > np.median(moved)
        if fast.any():
            roughness.append(np.median(residual[fast]) + 1e-4 * np.median(moved[fast]))
    return float(np.exp(np.mean(np.log(roughness)))) if roughness else 0.0


def sampled_steps(time: np.ndarray) -> np.ndarray:
    """Compute steps of the time column, of a long one in parts spread over it."""
    return np.concatenate([np.diff(block(time, *part)) for part in _parts(len(time))])


def _parts(samples: int) -> list[tuple[int, int]]:
    parts, size = LOOKED_AT
    if samples <= parts * size:
        return [(0, samples)]
    return [(int(start), int(start) + size) for start in np.linspace(0, samples - size, parts)]


def _find_gaps(time: np.ndarray, position: np.ndarray | None, usual: float, packets: bool) -> Gaps:
    """Find missing samples and their number, for regular sampling with late stamps.

    Where joints are fast enough, the positions count: a step twice as long as its neighbours has lost a sample, and one
    of length zero repeats it. Elsewhere, or without positions, the stamps do: a late one makes a long step and a short
    one after it, but a missing sample moves all stamps behind it. So a step is a gap by as much as the stamps around it
    are apart.
    """
    step, size, around = sampled_steps(time) / usual, 1, 1
    # Standard deviation of the stamps around a regular clock, in steps, from their differences.
    scatter = float(np.median(np.abs(step - np.median(step))) / 0.6745 / np.sqrt(2))
    if packets and len(edges := np.flatnonzero(step > LATE)) > 2:
        size = int(np.median(np.diff(edges)))
    if packets or scatter > 0.01:
        # The median of as many stamps on either side is then known to a fifth of a step, three times in a hundred.
        around = int(min(max(np.ceil(150 * scatter**2), FEWEST_AROUND, 3 * size), MOST_AROUND))
    position = position if around > 1 else None
    noise = None if position is None else _noise(position)
    gaps: list[tuple[int, int]] = []
    for start, stop in spans(len(time)):
        begin, end = max(start - around - 1, 0), min(stop + around, len(time))
        part = block(time, begin, end)
        step = np.diff(part)
        number = np.full(len(step), np.nan)  # of steps of the clock
        if position is not None and noise is not None:
            number = _steps_by_motion(block(position, begin, end), noise)
        unclear = np.isnan(number)
        number[unclear] = 1.0
        part -= usual * np.concatenate([[0.0], np.cumsum(number)])
        near, far = (around == 1) & (step < (1 - DOUBT) * usual), step > LATE * usual * size
        for k in np.flatnonzero(unclear & far) + 1:
            before, after = k, k
            while before > 1 and near[before - 2]:  # stamps that repeat the one before were early,
                before -= 1
            while after < len(near) and near[after]:
                after += 1
            after = k if after < len(far) and far[after] else after  # or this one was late
            moved = np.median(part[after : after + around]) - np.median(part[max(before - around, 0) : before])
            missing = max(int(moved / usual + 1 - DOUBT), 0)
            number[k - 1] += missing
            part[k:] -= missing * usual  # later samples are evaluated with this gap closed
        changed = np.flatnonzero(number != 1) + 1
        changed = changed[(begin + changed >= start) & (begin + changed < stop)]
        gaps += [(begin + int(k), int(number[k - 1]) - 1) for k in changed]
    return tuple(gaps)


def _noise(position: np.ndarray) -> np.ndarray:
    """Estimate the standard deviation (n,) of the positions' steps around their neighbours', and of their rounding."""
    parts = [np.diff(block(position, *part), axis=0) for part in _parts(len(position))]
    change = np.abs(np.concatenate([moved - _usual_steps(moved) for moved in parts]))
    sizes = np.abs(np.concatenate(parts))
    smallest = np.min(sizes, axis=0, where=sizes > 0, initial=np.inf)
    quantum = np.where(np.isfinite(smallest), smallest, 1.0)
    return np.asarray(np.median(change, axis=0) / 0.6745 + quantum / 3)


def _usual_steps(moved: np.ndarray) -> np.ndarray:
    from scipy.ndimage import median_filter

    return np.asarray(median_filter(moved, size=(NEIGHBOURS, 1), mode="nearest"))


def _steps_by_motion(position: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Estimate the clock steps between samples (M - 1,) from the joint motion; NaN where ambiguous."""
    moved = np.diff(position, axis=0) / noise
    usual = _usual_steps(moved)
    speed = (usual**2).sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        number = (moved * usual).sum(axis=1) / speed
    clear = (speed > CLEAR**2) & (number < LONGEST_BY_MOTION)
    return np.asarray(np.where(clear, np.maximum(np.round(number), 0.0), np.nan))


def cubic_residuals(instants: np.ndarray, position: np.ndarray, period: float) -> np.ndarray:
    """Compute the residuals (N - 4, n) of positions (N, n) from the cubics through two neighbours on either side."""
    around = [slice(k, len(position) - 2 * REACH + k) for k in (0, 1, 3, 4)]
    apart = np.array([instants[neighbours] for neighbours in around]) - instants[REACH:-REACH]
    apart += 1e-9 * period * np.array([-2, -1, 1, 2])[:, None]  # equal stamps
    predicted = np.zeros_like(position[REACH:-REACH])
    for a, at in enumerate(around):
        weight = np.prod([apart[b] / (apart[b] - apart[a]) for b in range(4) if b != a], axis=0)
        predicted += weight[:, None] * position[at]
    return np.asarray(position[REACH:-REACH] - predicted)
