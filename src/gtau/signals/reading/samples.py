"""Complete samples of a log, as logged."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gtau.errors import GtauError
from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.findings.words import counted
from gtau.signals.channel import Channel
from gtau.signals.storage import Store, block, spans

MIN_SAMPLES = 100
MAX_MISSING = 0.05  # part of a log that may be bad or missing


@dataclass(frozen=True)
class Source:
    """Description of a log for messages.

    ``columns`` are the names of the columns of the ``joints``' positions, of the ``channels`` and of the time;
    ``texts`` their first non-numeric entries read so far. Row 0 is in ``first_line``.
    """

    name: str
    joints: tuple[str, ...]
    channels: tuple[Channel, ...]
    columns: tuple[str, ...]
    texts: Mapping[str, str]
    first_line: int = 1
    line_word: str = "line"

    def places(self, rows: Sequence[int], count: int) -> str:
        """Describe the location in the file of ``count`` rows, the first of which are ``rows``."""
        listed = ", ".join(str(int(row) + self.first_line) for row in rows[:5])
        return f"{self.line_word}{'s' * (count > 1)} {listed}{', ...' if count > 5 else ''}"


@dataclass(frozen=True)
class Samples:
    """Complete samples of a log, SI units: ``time`` and ``rows`` (N,), ``position`` (N, n) and ``command`` (N, c)."""

    source: Source
    rows: np.ndarray
    time: np.ndarray
    position: np.ndarray
    command: np.ndarray

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

    def of(self, blocks: Iterable[np.ndarray]) -> Iterator[tuple[int, np.ndarray]]:
        """Yield rows of the part, in blocks whose last column is the time, and the number of the first in each."""
        row, first = self.skip, None
        for values in blocks:
            time = values[:, -1]
            known = np.flatnonzero(np.isfinite(time))
            if first is None and known.size:
                first = float(time[known[0]])
            if first is not None and (self.begin > 0 or self.end < np.inf):
                # Rows without a time go with those before them.
                elapsed = np.where(np.isfinite(time), time, -np.inf) - first
                elapsed = np.maximum.accumulate(elapsed)
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


def complete(source: Source, blocks: Iterable[np.ndarray], notes: list[Finding], part: Part = WHOLE) -> Samples:
    """Collect the complete samples of a log or of a part of it; raises GtauError if there are too few."""
    n = len(source.joints)
    wide = n + len(source.channels)  # columns before the time
    stores = Store(dtype=int), Store(), Store((n,)), Store((wide - n,))
    numbers = np.zeros(wide + 1, dtype=int)  # in each column
    bad: list[int] = []
    bad_empty: list[int] = []
    count, bad_count, bad_column, empty = 0, 0, 0, 0
    for row, values in part.of(blocks):
        finite = np.isfinite(values)
        whole = bool(finite.all())
        kept = np.ones(len(values), dtype=bool) if whole else finite.all(axis=1)
        numbers += len(values) if whole else finite.sum(axis=0)
        nothing = np.zeros(len(values), dtype=bool) if whole else ~finite[:, :wide].any(axis=1)
        found = np.flatnonzero(~kept & ~nothing)
        if found.size and not bad_count:
            bad_column = int(np.argmin(finite[found[0]]))
        bad += (row + found[: 5 - len(bad)]).tolist()
        bad_count += found.size
        if nothing.any():
            bad_empty += (row + np.flatnonzero(nothing)[: 5 - len(bad_empty)]).tolist()
        parts = row + np.flatnonzero(kept), values[kept, wide], values[kept, :n], values[kept, n:wide]
        for each, rows in zip(stores, parts, strict=True):
            each.append(rows)
        count, empty = count + len(values) - int(nothing.sum()), empty + int(nothing.sum())
    samples = Samples(source, *(each.array() for each in stores))
    if empty <= MAX_MISSING * (count + empty):  # faults like others, such as a last row that was cut
        bad, bad_count, count, empty = sorted(bad + bad_empty)[:5], bad_count + empty, count + empty, 0
    if not count and part != WHOLE:
        raise GtauError(
            f"{source.name} has no rows in the selected part (skip: {part.skip}, from: {part.begin:g}, to: "
            f"{part.end:g} s); correct these keys."
        )
    refuse_short(source, count)
    if empty:
        notes.append(Finding(F.OTHER_ROWS, values={"count": empty}))
    _refuse_empty_columns(source, numbers)
    if bad_count > MAX_MISSING * count:
        column = source.columns[bad_column]
        entry = source.texts.get(column, "")
        raise GtauError(
            f"{source.name} has {bad_count} of {count} rows with missing or non-numeric values (first in "
            f"{source.places(bad[:1], 1)}, column '{column}'"
            + (f": '{entry}'" if entry else "")
            + "); correct or delete them, or record the log again."
        )
    if bad_count:
        places = source.places(bad, bad_count)
        dropped = {"count": bad_count, "places": places}
        notes.append(Finding(F.BAD_ROWS, values=dropped, share=bad_count / count))
    return samples


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
    columns = (np.ascontiguousarray(block(array, *span).T) for span in spans(len(array)))
    found = [(each.min(axis=1), each.max(axis=1)) for each in columns]
    return np.min([low for low, _ in found], axis=0), np.max([high for _, high in found], axis=0)


def ahead(samples: int) -> Iterator[tuple[int, int]]:
    """Extend each span by the last sample of the span before."""
    return ((max(start - 1, 0), stop) for start, stop in spans(samples))
