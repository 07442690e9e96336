"""Log checks: report safe repairs, refuse other faults, and cut a log at its gaps.

Missing samples are interpolated, so that filters have a uniform grid, and marked as not valid, so that no
regression row uses them. The log is read in blocks.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import compress

import numpy as np

from gtau.errors import GtauError
from gtau.findings import Finding, Grade, counted, moment
from gtau.signals.reading.columns import LARGEST_RATE, LEAST_RATE
from gtau.signals.reading.formats import listed_joints, reading, repair
from gtau.signals.reading.samples import MAX_MISSING, MIN_SAMPLES, Ends, Samples, extremes, refuse_short
from gtau.signals.reading.units import COMMON
from gtau.signals.repair.clock import Clock, Given, clock_of, sampled_steps
from gtau.signals.repair.commands import clipped, refuse_held, refuse_magnitudes, whole_numbers, window_of_commands
from gtau.signals.repair.faults import find_glitches, glitch_note, refuse_frozen, refuse_slips, without_glitches
from gtau.signals.repair.resampling import FROZEN, MAX_GAP, POSITIONS, holds_of, uniform
from gtau.signals.storage import block, blocks, rows_at, spans, steps, stored_like, stride_of

AHEAD = 2.5  # steps by which the time of a row may be behind an earlier row, as where two packets change places
# s, and of the longest part; parts of a log between gaps that are shorter are left out, as filters take their ends
SHORTEST, SHARE = 1.0, 0.1
# A dropout without a gap in time is a step of OFTEN times what 99.9 % of the samples show, after rows that repeat the
# last one in all columns; or one that two joints and more, all that are not slower than SLOW of the fastest, would take
# in the same time at their speeds around it, up to a factor of ALIKE, as a coupling that slips is of one joint.
OFTEN, SLOW, ALIKE = 5.0, 0.2, 1.5
AROUND = 4  # samples before and after a step from which speeds are taken
LATEST = 0.25  # s; maximum lateness of the stamps of packets or messages
LARGEST_VALUE = 1e9  # of any logged value; even encoder and converter counts are smaller


def check(
    samples: Samples, notes: list[Finding], given: Given = None
) -> tuple[Samples, np.ndarray, float, float | None, float]:
    """Check the complete samples of a log, repair what is safe, and put them on a uniform grid.

    Returns the samples; which commands (N, c) were neither interpolated nor clipped; the share of whole numbers among
    the joints' commands as logged; the window (s) of a moving average that had smoothed them; and the rate (Hz) at
    which the slowest held signal changes. ``notes`` report every repair; the clock may be ``given``.
    """
    ends = extremes(samples.command)  # repairs leave them
    _refuse_stuck(samples, ends, notes)
    samples = in_order(samples, notes, given)
    clock = clock_of(samples.time, samples.position, given)
    _refuse_rates(samples, clock)
    if given is None and clock.late > max(LATEST, 3 * clock.period):
        raise GtauError(
            f"{samples.name}, column '{samples.columns[-1]}': by a regular clock of {clock.rate:.4g} Hz the time "
            f"stamps are up to {clock.late:.3g} s late, so they freeze or jump; correct the column, or give the rate "
            "instead (time: {rate: HZ})."
        )
    samples = _unwrapped(samples, notes)
    instants, holds = clock.instants(samples.time), holds_of(samples)
    if glitches := find_glitches(samples, instants, holds[POSITIONS]):
        notes.append(glitch_note(samples, glitches))
        samples = without_glitches(samples, glitches)
        clock = clock_of(samples.time, samples.position, given)
        instants, holds = clock.instants(samples.time), holds_of(samples)
    refuse_frozen(samples, instants, holds[POSITIONS])
    refuse_slips(samples, instants, holds[POSITIONS])
    refuse_held(samples, instants, holds, ends)
    refuse_magnitudes(samples, ends)
    clips = clipped(samples, ends, holds, notes)
    whole_share = whole_numbers(samples.command, len(samples.joints))  # resampled ones are between
    window = window_of_commands(samples.command, clock.rate)
    updates = clock.rate / max(held.period for held in holds.values())
    samples, valid = uniform(samples, clock, instants, holds, clips, notes, given is not None)
    return samples, valid, whole_share, window, updates


def _refuse_stuck(samples: Samples, ends: Ends, notes: list[Finding]) -> None:
    n, time = len(samples.joints), samples.time
    low, high = (np.concatenate(pair) for pair in zip(extremes(samples.position), ends, strict=True))
    for column, least, most in zip(samples.columns, low, high, strict=False):
        if abs(value := max(most, least, key=abs)) > LARGEST_VALUE:
            raise GtauError(
                f"{samples.name}, column '{column}' reaches {value:.3g}, which is implausible for a joint or drive; "
                f"correct the column, or give its unit."
            )
    still = (low == high)[:n]
    if still.all():
        raise GtauError("no position ever changes; give a log of a moving robot.", source=samples.name)
    for channel, column, least, most in zip(samples.channels, samples.columns[n:-1], low[n:], high[n:], strict=True):
        if least < most or not channel.kind.measures_joint:
            continue
        if channel.kind.link_side or not still[channel.row]:  # a locked joint may have no current
            raise GtauError(
                f"{samples.name}, column '{column}' (joint '{channel.joint}') is stuck at {least + 0.0:g}; "
                "give the column with the measured values, or record the log again."
            )
    resting = compress(samples.channels, still)
    if names := tuple(channel.joint for channel in resting if channel.kind.measures_joint):
        text = f"the position of {listed_joints(names)} never changes: it yields no rows"
        kind, rest = "position that never changes", "joint at rest"
        notes.append(Finding(kind, names, text=text, grade=Grade.INFORMATION, shown_as=rest))
    back = np.flatnonzero((step := np.diff(time)) < 0)
    if len(back) == 1 and 0 < time[0] - time[-1] < 2 * np.median(step):  # the end joins the beginning
        at = int(back[0])
        raise GtauError(
            f"{samples.name}, {samples.place(at + 1)}: time goes back from {moment(time[at])} to {moment(time[at + 1])}"
            " and ends where it begins, as in a ring buffer; sort the rows by time."
        )
    if not time[-1] > time[0]:
        raise GtauError(
            f"{samples.name}, column '{samples.columns[-1]}' is {time[-1]:.9g} s in the last row and {time[0]:.9g} s "
            "in the first, so time does not advance; give the time column (with the date where a clock passed "
            "midnight, time: DATE + TIME), or the rate instead (time: {rate: HZ})."
        )


def _unwrapped(samples: Samples, notes: list[Finding]) -> Samples:
    """Unwrap the angles of joints that jump by a full turn: none moves a turn, or 6 m, between two samples."""
    position = samples.position
    jumps = [np.any(np.abs(np.abs(step) - 2 * np.pi) < 0.5, axis=0) for step in steps(position)]
    wraps = np.any(jumps, axis=0)
    if not wraps.any():
        return samples
    joints = tuple(compress(samples.joints, wraps))
    text = f"unwrapped the angle{'s' * (len(joints) > 1)} of {listed_joints(joints)}, which jumped by a turn"
    notes.append(reading("unwrapped angle", text=text, joints=joints))

    def unwrapped() -> Iterator[np.ndarray]:
        turns = np.zeros(len(wraps))  # as far as the sample before
        for k, part in enumerate(blocks(position, before=1)):
            more = np.where(wraps, np.unwrap(part, axis=0), part) + turns
            turns = more[-1] - part[-1]
            yield more[min(k, 1) :]

    return replace(samples, position=stored_like(position, unwrapped()))


def _refuse_rates(samples: Samples, clock: Clock) -> None:
    if LEAST_RATE <= clock.rate <= LARGEST_RATE:
        return
    column = samples.columns[-1]
    times = COMMON["time"].items()
    finer = (unit for unit, factor in times if factor < 1 and LEAST_RATE <= clock.rate / factor <= LARGEST_RATE)
    remedy = "write the controller's rate in Hz under signals.time"
    if column != "rate":
        remedy = (
            f"give the unit of that column (units: {{time: {' or '.join(finer) or 's'}}}, for all logs; convert one "
            "that differs from the others)"
        )
    raise GtauError(
        f"by its '{column}' it is sampled at {clock.rate:.3g} Hz (steps of {clock.period:.3g} s), which is not a "
        f"plausible sampling rate; {remedy}.",
        source=samples.name,
    )


def parts_between_gaps(samples: Samples, notes: list[Finding], given: Given = None) -> list[Samples]:
    """Cut the complete samples of a log, repeated ones dropped, at gaps that are too long to be bridged.

    Parts in which nothing moves, or that are shorter than a second, 100 samples or SHARE of the longest one, which is
    kept, are left out.
    """
    if not samples.time[-1] > samples.time[0]:
        return [samples]
    samples = in_order(samples, notes, given)
    count, clock = len(samples.time), clock_of(samples.time, samples.position, given)
    if not LEAST_RATE <= clock.rate <= LARGEST_RATE:
        return [samples]
    shortest = max(MAX_GAP, 3 * clock.period)
    gaps = {k: k for k in clock.beyond(samples.time, shortest)} | _dropouts(samples, shortest / clock.period)
    if not gaps:
        return [samples]
    gaps = dict(sorted(gaps.items()))
    ends = zip([0, *gaps.values()], [*gaps, count], strict=True)
    pieces = [samples.piece(begin, end) for begin, end in ends if end > begin]
    longest_piece = max(pieces, key=lambda piece: len(piece.time))
    enough = max(MIN_SAMPLES, int(SHARE * len(longest_piece.time)))

    def is_usable(piece: Samples) -> bool:
        low, high = extremes(piece.position)
        lasts = piece.time[-1] - piece.time[0]
        return bool(len(piece.time) >= enough and lasts >= SHORTEST and (low < high).any())

    kept = list(filter(is_usable, pieces)) or [longest_piece]
    lost, last = count - sum(len(piece.time) for piece in kept), min(gaps) - 1
    longest = max(float(samples.time[after] - samples.time[first - 1]) for first, after in gaps.items())
    time, s = float(samples.time[last]), "s" * (len(gaps) > 1)
    text = (
        f"cut the log at {len(gaps)} gap{s} or dropout{s}, the first after {time:.9g} s ({samples.place(last)}), the "
        f"longest of {longest:.3g} s, into {counted(len(kept), 'part')}{', each a run' * (len(kept) > 1)}"
    )
    if lost:
        short = "too short (a second, 100 rows, a tenth of the longest)"
        text += f"; {lost} rows that repeat the last one, or are in parts without motion or {short}, are left out"
    advice = "log every cycle of the controller"
    notes.append(repair("log cut at gaps", lost / count, text=text, advice=advice, time=time))
    return kept


def _dropouts(samples: Samples, shortest: float) -> dict[int, int]:
    """Find dropouts of at least ``shortest`` samples: their first sample, and the first after the rows that repeat."""
    position, command, stride = samples.position, samples.command, stride_of(len(samples.time))
    usual = np.quantile(np.concatenate([np.abs(step[::stride]) for step in steps(position)]), 0.999, axis=0)
    usual[usual == 0] = np.inf

    def repeats(row: int) -> bool:
        return all((array[row] == array[row - 1]).all() for array in (position, command))

    dropouts, start = {}, 1
    for step in steps(position):
        for k in (start + np.flatnonzero((np.abs(step) / OFTEN > usual).any(axis=1))).tolist():
            first = k
            while first > 1 and repeats(first - 1):
                first -= 1
            if first <= AROUND or k + AROUND >= len(position):
                continue
            moved = (position[k] - position[k - 1]) / usual
            speed = (position[first - 1] - position[first - 1 - AROUND] + position[k + AROUND] - position[k]) / usual
            fast = np.abs(speed) > SLOW * np.abs(speed).max()
            lasting = 2 * AROUND * moved[fast] / speed[fast]  # samples
            alike = fast.sum() > 1 and lasting.min() > shortest and lasting.max() < ALIKE**2 * lasting.min()
            if alike or k - first > max(FROZEN, shortest):
                dropouts[first] = k
        start += len(step)
    return dropouts


def in_order(samples: Samples, notes: list[Finding], given: Given) -> Samples:
    """Put rows that come late, twice or a step behind their time in order, and drop repeated rows.

    If the positions are smoother in the order of the rows, the stamps are wrong and never fall.
    """
    time, count = samples.time, len(samples.time)
    if not any((step < 0).any() for step in steps(time)):
        return _without_repeated(samples, notes, given)
    latest, order = np.maximum.accumulate(time), np.argsort(time, kind="stable")
    table = np.column_stack([time, samples.position, samples.command])
    again = order[1:][(table[order[1:]] == table[order[:-1]]).all(axis=1)]
    moved = np.setdiff1d(np.flatnonzero(time < latest), again)
    behind = np.max((latest - time)[moved], initial=0.0)
    if len(again) + len(moved) > MAX_MISSING * count or behind > AHEAD * np.median(sampled_steps(time)):
        return _without_repeated(samples, notes, given)  # which refuses it
    if moved.size:
        low, high = extremes(samples.position)
        scaled = np.delete(samples.position / np.where(high > low, high - low, 1.0), again, axis=0)
        by_time = scaled[np.argsort(np.delete(time, again), kind="stable")]
        if np.abs(np.diff(by_time, axis=0)).sum() > np.abs(np.diff(scaled, axis=0)).sum():
            return _without_repeated(replace(samples, time=latest), notes, given)
        places = samples.table.places(samples.rows[moved[:5]], len(moved))
        text = f"put {counted(len(moved), 'row')} in the order of their times ({places})"
        notes.append(repair("rows out of order", len(moved) / count, text=text))
    return _without_repeated(samples.with_arrays(lambda array: array[order]), notes, given)


def _without_repeated(samples: Samples, notes: list[Finding], given: Given) -> Samples:
    """Drop samples with the time and values of the one before; other values at one time are late, unless ``given``."""
    time, repeated = samples.time, list[int]()
    for start, stop in spans(len(time), before=1):
        part = block(time, start, stop)
        step = np.diff(part)
        if (step < 0).any():
            i = int(np.argmax(step < 0))
            raise GtauError(
                f"{samples.name}, {samples.place(start + i + 1)}: time goes back from {part[i]:.9g} s to "
                f"{part[i + 1]:.9g} s; cut the log there into two runs, or correct the time column."
            )
        again = np.flatnonzero(step == 0)
        if not again.size:
            continue
        values = np.column_stack([block(array, start, stop) for array in (samples.position, samples.command)])
        different = again[(values[again] != values[again + 1]).any(axis=1)]
        if different.size and given != "stamps":
            return samples
        if different.size:
            i = int(different[0])
            raise GtauError(
                f"{samples.name}, {samples.place(start + i + 1)}: the time {part[i]:.9g} s occurs in two rows with "
                "different values, so the time stamps are not the sampling instants; remove 'clock: stamps'."
            )
        repeated += (start + again + 1).tolist()
    if not repeated:
        return samples
    places = samples.table.places(samples.rows[repeated[:5]], len(repeated))
    text = f"dropped {counted(len(repeated), 'repeated row')} ({places})"
    notes.append(repair("repeated rows", len(repeated) / len(time), text=text))
    refuse_short(samples.name, len(time) - len(repeated))
    kept = np.setdiff1d(np.arange(len(time)), repeated)
    return samples.with_arrays(lambda array: rows_at(array, kept))
