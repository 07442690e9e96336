"""The part of a log to use, its complete samples, and registers in it that were logged without their sign."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import ConfigDict, Field, FiniteFloat, model_validator

from gtau.documents.validation import Keys
from gtau.errors import GtauError
from gtau.findings import Finding, counted
from gtau.signals.channel import Channel
from gtau.signals.reading.formats import ALL, LogTable, listed_joints, reading, repair
from gtau.signals.storage import Store, blocks, stored_like

MIN_SAMPLES = 100
MAX_MISSING = 0.05  # part of a log that may be bad or missing


class Part(Keys):
    """Part of a log to use: without the first ``skip`` rows, between two times (s), or of one ``episode``.

    The times count from the first row after these. In a file they are ``from`` and ``to``.
    """

    model_config = ConfigDict(populate_by_name=True)

    skip: Annotated[int, Field(ge=0)] = 0
    begin: Annotated[FiniteFloat, Field(ge=0, alias="from")] = 0.0
    end: Annotated[float, Field(gt=0, alias="to")] = np.inf
    episode: Annotated[int, Field(ge=0)] | None = None

    @model_validator(mode="after")
    def _forwards(self) -> Part:
        if self.end <= self.begin:
            raise ValueError(f"'from' is {self.begin:g} s and 'to' {self.end:g} s; write the earlier one as 'from'")
        return self

    @property
    def label(self) -> str:
        """Suffix that distinguishes the names of runs from one log."""
        label = "" if self.episode is None else f" episode {self.episode}"
        if self.begin > 0 or self.end < np.inf:
            label += f" from {self.begin:g} s"
        return label if self.end == np.inf else f"{label} to {self.end:g} s"

    def rows(self, table: LogTable) -> range:
        """Return the rows of a log to read; raises GtauError where it lacks the episode."""
        if self.episode is None:
            return ALL[self.skip :]
        episodes = table.episodes
        if self.episode not in episodes:
            there = f"{min(episodes)} to {max(episodes)}" if episodes else "not several ('episode_index')"
            raise GtauError(f"{table.path} has no episode {self.episode}; its episodes are {there}.")
        return episodes[self.episode][self.skip :]

    def of(self, parts: Iterable[tuple[int, np.ndarray]]) -> Iterator[tuple[int, np.ndarray]]:
        """Yield the rows of the part, in blocks whose last column is the time, and the number of the first in each."""
        first = None
        for row, values in parts:
            time = values[:, -1]
            known = np.isfinite(time)
            if first is None and known.any():
                first = float(time[known][0])
            if first is None or (self.begin == 0 and self.end == np.inf):
                yield row, values
                continue
            # Rows without a time go with the rows before them.
            elapsed = np.maximum.accumulate(np.where(known, time, -np.inf) - first)
            start = np.searchsorted(elapsed, self.begin)
            stop = np.searchsorted(elapsed, self.end, side="right")
            yield row + int(start), values[start:stop]
            if stop < len(values):
                return


WHOLE = Part()


@dataclass(frozen=True, eq=False)
class Samples:
    """Complete samples of a log, SI units: ``time`` (N,), ``position`` (N, n) and ``command`` (N, c) of ``channels``.

    Messages name the log by ``name``, its columns of positions, channels and time by ``columns``, and samples by
    ``rows`` (N,) of the ``table``. They belong to a ``part`` of the log, whose times count from ``origin`` (s).
    """

    name: str
    channels: tuple[Channel, ...]
    columns: tuple[str, ...]
    table: LogTable
    part: Part
    origin: float
    time: np.ndarray
    position: np.ndarray
    command: np.ndarray
    rows: np.ndarray

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""
        return _joints_of(self.channels)

    def place(self, sample: int) -> str:
        """Describe the location of a sample in the file."""
        return self.table.places([self.rows[sample]], 1)

    def with_arrays(self, change: Callable[[np.ndarray], np.ndarray]) -> Samples:
        """Return the samples with a change of all their arrays."""
        arrays: Any = {name: change(getattr(self, name)) for name in ("time", "position", "command", "rows")}
        return replace(self, **arrays)

    def piece(self, begin: int, end: int) -> Samples:
        """Return the samples from ``begin`` to before ``end`` of a log, as a part of it."""
        first, last = (float(self.time[k]) - self.origin for k in (begin, end - 1))
        update = {
            "begin": self.part.begin if begin == 0 else np.floor(100 * first) / 100,
            "end": self.part.end if end == len(self.time) else np.ceil(100 * last) / 100,
        }
        return replace(self.with_arrays(lambda array: array[begin:end]), part=self.part.model_copy(update=update))

    def without(self, begin: int, end: int) -> str:
        """Write the keys of a run that leave out the samples from ``begin`` to before ``end``."""
        count = len(self.time)
        unit = 10.0 ** np.floor(np.log10((self.time[-1] - self.time[0]) / count))
        last, first = (self.time[min(max(at, 0), count - 1)] - self.origin for at in (begin - 1, end))
        until = f"to: {np.floor(last / unit) * unit:.9g}"
        since = f"from: {np.ceil(first / unit) * unit:.9g}"
        if begin < MIN_SAMPLES:
            return since
        return until if count - end < MIN_SAMPLES else f"two runs of that log, one with '{until}', one with '{since}'"


def _joints_of(channels: Iterable[Channel]) -> tuple[str, ...]:
    return tuple(channel.joint for channel in channels if channel.kind.modelled and not channel.kind.link_side)


def refuse_short(name: str, count: int) -> None:
    """Refuse a log with too few samples."""
    if count < MIN_SAMPLES:
        raise GtauError(
            f"{name} has {counted(count, 'sample')}; identification needs a log of several seconds (at least "
            f"{MIN_SAMPLES} samples)."
        )


def complete(
    name: str,
    channels: tuple[Channel, ...],
    columns: tuple[str, ...],
    table: LogTable,
    parts: Iterable[tuple[int, np.ndarray]],
    notes: list[Finding],
    part: Part,
) -> Samples:
    """Collect the complete samples of a part of a log; its ``parts`` are blocks with the number of their first row."""
    arrays, numbers, begin, bad_column = _sorted_rows(part.of(parts), columns, len(_joints_of(channels)))
    time, position, command, rows, incomplete, empty = arrays
    if len(empty) <= MAX_MISSING * (len(time) + len(incomplete) + len(empty)):
        # faults like others, such as a last row that was cut
        incomplete, empty = np.sort(np.concatenate([incomplete, empty])), empty[:0]
    count, without = len(time) + len(incomplete), len(empty)
    if not count and (part.skip or part.label):
        raise GtauError(
            f"{name} has no rows in the selected part (skip: {part.skip}, from: {part.begin:g}, to: {part.end:g} s); "
            "correct these keys."
        )
    refuse_short(name, count)
    if without:
        text = f"left out {counted(without, 'row')} that hold only other signals"
        notes.append(reading("rows of other signals", text=text))
    if not numbers.all():
        column = columns[int(np.argmin(numbers))]
        entry, remedy = table.texts.get(column, ""), "give the column that holds them"
        if column == columns[-1] and entry[:1].isdigit():  # the time
            remedy = "convert it to seconds, or give the rate instead (time: {rate: HZ})"
        begins = f" (it begins with '{entry}')" if entry else ""
        raise GtauError(f"{name}, column '{column}' holds no number{begins}; {remedy}.")
    lost = len(incomplete)
    if lost > MAX_MISSING * count:
        leading = int(rows[0]) - begin if len(rows) and not part.begin else 0
        remedy = "correct or delete them"
        if 2 * lost > count:
            remedy = "give columns that have other rates in a file of their own (log: [FILE, FILE]), or correct them"
        if lost - leading <= MAX_MISSING * count:
            remedy = f"leave out its first rows (skip: {part.skip + leading})"
        column = bad_column or columns[0]
        entry = f": '{table.texts[column]}'" if table.texts.get(column) else ""
        raise GtauError(
            f"{name} has {lost} of {count} rows with missing or non-numeric values (first in "
            f"{table.places(incomplete, 1)}, column '{column}'{entry}); {remedy}, or record the log again."
        )
    if lost:
        text = f"dropped {counted(lost, 'row')} with missing or non-numeric values ({table.places(incomplete, lost)})"
        notes.append(repair("rows without numbers", lost / count, text=text))
    origin = float(time[0]) - part.begin if len(time) else 0.0
    return Samples(name, channels, columns, table, part, origin, time, position, command, rows)


def _sorted_rows(
    parts: Iterable[tuple[int, np.ndarray]], columns: tuple[str, ...], n: int
) -> tuple[list[np.ndarray], np.ndarray, int, str]:
    """Sort rows with ``n`` positions, commands and the time by whether they are complete.

    Returns time, positions and commands of complete rows and the numbers of complete, incomplete and empty ones; how
    many numbers each of the ``columns`` has; the first row, -1 without any; and the column where a row lacks a number.
    """
    wide = len(columns) - 1  # columns before the time
    stores = Store(), Store((n,)), Store((wide - n,)), *(Store(dtype=int) for _ in range(3))
    numbers = np.zeros(wide + 1, dtype=int)
    begin, bad_column = -1, ""
    for row, values in parts:
        begin = row if begin < 0 else begin
        finite = np.isfinite(values)
        kept = finite.all(axis=1)
        nothing = ~finite[:, :wide].any(axis=1)
        some = ~kept & ~nothing
        if some.any() and not bad_column:
            bad_column = columns[int(np.argmin(finite[np.argmax(some)]))]
        numbers += finite.sum(axis=0)
        arrays = values[kept, wide], values[kept, :n], values[kept, n:wide]
        places = (row + np.flatnonzero(which) for which in (kept, some, nothing))
        for store, added in zip(stores, (*arrays, *places), strict=True):
            store.append(added)
    return [store.array() for store in stores], numbers, begin, bad_column


Ends = tuple[np.ndarray, np.ndarray]
"""Smallest and largest values of columns."""


def extremes(array: np.ndarray) -> Ends:
    """Find the smallest and largest value of every column."""
    columns = (np.ascontiguousarray(part.T) for part in blocks(array))
    low, high = zip(*((part.min(axis=1), part.max(axis=1)) for part in columns), strict=True)
    return np.min(low, axis=0), np.max(high, axis=0)


LEAST = 128  # counts; below, it is a small number in any register
REMAINING = 0.3  # median jump at the middle of the register once it is signed, over the jump as logged
FULL = 0.9  # of the range that a number in two's complement reaches at least where it is just below zero
VALUES = 3  # different ones on either side; a switch has fewer


class Register(NamedTuple):
    """A register: the number of its ``bits``, and whether the first one is a ``sign`` beside a magnitude."""

    bits: int
    sign: bool

    def signed(self, values: np.ndarray) -> np.ndarray:
        """Return the signed numbers of unsigned ones."""
        half = 2.0 ** (self.bits - 1)
        return np.where(values < half, values, half - values if self.sign else values - 2 * half)


def register_of(values: np.ndarray) -> Register | None:
    """Recognise a register logged without sign by its values (N,): whole numbers that jump at the middle of its range.

    A switch is none, nor are values that pass the middle in small steps.
    """
    exact = values[np.isfinite(values)]
    values = np.rint(exact)
    if not values.size or values.min() < 0 or values.max() < LEAST or not np.allclose(values, exact, 1e-9, 0.0):
        return None
    bits = int(values.max()).bit_length()
    above = values >= 2.0 ** (bits - 1)
    at = np.flatnonzero(above[1:] != above[:-1])
    if not at.size or min(len(np.unique(values[above])), len(np.unique(values[~above]))) < VALUES:
        return None

    def jump(numbers: np.ndarray) -> float:
        return float(np.median(np.abs(np.diff(numbers)[at])))

    register = min((Register(bits, sign) for sign in (False, True)), key=lambda one: jump(one.signed(values)))
    full = register.sign or values.max() >= FULL * 2.0**bits
    return register if full and jump(register.signed(values)) < REMAINING * jump(values) else None


def with_signs(
    samples: Samples, scales: tuple[Mapping[str, float], Mapping[str, float]], notes: list[Finding]
) -> Samples:
    """Correct registers logged without sign; ``scales`` are the SI values of a count of a joint's position, command."""
    joints, signed = samples.joints, dict[str, np.ndarray]()
    for kind, scale in zip(("position", "command"), scales, strict=True):
        array: np.ndarray = getattr(samples, kind)
        low, high = extremes(array)
        counts, bits = dict[int, float](), dict[int, int]()
        for j, joint in enumerate(joints):
            if joint in scale:  # positions wrap by turns, which are not a register's range
                counts[j] = scale[joint] if kind == "position" else _count(array, j, scale[joint])
                least, most = sorted((low[j] / counts[j], high[j] / counts[j]))
                if least >= 0 and most >= LEAST:
                    bits[j] = int(np.rint(most)).bit_length()
        # One in the upper half of its range alone is a register if another joint's is.
        common = {register.bits: register for j in bits if (register := register_of(_column(array, j) / counts[j]))}
        registers = {j: common[width] for j, width in bits.items() if width in common}
        for register in set(registers.values()):
            names = tuple(joints[j] for j, same in registers.items() if same == register)
            half = 2 ** (register.bits - 1)
            meaning = f"{2 * half} is subtracted from {half} and more"
            if register.sign:
                meaning = f"{half} and more are negative, with the magnitude above that"
            number = f"a signed number of {register.bits} bits that was logged as unsigned"
            text = f"the {kind} of {listed_joints(names)} is {number}: {meaning}"
            notes.append(reading("unsigned register", text=text, joints=names))
        if registers:
            signed[kind] = stored_like(array, (_signed(part, registers, counts) for part in blocks(array)))
    position = signed.get("position", samples.position)
    return replace(samples, position=position, command=signed.get("command", samples.command))


def _count(array: np.ndarray, j: int, scale: float) -> float:
    """Find what one count is: ``scale``, or the step of a column that is never negative and was scaled before."""
    if extremes(array)[0][j] < 0:
        return scale
    values = np.unique(_column(array, j)) / scale
    steps = np.diff(values)[np.diff(values) > 1e-9 * values[-1]]
    step = float(f"{steps.min():.6g}") if steps.size else 1.0
    return scale if np.allclose(values, np.rint(values), 1e-9, 0.0) else scale * step


def _column(array: np.ndarray, j: int) -> np.ndarray:
    return np.concatenate([part[:, j] for part in blocks(array)])


def _signed(part: np.ndarray, registers: Mapping[int, Register], counts: Mapping[int, float]) -> np.ndarray:
    for j, register in registers.items():
        part[:, j] = counts[j] * register.signed(part[:, j] / counts[j])
    return part
