"""Faults of logged positions: outliers, jumps, frozen encoders."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from gtau.errors import GtauError, quoted
from gtau.findings import Finding, counted, moment
from gtau.signals.reading.formats import repair
from gtau.signals.reading.samples import Samples, extremes
from gtau.signals.repair.clock import REACH, WHITE, cubic_residuals
from gtau.signals.repair.resampling import MISSING_STEP, Held, long_runs
from gtau.signals.storage import block, blocks, spans, stored_like, stride_of

WIDEST = 3  # samples; positions that stay away longer are a slip, which is refused
NEIGHBOURS = 6  # samples nearest to them, through which a cubic is fitted
# A glitch is SCALES scales off that cubic, and STEPS times as far off as the joint moves in a step there: less may be a
# wrong time of the sample. A scale is the largest of what 95 % of the samples are off a cubic through four neighbours
# (white noise of standard deviation s: 2 s), of the smallest change of the position, and of what the neighbours are off
# their own cubic.
SCALES, STEPS = 6.0, 1.5
SHARE = 0.95
LARGEST_SPEED = 1e3  # rad/s or m/s; of a joint
SLIP = 20.0  # times what 99.9 % of the samples show: a larger change of speed between two samples is not a motion
SLIP_SPEED = 0.5  # and in shares of the joint's speed
SLIP_QUANTA = 3.0  # and in smallest changes of its position: a joint at rest, shaken by others, moves by one
SLIP_RANGE = 1e-3  # and of its range; a jump of 2e-4 rad in a log of an xMate7 does no harm
# A position freezes where it is constant for longer than FROZEN samples and FROZEN_TIME (s) after or before a step
# of FROZEN_QUANTA of its smallest changes and FROZEN_SPEED of its fastest steps, larger than 99.9 % of the changes of
# its steps, while the current varies by FROZEN_CURRENT of its standard deviation.
FROZEN_TIME, FROZEN_QUANTA, FROZEN_SPEED, FROZEN_CURRENT = 0.1, 10.0, 0.15, 0.1

Glitches = Mapping[tuple[int, int], float]
"""Positions expected in place of outliers, by the numbers of sample and joint."""


def find_glitches(samples: Samples, instants: np.ndarray, held: Held) -> Glitches:
    """Find outliers of positions (unwrapped) between mutually consistent neighbours that are not stale."""
    stride = stride_of(len(samples.time))
    usual, steps = list[np.ndarray](), list[np.ndarray]()
    for numbers, time, position, mine in _fresh_blocks(samples, instants, held):
        if len(numbers) > 2 * REACH:
            off = np.abs(cubic_residuals(time, position, float(np.diff(time).mean())))
            usual.append(off[mine[REACH:-REACH]][::stride].copy())  # a view would keep all of it
            steps.append(np.diff(time)[mine[1:]][::stride].copy())
    if not any(map(len, usual)):
        return {}
    period = float(np.median(np.concatenate(steps)))
    scale = np.maximum(np.quantile(np.concatenate(usual), SHARE, axis=0) / WHITE, held.quanta)
    glitches: dict[tuple[int, int], float] = {}
    for numbers, time, position, mine in _fresh_blocks(samples, instants, held):
        if len(numbers) < NEIGHBOURS + WIDEST:
            continue
        off = np.abs(cubic_residuals(time, position, period))
        following = np.r_[numbers[1:], numbers[-1] + 1]
        for j, column in enumerate(position.T):
            for k, value in _joint_outliers(time, column, off[:, j], float(scale[j]), period):
                if mine[k]:  # samples that repeat a glitch are as wrong
                    glitches |= {(number, j): value for number in range(int(numbers[k]), int(following[k]))}
    return dict(sorted(glitches.items()))


def _fresh_blocks(
    samples: Samples, instants: np.ndarray, held: Held
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Yield numbers, instants and positions of fresh samples in blocks with margins, and mark the block."""
    margin = 2 * (NEIGHBOURS + WIDEST) * held.longest
    for start, stop in spans(len(samples.time)):
        begin, end = max(0, start - margin), min(len(samples.time), stop + margin)
        position = block(samples.position, begin, end)
        fresh = held.fresh(position)
        numbers = begin + np.flatnonzero(fresh)
        yield numbers, block(instants, begin, end)[fresh], position[fresh], (numbers >= start) & (numbers < stop)


def _joint_outliers(
    time: np.ndarray, position: np.ndarray, off: np.ndarray, scale: float, period: float
) -> list[tuple[int, float]]:
    """List the outliers of one joint (M,), by sample number, with the values expected there."""
    near = np.flatnonzero(off > SCALES / 2 * scale) + REACH  # of two and three samples every one is off by half
    ends = [*range(REACH), *range(len(time) - REACH, len(time))]
    outliers: list[tuple[float, int, np.ndarray]] = []  # significance, first sample, values
    for width in range(1, WIDEST + 1):
        first = np.unique((np.r_[near, ends][:, None] - np.arange(width)).ravel())
        first = first[(first >= 0) & (first <= len(time) - width)]
        excess, clarity, values = _judge(time, position, first, width, scale, period)
        for k in np.flatnonzero(excess >= SCALES).tolist():
            outliers.append((float(clarity[k]), int(first[k]), values[k]))
    chosen: dict[int, float] = {}
    for _, at, value in sorted(outliers, key=lambda outlier: -outlier[0]):
        samples = range(at, at + len(value))
        if not chosen.keys() & set(samples):
            chosen |= dict(zip(samples, value.tolist(), strict=True))
    return sorted(chosen.items())


def _judge(
    time: np.ndarray, position: np.ndarray, first: np.ndarray, width: int, scale: float, period: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compare ``width`` samples from each of ``first`` (C,) with the cubic through their neighbours.

    Returns how many scales they are off at both ends (C,), 0 where that is a matter of time; the same in residuals of
    the neighbours; and the cubic's values (C, width).
    """
    count = NEIGHBOURS + width
    lowest = np.clip(first - NEIGHBOURS // 2, 0, len(time) - count)
    window = lowest[:, None] + np.arange(count)
    inside = (window >= first[:, None]) & (window < first[:, None] + width)
    around, judged = window[~inside].reshape(-1, NEIGHBOURS), window[inside].reshape(-1, width)
    centre = time[judged].mean(axis=1, keepdims=True)
    reach = np.abs(time[around] - centre).max(axis=1, keepdims=True)

    def powers(at: np.ndarray) -> np.ndarray:
        return ((time[at] - centre) / reach)[..., None] ** np.arange(4)

    fit = np.linalg.pinv(powers(around))  # (C, 4, NEIGHBOURS)
    weights = powers(judged) @ fit  # (C, width, NEIGHBOURS)
    neighbours = position[around]
    values = (weights @ neighbours[..., None])[..., 0]
    # The smaller of both ends, in the units of the noise of one sample.
    ends = (position[judged] - values)[:, [0, -1]]
    distance = (np.abs(ends) / np.sqrt(1 + (weights[:, [0, -1]] ** 2).sum(axis=2))).min(axis=1)
    misfit = np.abs(neighbours - (powers(around) @ (fit @ neighbours[..., None]))[..., 0]).max(axis=1)
    clean = position[window]
    clean[inside] = values.ravel()
    moved = np.abs(np.diff(clean, axis=1)).max(axis=1)
    gapless = time[window[:, -1]] - time[window[:, 0]] < 2 * (count - 1) * period  # where none are missing
    real = gapless & (np.abs(ends).min(axis=1) > STEPS * moved)
    excess = np.where(real, distance / np.maximum(misfit, scale), 0.0)
    return excess, distance / np.maximum(misfit, 1e-3 * scale), values


def without_glitches(samples: Samples, glitches: Glitches) -> Samples:
    """Replace glitches by the expected values, as up to three missing samples are interpolated."""

    def parts() -> Iterator[np.ndarray]:
        for start, stop in spans(len(samples.position)):
            part = block(samples.position, start, stop)
            for (sample, joint), value in glitches.items():
                if start <= sample < stop:
                    part[sample - start, joint] = value
            yield part

    return replace(samples, position=stored_like(samples.position, parts()))


def glitch_note(samples: Samples, glitches: Glitches) -> Finding:
    """Report number and joints of the glitches, and the first one; ``samples`` still hold them."""
    names, ((sample, j), value) = samples.joints, next(iter(glitches.items()))
    counts = Counter(names[joint] for joint in sorted(joint for _, joint in glitches))
    time = float(samples.time[sample])
    joints = ", ".join(f"{quoted(joint)} ({count})" for joint, count in counts.items())
    first = f"of {quoted(names[j])} at {moment(time)} ({samples.place(sample)})"
    text = (
        f"interpolated {counted(len(glitches), 'outlier')} among the positions of {joints}: the first, {first}, is "
        f"{samples.position[sample, j]:z.4g} instead of {value:z.4g} (rad or m)"
    )
    advice = "check the encoder and its cable, and how missing values are written"
    share = len(glitches) / len(samples.time)
    return repair("outliers", share, text=text, advice=advice, joints=tuple(counts), time=time)


def refuse_slips(samples: Samples, instants: np.ndarray, held: Held) -> None:
    """Refuse positions with a permanent jump between two samples, as after a slipped coupling or lost counts."""
    n, stride = len(samples.joints), stride_of(len(samples.time))
    usual, fast = list[np.ndarray](), list[np.ndarray]()
    largest, places, jumps = np.zeros(n), np.zeros(n, dtype=int), np.zeros(n)
    for begin, new, step, speed, change in _changes_of_speed(samples, instants, held):
        fast.append(np.abs(speed[new::stride]))
        usual.append(change[::stride].copy())
        for j, k in enumerate(np.argmax(change, axis=0) if len(change) else ()):
            if change[k, j] > largest[j]:
                jump = speed[k + 3, j] - (speed[k + 2, j] + speed[k + 4, j]) / 2
                largest[j], places[j], jumps[j] = change[k, j], begin + k + 4, jump * step[k + 3]
    usually, speeds = (np.quantile(np.concatenate(parts), 0.999, axis=0) for parts in (usual, fast))
    for j in np.flatnonzero(speeds > LARGEST_SPEED).tolist():
        raise GtauError(
            f"joint '{samples.joints[j]}' moves at {speeds[j]:.2g} (rad or m)/s, faster than any joint; "
            "give the units of its position and of the time (units: {position: ..., time: ...}).",
            source=samples.name,
        )
    low, high = extremes(samples.position)
    far = np.abs(jumps) > np.maximum(SLIP_RANGE * (high - low), SLIP_QUANTA * held.quanta)
    slips = np.flatnonzero((largest > SLIP * usually) & (largest > SLIP_SPEED * speeds) & far)
    if not slips.size:
        return
    j, k = int(slips[0]), int(places[slips[0]])
    together = [samples.joints[i] for i in slips if abs(places[i] - k) <= 1]
    at = f"at {samples.time[k]:.9g} s"
    what = (
        f"the position of joint '{samples.joints[j]}' jumps by {jumps[j]:.3g} (rad or m) {at}, which is not a "
        "motion; check the coupling and the counter of its encoder, or cut the log there into two runs"
    )
    if len(together) > 1:
        what = (
            f"the positions of joints {' and '.join(map(repr, together))} jump together {at}, so rows are missing, "
            "or all encoders were reset; cut the log there into two runs (from: and to:)"
        )
    raise GtauError(f"{samples.name}, {samples.place(k)}: {what}.")


def _changes_of_speed(
    samples: Samples, instants: np.ndarray, held: Held
) -> Iterator[tuple[int, int, np.ndarray, np.ndarray, np.ndarray]]:
    """Yield, by blocks, first sample, first new step, steps (M,), speeds (M, n) and lasting changes (M - 6, n)."""
    median = None
    for start, stop in spans(len(samples.time)):
        begin = max(0, start - 7 - held.longest)
        time, position = block(instants, begin, stop), block(samples.position, begin, stop)
        step = np.diff(time)
        median = float(np.median(step[step > 0])) if median is None else median
        # Equal stamps, of a sample that repeats the one before, are no step.
        moving, fresh = position, held.fresh(position)
        if not fresh.all():
            moving = np.column_stack([np.interp(time, time[fresh], column) for column in position[fresh].T])
        speed = np.diff(moving, axis=0) / np.maximum(step, 0.1 * median)[:, None]
        new = max(start - 1, 0) - begin  # earlier steps are in the block before, too
        if len(step) < 7:
            yield begin, new, step, speed, np.zeros((0, speed.shape[1]))
            continue
        over = (moving[4:-1] - moving[1:-4]) - (time[4:-1] - time[1:-4])[:, None] * (speed[:-4] + speed[4:]) / 2
        change = over / median
        regular = (step <= MISSING_STEP * median) & (step >= 0.5 * median)
        change[~np.all([regular[k : len(regular) - 4 + k] for k in range(5)], axis=0)] = 0.0
        three = np.stack([change[:-2], change[1:-1], change[2:]])
        same_way = (np.sign(three) == np.sign(three[1])).all(axis=0)
        yield begin, new, step, speed, np.where(same_way, np.abs(three).min(axis=0), 0.0)


def refuse_frozen(samples: Samples, instants: np.ndarray, held: Held) -> None:
    """Refuse a position that freezes in full motion while the command goes on, as of an encoder that is not read.

    A joint that comes to rest slows down: refused is one that is constant after or before a step of its usual size.
    """
    n, count, position = len(samples.joints), len(samples.time), samples.position
    stride, fast, usual = stride_of(count), [], []
    for part in blocks(position, before=1):
        steps = np.diff(part[held.fresh(part)], axis=0)
        fast.append(np.abs(steps[::stride]))
        usual.append(np.abs(np.diff(steps, axis=0)[::stride]))
    edges, spells = np.zeros(n), np.zeros((n, 2), dtype=int)
    for j, begin, end in long_runs(position):
        edge = max((abs(position[k, j] - position[k - 1, j]) for k in (begin, end) if 0 < k < count), default=0.0)
        if edge > edges[j]:
            edges[j], spells[j] = edge, (begin, end)
    speeds, changes = (np.quantile(np.concatenate(parts), 0.999, axis=0) for parts in (fast, usual))
    sudden = (edges > FROZEN_QUANTA * held.quanta) & (edges > FROZEN_SPEED * speeds) & (edges > changes)
    for j in np.flatnonzero(sudden).tolist():
        begin, end = spells[j].tolist()
        lasts, command = float(instants[end - 1] - instants[begin]), samples.command[:, j]
        if lasts > FROZEN_TIME and np.std(command[begin:end]) > FROZEN_CURRENT * np.std(command):
            raise GtauError(
                f"{samples.name}, {samples.place(begin)}: the position of joint '{samples.joints[j]}' stays at "
                f"{position[begin, j]:.6g} (rad or m) for {lasts:.3g} s from {samples.time[begin]:.9g} s, "
                f"with a step of {edges[j]:.2g} (rad or m) between two samples, while its "
                f"{samples.channels[j].kind.name} varies: its encoder was not read; log again, or leave out that part "
                "('from' and 'to' of the run)."
            )
