"""Samples that a regular clock lacks: gaps, found by the motion of the joints or by the stamps around them."""

from __future__ import annotations

import numpy as np

from gtau.signals.storage import block, spans

LATE = 1.5  # usual steps, beyond which samples may be missing
PACKET = 0.2  # share of samples whose stamps follow within a tenth of a step: they came in packets
FEWEST_AROUND, MOST_AROUND = 20, 400  # samples to either side from which a gap is judged
NEIGHBOURS = 21  # steps whose median is the usual one; where motions change faster, no step is clear
CLEAR = 8.0  # standard deviations of a step of the joints' motion, where it tells one step from two
LONGEST_BY_MOTION = 5.5  # steps over which the speed is taken to be constant
DOUBT = 0.7  # of a step: stamps that move by less have lost no sample
LOOKED_AT = 16, 4096  # parts of a log, and samples in each, that are looked at


def sampled_steps(time: np.ndarray) -> np.ndarray:
    """Compute steps of the time column, of a long one in parts spread over it."""
    parts = parts_of(len(time))
    return np.concatenate([np.diff(block(time, *part)) for part in parts])


def parts_of(samples: int) -> list[tuple[int, int]]:
    """Cut a log of so many samples into the parts that are looked at: all of it, or parts spread over a long one."""
    parts, size = LOOKED_AT
    if samples <= parts * size:
        return [(0, samples)]
    return [(int(start), int(start) + size) for start in np.linspace(0, samples - size, parts)]


def find_gaps(
    time: np.ndarray, position: np.ndarray | None, usual: float, packets: bool
) -> tuple[tuple[int, int], ...]:
    """Find samples before which others are missing, and how many, if samples are regular and stamps late.

    Where joints are fast enough, the positions count: a step twice as long as its neighbours has lost a sample, and one
    of length zero repeats it. Elsewhere the stamps do: a late one makes a long step and a short one after it, but a
    missing sample moves all stamps behind it. So a step is a gap by as much as the stamps around it are apart. Without
    positions they count everywhere.
    """
    scatter, size, around = _scatter(time, usual), 1, 1
    if packets:
        size = _packet(time, usual)
    if packets or scatter > 0.01:
        # The median of as many stamps on either side is then known to a fifth of a step, three times in a hundred.
        around = int(min(max(np.ceil(150 * scatter**2), FEWEST_AROUND, 3 * size), MOST_AROUND))
    noise = _noise(position) if around > 1 and position is not None else None
    found: list[tuple[int, int]] = []
    for start, stop in spans(len(time)):
        begin, end = max(start - around - 1, 0), min(stop + around, len(time))
        part, step = block(time, begin, end), np.diff(block(time, begin, end))
        steps = np.ones(len(step))
        if noise is not None and position is not None:
            steps = _steps_by_motion(block(position, begin, end), noise)
        part -= usual * np.concatenate([[0.0], np.cumsum(np.nan_to_num(steps, nan=1.0))])
        long = np.isnan(steps) | (noise is None)
        for k in np.flatnonzero(long & (step > LATE * usual * size)) + 1:
            moved = np.median(part[k : k + around]) - np.median(part[max(k - around, 0) : k])
            missing = int(moved / usual + 1 - DOUBT)
            steps[k - 1] = 1 + max(missing, 0)
            part[k:] -= max(missing, 0) * usual  # what follows is judged without this gap
        changed = np.flatnonzero(np.nan_to_num(steps, nan=1.0) != 1) + 1
        changed = changed[(begin + changed >= start) & (begin + changed < stop)]
        found += [(begin + int(k), int(steps[k - 1]) - 1) for k in changed]
    return tuple(found)


def _noise(position: np.ndarray) -> np.ndarray:
    """Estimate the standard deviation (n,) of the positions' steps around their neighbours', and of their rounding."""
    parts = [np.diff(block(position, *part), axis=0) for part in parts_of(len(position))]
    change = np.abs(np.concatenate([each - _usual_steps(each) for each in parts]))
    steps = np.abs(np.concatenate(parts))
    rounding = [np.min(each[each > 0], initial=np.inf) for each in steps.T]
    quantum = np.where(np.isfinite(rounding), rounding, 1.0)
    return np.asarray(np.median(change, axis=0) / 0.6745 + quantum / 3)


def _usual_steps(moved: np.ndarray) -> np.ndarray:
    """Compute the median (M, n) of the steps around each of the positions' steps."""
    from scipy.ndimage import median_filter

    return np.asarray(median_filter(moved, size=(NEIGHBOURS, 1), mode="nearest"))


def _steps_by_motion(position: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Count steps of a regular clock (M - 1,) between samples by how far the joints moved; NaN where ambiguous."""
    moved = np.diff(position, axis=0)
    usual = _usual_steps(moved)
    speed = ((usual / noise) ** 2).sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        steps = ((moved / noise) * (usual / noise)).sum(axis=1) / speed
    clear = (speed > CLEAR**2) & (steps < LONGEST_BY_MOTION)
    return np.asarray(np.where(clear, np.maximum(np.round(steps), 0.0), np.nan))


def _scatter(time: np.ndarray, usual: float) -> float:
    """Estimate the standard deviation of the stamps around a regular clock, in steps, from their differences."""
    steps = sampled_steps(time) / usual
    return float(np.median(np.abs(steps - np.median(steps))) / 0.6745 / np.sqrt(2))


def _packet(time: np.ndarray, usual: float) -> int:
    """Count the samples of a usual packet."""
    edges = np.flatnonzero(sampled_steps(time) > LATE * usual)
    return int(np.median(np.diff(edges))) if len(edges) > 2 else 1
