"""Complete samples of a log, as logged."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from gtau.errors import GtauError
from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.findings.words import counted
from gtau.signals.channel import Channel
from gtau.signals.storage import Store, blocks

MIN_SAMPLES = 100
MAX_MISSING = 0.05  # part of a log that may be bad or missing


@dataclass(frozen=True)
class Source:
    """Description of a log for messages.

    ``columns`` are the names of the columns of the joints' positions, of the ``channels`` and of the time; ``texts``
    their first non-numeric entries read so far. Row 0 is in ``first_line`` of a text file, or the first row otherwise.
    """

    name: str
    channels: tuple[Channel, ...]
    columns: tuple[str, ...]
    texts: Mapping[str, str]
    first_line: int = 1
    line_word: str = "line"

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""
        return tuple(channel.joint for channel in self.channels if channel.kind.modelled and not channel.kind.link_side)

    def places(self, rows: Sequence[int], count: int) -> str:
        """Describe the location in the file of ``count`` rows, the first of which are ``rows``."""
        listed = ", ".join(str(int(row) + self.first_line) for row in rows[:5])
        return f"{self.line_word}{'s' * (count > 1)} {listed}{', ...' if count > 5 else ''}"


@dataclass(frozen=True)
class Samples:
    """Complete samples of a log, SI units: ``time`` (N,), ``position`` (N, n) and ``command`` (N, c).

    As logged they come from ``rows`` (N,). On a uniform grid they come from none, and ``valid`` (N, c) is False where a
    command was interpolated or clipped. ``whole_share`` is the share of whole numbers among the joints' commands as
    logged.
    """

    source: Source
    time: np.ndarray
    position: np.ndarray
    command: np.ndarray
    rows: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=int))
    valid: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), dtype=bool))
    whole_share: float | None = None

    def place(self, sample: int) -> str:
        """Describe the location of a sample in the file."""
        return self.source.places([self.rows[sample]], 1)


@dataclass(frozen=True)
class Part:
    """The part of a log to use: without its first ``skip`` rows, and between two times in s.

    Where it is an ``episode``, the log's rows end at ``stop``.
    """

    skip: int = 0
    begin: float = 0.0
    end: float = np.inf
    stop: int = sys.maxsize
    episode: int | None = None

    @property
    def rows(self) -> range:
        """Rows to read."""
        return range(self.skip, self.stop)

    @property
    def label(self) -> str:
        """Suffix that distinguishes the names of runs from one log."""
        episode = "" if self.episode is None else f" episode {self.episode}"
        if self.begin == 0 and self.end == np.inf:
            return episode
        return f"{episode} from {self.begin:g} s" + ("" if self.end == np.inf else f" to {self.end:g} s")

    def of(self, parts: Iterable[np.ndarray]) -> Iterator[tuple[int, np.ndarray]]:
        """Yield rows of the part, in blocks whose last column is the time, and the number of the first in each."""
        row, first = self.skip, None
        for values in parts:
            time = values[:, -1]
            known = np.flatnonzero(np.isfinite(time))
            if first is None and known.size:
                first = float(time[known[0]])
            if first is not None and (self.begin > 0 or self.end < np.inf):
                # Rows without a time go with those before them.
                elapsed = np.maximum.accumulate(np.where(np.isfinite(time), time, -np.inf) - first)
                start, stop = np.searchsorted(elapsed, self.begin), np.searchsorted(elapsed, self.end, side="right")
                yield row + int(start), values[start:stop]
                if stop < len(values):
                    return
            else:
                yield row, values
            row += len(values)


WHOLE = Part()


def refuse_short(source: Source, count: int) -> None:
    """Refuse a log with too few samples."""
    if count < MIN_SAMPLES:
        raise GtauError(
            f"{source.name} has {counted(count, 'sample')}; identification needs a log of several seconds (at least "
            f"{MIN_SAMPLES} samples)."
        )


def complete(source: Source, parts: Iterable[np.ndarray], notes: list[Finding], part: Part = WHOLE) -> Samples:
    """Collect the complete samples of a log or of a part of it; raises GtauError if there are too few."""
    n = len(source.joints)
    wide = n + len(source.channels)  # columns before the time
    stores = Store(), Store((n,)), Store((wide - n,)), Store(dtype=int)
    numbers = np.zeros(wide + 1, dtype=int)  # in each column
    incomplete, empty, bad_column = _Rows(), _Rows(), 0
    for row, values in part.of(parts):
        finite = np.isfinite(values)
        kept = np.ones(len(values), dtype=bool)
        if not finite.all():
            kept, nothing = finite.all(axis=1), ~finite[:, :wide].any(axis=1)
            if not incomplete.count and (~kept & ~nothing).any():
                bad_column = int(np.argmin(finite[np.argmax(~kept & ~nothing)]))
            incomplete.add(row + np.flatnonzero(~kept & ~nothing))
            empty.add(row + np.flatnonzero(nothing))
        numbers += finite.sum(axis=0)
        columns = values[kept, wide], values[kept, :n], values[kept, n:wide], row + np.flatnonzero(kept)
        for store, added in zip(stores, columns, strict=True):
            store.append(added)
    time, position, command, rows = (store.array() for store in stores)
    samples = Samples(source, time, position, command, rows)
    count = len(samples.time) + incomplete.count
    if empty.count <= MAX_MISSING * (count + empty.count):  # faults like others, such as a last row that was cut
        incomplete.first = sorted(incomplete.first + empty.first)[:5]
        incomplete.count, count, empty = incomplete.count + empty.count, count + empty.count, _Rows()
    if not count and part != WHOLE:
        raise GtauError(
            f"{source.name} has no rows in the selected part (skip: {part.skip}, from: {part.begin:g}, to: "
            f"{part.end:g} s); correct these keys."
        )
    refuse_short(source, count)
    if empty.count:
        notes.append(Finding(F.OTHER_ROWS, values={"count": empty.count}))
    _refuse_empty_columns(source, numbers)
    _refuse_incomplete(source, incomplete, count, source.columns[bad_column])
    if incomplete.count:
        places = source.places(incomplete.first, incomplete.count)
        dropped = {"count": incomplete.count, "places": places}
        notes.append(Finding(F.BAD_ROWS, values=dropped, share=incomplete.count / count))
    return samples


class _Rows:
    """Count of rows, and the first five of them."""

    def __init__(self) -> None:
        self.count, self.first = 0, list[int]()

    def add(self, rows: np.ndarray) -> None:
        self.count += len(rows)
        self.first += rows[: 5 - len(self.first)].tolist()


def _refuse_incomplete(source: Source, rows: _Rows, count: int, column: str) -> None:
    if rows.count > MAX_MISSING * count:
        entry = source.texts.get(column, "")
        raise GtauError(
            f"{source.name} has {rows.count} of {count} rows with missing or non-numeric values (first in "
            f"{source.places(rows.first[:1], 1)}, column '{column}'"
            + (f": '{entry}'" if entry else "")
            + "); correct or delete them, or record the log again."
        )


def _refuse_empty_columns(source: Source, numbers: np.ndarray) -> None:
    for column, number in zip(source.columns, numbers.tolist(), strict=True):
        if not number:
            entry = source.texts.get(column, "")
            repair = "give the column that holds them"
            if column == source.columns[-1] and entry[:1].isdigit():
                repair = "convert it to seconds, or give the rate instead (time: {rate: HZ})"
            raise GtauError(
                f"{source.name}, column '{column}' holds no number"
                + (f" (it begins with '{entry}')" if entry else "")
                + f"; {repair}."
            )


def extremes(array: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the smallest and largest value of every column."""
    ends = [(part.min(axis=1), part.max(axis=1)) for part in (np.ascontiguousarray(part.T) for part in blocks(array))]
    return np.min([low for low, _ in ends], axis=0), np.max([high for _, high in ends], axis=0)
