"""Rows out of order or twice, and gaps at which a log is cut into parts."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from gtau.errors import GtauError
from gtau.findings import Finding
from gtau.findings.words import counted
from gtau.signals.reading.columns import LARGEST_RATE, LEAST_RATE
from gtau.signals.reading.notes import repair
from gtau.signals.reading.samples import MAX_MISSING, MIN_SAMPLES, Samples, extremes, refuse_short
from gtau.signals.repair.clock import clock_of, sampled_steps
from gtau.signals.repair.resampling import FROZEN, MAX_GAP
from gtau.signals.storage import block, blocks, rows_at, spans, stride_of

Given = Literal["stamps", "regular"] | None
AHEAD = 2.5  # steps by which the time of a row may be behind an earlier row, as where two packets change places
# s, and of the longest part; parts of a log between gaps that are shorter are left out, as filters take their ends
SHORTEST, SHARE = 1.0, 0.1


# A dropout without a gap in time is a step of OFTEN times what 99.9 % of the samples show, after rows that repeat the
# last one in all columns; or one that two joints and more, all that are not slower than SLOW of the fastest, would take
# in the same time at their speeds around it, up to a factor of ALIKE, as a coupling that slips is of one joint. In 44
# shared logs of ten robots there is none, nor a gap.
OFTEN, SLOW, ALIKE = 5.0, 0.2, 1.5
AROUND = 4  # samples before and after a step from which speeds are taken


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
    enough = max(MIN_SAMPLES, int(SHARE * max(len(piece.time) for piece in pieces)))
    kept = [piece for piece in pieces if len(piece.time) >= enough and _is_usable(piece)]
    kept = kept or [max(pieces, key=lambda piece: len(piece.time))]
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
    notes.append(
        repair("log cut at gaps", lost / count, text=text, advice="log every cycle of the controller", time=time)
    )
    return kept


def _dropouts(samples: Samples, shortest: float) -> dict[int, int]:
    """Find the first sample of each dropout of at least ``shortest`` samples, and the first one after it.

    They are the same where its rows are missing, and different where they repeat the last one.
    """
    position, command, stride = samples.position, samples.command, stride_of(len(samples.time))
    steps = [np.abs(np.diff(part, axis=0)[::stride]) for part in blocks(position, before=1)]
    usual = np.quantile(np.concatenate(steps), 0.999, axis=0)
    usual[usual == 0] = np.inf
    dropouts = {}
    for start, stop in spans(len(position), before=1):
        large = np.abs(np.diff(block(position, start, stop), axis=0)) > OFTEN * usual
        for k in (start + 1 + np.flatnonzero(large.any(axis=1))).tolist():
            first = k
            while first > 1 and _equal(position, first - 1) and _equal(command, first - 1):
                first -= 1
            if first <= AROUND or k + AROUND >= len(position):
                continue
            moved = (position[k] - position[k - 1]) / usual
            speed = (position[first - 1] - position[first - 1 - AROUND] + position[k + AROUND] - position[k]) / usual
            fast = np.abs(speed) > SLOW * np.abs(speed).max()
            taken = 2 * AROUND * moved[fast] / speed[fast]  # samples
            alike = fast.sum() > 1 and taken.min() > shortest and taken.max() < ALIKE**2 * taken.min()
            if alike or k - first > max(FROZEN, shortest):
                dropouts[first] = k
    return dropouts


def _equal(array: np.ndarray, row: int) -> bool:
    return bool((array[row] == array[row - 1]).all())


def _is_usable(samples: Samples) -> bool:
    low, high = extremes(samples.position)
    return bool(samples.time[-1] - samples.time[0] >= SHORTEST and (low < high).any())


def in_order(samples: Samples, notes: list[Finding], given: Given) -> Samples:
    """Put rows that come late, twice or a step behind their time in order, and drop repeated rows.

    If the positions are smoother in the order of the rows, the stamps are wrong and never fall.
    """
    time, count = samples.time, len(samples.time)
    if not any((np.diff(part) < 0).any() for part in blocks(time, before=1)):
        return _without_repeated(samples, notes, given)
    latest, order = np.maximum.accumulate(time), np.argsort(time, kind="stable")
    table = np.column_stack([time, samples.position, samples.command])
    again = order[1:][(table[order[1:]] == table[order[:-1]]).all(axis=1)]
    moved = np.setdiff1d(np.flatnonzero(time < latest), again)
    behind, step = (latest - time)[moved], float(np.median(sampled_steps(time)))
    if len(again) + len(moved) > MAX_MISSING * count or np.any(behind > AHEAD * step):
        return _without_repeated(samples, notes, given)  # which refuses it
    if moved.size:
        low, high = extremes(samples.position)
        scaled = np.delete(samples.position / np.where(high > low, high - low, 1.0), again, axis=0)
        by_time = scaled[np.argsort(np.delete(time, again), kind="stable")]
        if np.abs(np.diff(by_time, axis=0)).sum() > np.abs(np.diff(scaled, axis=0)).sum():
            return _without_repeated(replace(samples, time=latest), notes, given)
        places = samples.places(samples.rows[moved[:5]].tolist(), len(moved))
        text = f"put {counted(len(moved), 'row')} in the order of their times ({places})"
        notes.append(repair("rows out of order", len(moved) / count, text=text))
    arrays = {name: getattr(samples, name)[order] for name in ("time", "position", "command", "rows")}
    return _without_repeated(replace(samples, **arrays), notes, given)


def _without_repeated(samples: Samples, notes: list[Finding], clock: Given) -> Samples:
    """Drop samples with the time and values of the one before; raises GtauError where time goes back.

    Samples with the same time but different values are kept, as their stamps are late, unless stamps are stated to be
    true.
    """
    time = samples.time
    repeated: list[int] = []
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
        if different.size and clock != "stamps":
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
    places = samples.places(samples.rows[repeated[:5]].tolist(), len(repeated))
    text = f"dropped {counted(len(repeated), 'repeated row')} ({places})"
    notes.append(repair("repeated rows", len(repeated) / len(time), text=text))
    refuse_short(samples.name, len(time) - len(repeated))
    kept = np.setdiff1d(np.arange(len(time)), repeated)
    arrays = (samples.time, samples.position, samples.command, samples.rows)
    time, position, command, rows = (rows_at(array, kept) for array in arrays)
    return replace(samples, time=time, position=position, command=command, rows=rows)
