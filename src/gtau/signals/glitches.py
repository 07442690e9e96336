"""Position glitches: up to three samples of a joint that are off, between others that go smoothly past them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gtau.signals.held import Held
from gtau.signals.notes import Kind, Note
from gtau.signals.quantiles import Quantiles
from gtau.signals.samples import Samples
from gtau.signals.smoothness import REACH, WHITE, cubic_residuals
from gtau.signals.storage import block, spans, store

WIDEST = 3  # samples; positions that stay away longer are a slip, which is refused
NEIGHBOURS = 6  # samples nearest to them, through which a cubic is fitted
# A glitch is so many scales off that cubic. A scale is the largest of what 95 % of the samples are off a cubic through
# four neighbours (white noise of standard deviation s: 2 s), of the smallest change of the position, and of what the
# neighbours are off their own cubic.
# And it is so many times as far off as the joint moves in a step there: what is less may be a wrong time of the sample.
# In 47 shared logs of ten robots nothing is off by 4 scales and one step: what is off by more scales (a stale sample of
# a Panda polled at 30 Hz, the begin of a motion without noise) is less than a step off, what is off by 1.25 steps less
# than 4 scales. Nor is anything in 480 logs of benchmarks/preparation_study.py, up to 1 kHz. Of samples put off in
# those all of 0.1 rad are found, and of 0.01 rad at 1 kHz; at 50 Hz, where a joint moves 0.02 rad in a step, one in
# eight. What is missed does little: on the UR10e and Orthoglide logs a sample that is off by 1 % of the joint's range
# moves no gain by more than 0.15 of its standard deviation.
SCALES, STEPS = 6.0, 1.5
SHARE = 0.95


@dataclass(frozen=True)
class Glitch:
    """A ``sample`` (its number in the log) of a ``joint`` (by number) that is off, and the ``value`` expected there."""

    sample: int
    joint: int
    value: float


def find_glitches(samples: Samples, instants: np.ndarray, held: Held) -> tuple[Glitch, ...]:
    """Find samples whose position is off while those around agree with each other; the log goes by twice.

    Parameters
    ----------
    samples : Samples
        The log, its angles unwrapped.
    instants : ndarray
        (N,) When the samples were taken, s.
    held : Held
        How positions are held: stale samples do not count.

    Returns
    -------
    tuple of Glitch
        In order.
    """
    usual, steps = Quantiles(len(held.quanta)), Quantiles(1)
    for numbers, time, position, mine in _blocks(samples, instants, held):
        if len(numbers) > 2 * REACH:
            off = np.abs(cubic_residuals(time, position, float(np.diff(time).mean())))
            usual.add(off[mine[REACH:-REACH]])
            steps.add(np.diff(time)[mine[1:], None])
    period = float(steps.quantile(0.5)[0])
    scale = np.maximum(usual.quantile(SHARE) / WHITE, held.quanta)
    found: list[Glitch] = []
    for numbers, time, position, mine in _blocks(samples, instants, held):
        if len(numbers) < NEIGHBOURS + WIDEST:
            continue
        off = np.abs(cubic_residuals(time, position, period))
        for j, column in enumerate(position.T):
            for k, value in _of_joint(time, column, off[:, j], float(scale[j]), period):
                if mine[k]:
                    until = numbers[k + 1] if k + 1 < len(numbers) else numbers[k] + 1
                    # Samples that repeat a glitch are as wrong.
                    found += [Glitch(number, j, value) for number in range(int(numbers[k]), int(until))]
    return tuple(sorted(found, key=lambda each: (each.sample, each.joint)))


def _blocks(
    samples: Samples, instants: np.ndarray, held: Held
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Yield numbers, instants and positions of fresh samples in blocks, with those around, and which are inside."""
    margin = 2 * (NEIGHBOURS + WIDEST) * (1 if held.by_chance else held.longest)
    for start, stop in spans(len(samples.time)):
        begin, end = max(0, start - margin), min(len(samples.time), stop + margin)
        position = block(samples.position, begin, end)
        fresh = held.fresh(position)
        numbers = begin + np.flatnonzero(fresh)
        yield numbers, block(instants, begin, end)[fresh], position[fresh], (numbers >= start) & (numbers < stop)


def _of_joint(
    time: np.ndarray, position: np.ndarray, off: np.ndarray, scale: float, period: float
) -> list[tuple[int, float]]:
    """List the samples of one joint (M,) that are off, by number, with the values expected there."""
    near = np.flatnonzero(off > SCALES / 2 * scale) + REACH  # of two and three samples every one is off by half
    ends = [*range(REACH), *range(len(time) - REACH, len(time))]
    found: list[tuple[float, int, np.ndarray]] = []  # how clearly, first sample, values
    for width in range(1, WIDEST + 1):
        first = np.unique((np.r_[near, ends][:, None] - np.arange(width)).ravel())
        first = first[(first >= 0) & (first <= len(time) - width)]
        excess, clarity, values = _judge(time, position, first, width, scale, period)
        for k in np.flatnonzero(excess >= SCALES).tolist():
            found.append((float(clarity[k]), int(first[k]), values[k]))
    chosen: dict[int, float] = {}
    for _, at, value in sorted(found, key=lambda each: -each[0]):
        taken = range(at, at + len(value))
        if not chosen.keys() & set(taken):
            chosen |= dict(zip(taken, value.tolist(), strict=True))
    return sorted(chosen.items())


def _judge(
    time: np.ndarray, position: np.ndarray, first: np.ndarray, width: int, scale: float, period: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compare ``width`` samples from each of ``first`` (C,) with the cubic through their neighbours.

    Returns how many scales the first and the last of them are off (C,), 0 where that is a matter of time; the same in
    residuals of the neighbours; and the cubic's values (C, width).
    """
    count = NEIGHBOURS + width
    lowest = np.clip(first - NEIGHBOURS // 2, 0, len(time) - count)
    window = lowest[:, None] + np.arange(count)
    inside = (window >= first[:, None]) & (window < first[:, None] + width)
    others, own = window[~inside].reshape(-1, NEIGHBOURS), window[inside].reshape(-1, width)
    centre = time[own].mean(axis=1, keepdims=True)
    reach = np.abs(time[others] - centre).max(axis=1, keepdims=True)

    def powers(at: np.ndarray) -> np.ndarray:
        return ((time[at] - centre) / reach)[..., None] ** np.arange(4)

    fit = np.linalg.pinv(powers(others))  # (C, 4, NEIGHBOURS)
    weights = powers(own) @ fit  # (C, width, NEIGHBOURS)
    around = position[others]
    values = (weights @ around[..., None])[..., 0]
    # The smaller of both ends, in the units of the noise of one sample.
    ends = (position[own] - values)[:, [0, -1]]
    distance = (np.abs(ends) / np.sqrt(1 + (weights[:, [0, -1]] ** 2).sum(axis=2))).min(axis=1)
    misfit = np.abs(around - (powers(others) @ (fit @ around[..., None]))[..., 0]).max(axis=1)
    clean = position[window]
    clean[inside] = values.ravel()
    moved = np.abs(np.diff(clean, axis=1)).max(axis=1)
    whole = time[window[:, -1]] - time[window[:, 0]] < 2 * (count - 1) * period  # where none are missing
    of_its_own = whole & (np.abs(ends).min(axis=1) > STEPS * moved)
    excess = np.where(of_its_own, distance / np.maximum(misfit, scale), 0.0)
    return excess, distance / np.maximum(misfit, 1e-3 * scale), values


def without_glitches(samples: Samples, glitches: Sequence[Glitch]) -> Samples:
    """Put the expected values in place of glitches, as those of up to three missing samples are interpolated."""
    if not glitches:
        return samples

    def parts() -> Iterator[np.ndarray]:
        for start, stop in spans(len(samples.position)):
            part = block(samples.position, start, stop)
            for each in glitches:
                if start <= each.sample < stop:
                    part[each.sample - start, each.joint] = each.value
            yield part

    return replace(samples, position=store(parts(), samples.position.shape[1:]))


def note_on(samples: Samples, glitches: Sequence[Glitch]) -> Note:
    """Say how many glitches there are, in which joints, and what the first looks like; ``samples`` still hold them."""
    names, first = samples.source.joints, glitches[0]
    counts = {names[j]: sum(each.joint == j for each in glitches) for j in sorted({each.joint for each in glitches})}
    time, logged = float(samples.time[first.sample]), float(samples.position[first.sample, first.joint])
    at = f"at {time:.9g} s ({samples.place(first.sample)})"
    if len(glitches) == 1:
        what = f"interpolated 1 position of joint '{names[first.joint]}' that jumps and comes back: {at} it is"
    elif len(counts) == 1:
        what = f"interpolated {len(glitches)} positions of joint '{names[first.joint]}' that jump and come back: "
        what += f"the first, {at}, is"
    else:
        listed = ", ".join(f"'{joint}' ({count})" for joint, count in counts.items())
        what = f"interpolated {len(glitches)} positions of joints {listed} that jump and come back: "
        what += f"the first, of '{names[first.joint]}' {at}, is"
    return Note(
        Kind.REPAIR,
        f"{what} {logged:.4g} instead of {first.value:.4g} (rad or m)",
        "check the encoder and its cable, and how missing values are written",
        joint=names[first.joint] if len(counts) == 1 else "",
        time=time,
        share=len(glitches) / len(samples.time),
    )
