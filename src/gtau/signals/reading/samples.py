"""The part of a log to use, and its complete samples as logged."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np
from pydantic import ConfigDict, Field, FiniteFloat, model_validator

from gtau.documents.validation import Keys
from gtau.errors import GtauError
from gtau.findings import Finding
from gtau.findings.words import counted
from gtau.signals.channel import Channel
from gtau.signals.reading.formats import ALL, LogTable
from gtau.signals.reading.notes import reading, repair
from gtau.signals.storage import Store, blocks

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
            start, stop = np.searchsorted(elapsed, self.begin), np.searchsorted(elapsed, self.end, side="right")
            yield row + int(start), values[start:stop]
            if stop < len(values):
                return


WHOLE = Part()


def _none(dtype: type = float) -> np.ndarray:
    return np.zeros(0, dtype)


@dataclass(frozen=True, eq=False)
class Samples:
    """Complete samples of a log, SI units: ``time`` (N,), ``position`` (N, n) and ``command`` (N, c) of ``channels``.

    Messages name the log by ``name``, its columns of positions, channels and time by ``columns``, and samples by
    ``rows`` (N,) of the file, in which the ``table`` of the positions counts, too. They belong to a ``part`` of the
    log, whose times count from ``origin`` (s).
    """

    name: str
    channels: tuple[Channel, ...]
    columns: tuple[str, ...]
    table: LogTable
    time: np.ndarray = field(default_factory=_none)
    position: np.ndarray = field(default_factory=_none)
    command: np.ndarray = field(default_factory=_none)
    rows: np.ndarray = field(default_factory=lambda: _none(int))
    origin: float = 0.0
    part: Part = WHOLE

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""
        return tuple(channel.joint for channel in self.channels if channel.kind.modelled and not channel.kind.link_side)

    def places(self, rows: Sequence[int], count: int) -> str:
        """Describe where ``count`` rows are in the file; ``rows`` are the first."""
        first, word = self.table.first_line, "line"
        if first is None:
            first, word = 1, "row"
        listed = ", ".join(str(int(row) + first) for row in rows[:5])
        return f"{word}{'s' * (count > 1)} {listed}{', ...' if count > 5 else ''}"

    def place(self, sample: int) -> str:
        """Describe the location of a sample in the file."""
        return self.places([self.rows[sample]], 1)

    def piece(self, begin: int, end: int) -> Samples:
        """Return the samples from ``begin`` to before ``end`` of a log, as a part of it."""
        arrays = {name: getattr(self, name)[begin:end] for name in ("time", "position", "command", "rows")}
        first, last = (float(self.time[k]) - self.origin for k in (begin, end - 1))
        part = self.part.model_copy(
            update={
                "begin": self.part.begin if begin == 0 else np.floor(100 * first) / 100,
                "end": self.part.end if end == len(self.time) else np.ceil(100 * last) / 100,
            }
        )
        return replace(self, **arrays, part=part)

    def without(self, begin: int, end: int) -> str:
        """Write the keys of a run that leave out the samples from ``begin`` to before ``end``."""
        count = len(self.time)
        unit = 10.0 ** np.floor(np.log10((self.time[-1] - self.time[0]) / count))
        last, first = (self.time[min(max(at, 0), count - 1)] - self.origin for at in (begin - 1, end))
        until, since = f"to: {np.floor(last / unit) * unit:.9g}", f"from: {np.ceil(first / unit) * unit:.9g}"
        if begin < MIN_SAMPLES:
            return since
        return until if count - end < MIN_SAMPLES else f"two runs of that log, one with '{until}', one with '{since}'"


def refuse_short(name: str, count: int) -> None:
    """Refuse a log with too few samples."""
    if count < MIN_SAMPLES:
        raise GtauError(
            f"{name} has {counted(count, 'sample')}; identification needs a log of several seconds (at least "
            f"{MIN_SAMPLES} samples)."
        )


def complete(
    samples: Samples, parts: Iterable[tuple[int, np.ndarray]], notes: list[Finding], part: Part = WHOLE
) -> Samples:
    """Collect the complete samples of a log or of a part of it; raises GtauError if there are too few."""
    n, wide = len(samples.joints), len(samples.columns) - 1  # columns before the time
    stores = Store(), Store((n,)), Store((wide - n,)), Store(dtype=int)
    numbers = np.zeros(wide + 1, dtype=int)  # in each column
    incomplete, empty, bad_column, begin = _Rows(), _Rows(), 0, -1
    for row, values in part.of(parts):
        begin = row if begin < 0 else begin
        finite = np.isfinite(values)
        kept = finite.all(axis=1)
        nothing = ~finite[:, :wide].any(axis=1)
        partly = np.flatnonzero(~kept & ~nothing)
        if partly.size and not incomplete.count:
            bad_column = int(np.argmin(finite[partly[0]]))
        incomplete.add(row + partly)
        empty.add(row + np.flatnonzero(nothing))
        numbers += finite.sum(axis=0)
        columns = values[kept, wide], values[kept, :n], values[kept, n:wide], row + np.flatnonzero(kept)
        for store, added in zip(stores, columns, strict=True):
            store.append(added)
    time, position, command, rows = (store.array() for store in stores)
    count = len(time) + incomplete.count
    if empty.count <= MAX_MISSING * (count + empty.count):  # faults like others, such as a last row that was cut
        incomplete.first = sorted(incomplete.first + empty.first)[:5]
        incomplete.count, count, empty = incomplete.count + empty.count, count + empty.count, _Rows()
    if not count and (part.skip or part.label):
        raise GtauError(
            f"{samples.name} has no rows in the selected part (skip: {part.skip}, from: {part.begin:g}, to: "
            f"{part.end:g} s); correct these keys."
        )
    refuse_short(samples.name, count)
    if empty.count:
        text = f"left out {counted(empty.count, 'row')} that hold only other signals"
        notes.append(reading("rows of other signals", text=text))
    _refuse_empty_columns(samples, numbers)
    if incomplete.count > MAX_MISSING * count:
        leading = int(rows[0]) - begin if len(rows) and not part.begin else 0
        at_start = incomplete.count - leading <= MAX_MISSING * count
        remedy = f"leave out its first rows (skip: {part.skip + leading})" if at_start else "correct or delete them"
        _refuse_incomplete(samples, incomplete, count, samples.columns[bad_column], remedy)
    if incomplete.count:
        places = samples.places(incomplete.first, incomplete.count)
        text = f"dropped {counted(incomplete.count, 'row')} with missing or non-numeric values ({places})"
        notes.append(repair("rows without numbers", incomplete.count / count, text=text))
    origin = float(time[0]) - part.begin if len(time) else 0.0
    return replace(samples, time=time, position=position, command=command, rows=rows, origin=origin, part=part)


class _Rows:
    """Count of rows, and the first five of them."""

    def __init__(self) -> None:
        self.count, self.first = 0, list[int]()

    def add(self, rows: np.ndarray) -> None:
        self.count += len(rows)
        self.first += rows[: 5 - len(self.first)].tolist()


def _refuse_incomplete(samples: Samples, rows: _Rows, count: int, column: str, remedy: str) -> None:
    entry = f": '{samples.table.texts[column]}'" if samples.table.texts.get(column) else ""
    raise GtauError(
        f"{samples.name} has {rows.count} of {count} rows with missing or non-numeric values (first in "
        f"{samples.places(rows.first[:1], 1)}, column '{column}'{entry}); {remedy}, or record the log again."
    )


def _refuse_empty_columns(samples: Samples, numbers: np.ndarray) -> None:
    for column, number in zip(samples.columns, numbers.tolist(), strict=True):
        if number:
            continue
        entry = samples.table.texts.get(column, "")
        repair = "give the column that holds them"
        if column == samples.columns[-1] and entry[:1].isdigit():
            repair = "convert it to seconds, or give the rate instead (time: {rate: HZ})"
        begins = f" (it begins with '{entry}')" if entry else ""
        raise GtauError(f"{samples.name}, column '{column}' holds no number{begins}; {repair}.")


def extremes(array: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the smallest and largest value of every column."""
    ends = [(part.min(axis=1), part.max(axis=1)) for part in (np.ascontiguousarray(part.T) for part in blocks(array))]
    return np.min([low for low, _ in ends], axis=0), np.max([high for _, high in ends], axis=0)
