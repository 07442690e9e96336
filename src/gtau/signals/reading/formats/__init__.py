"""Readers of log formats, one module per family of formats, and what each returns: a :class:`LogTable`, not yet read.

A module names its readers in a constant ``LOG_FORMATS``, by the endings of the files (``{".npz": open_npz}``).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gtau.documents.expressions import combined
from gtau.documents.files import system_refusals
from gtau.errors import GtauError, quoted, short
from gtau.findings import Finding, Grade
from gtau.signals.reading.units import COMMON, read_unit
from gtau.signals.storage import block, store

if TYPE_CHECKING:
    import polars as pl

MOST_COLUMNS = 20_000  # of a log, looked through in 8 s
WIDEST = 256  # columns of one array; a wider one is an image or a map, not signals
ALL = range(1 << 62)  # rows


@dataclass(frozen=True, eq=False)
class LogTable:
    """Columns of a log, located but not yet read.

    ``frames`` reads some rows of columns by name, block by block, as Polars frames with the fraction of the log read so
    far; it refuses columns that hold no numbers. Row 0 is in ``first_line`` of a text file; other logs have rows,
    counted from 1. ``notes`` report what the reader left out; ``episodes`` are rows by episode, if there are several.
    ``texts`` holds, by column, the first entry read so far that is not a number; ``units``, by column, are as written
    in the log beside the names. ``sums`` are columns computed from others, with the names of these; ``clocks`` are
    columns read so far that hold dates, clock times or durations, read in s.
    """

    path: Path
    columns: tuple[str, ...]
    frames: Callable[[Sequence[str], range], Iterator[tuple[pl.DataFrame, float]]]
    first_line: int | None = None
    notes: Sequence[Finding] = ()
    episodes: Mapping[int, range] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    sums: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    clocks: set[str] = field(default_factory=set)

    @property
    def numbered(self) -> bool:
        """True where the log has no header, and its columns are named by their number."""
        return self.columns != () and self.columns == numbers(len(self.columns))

    def places(self, rows: Sequence[int] | np.ndarray, count: int) -> str:
        """Describe where ``count`` rows are in the file; ``rows`` are the first."""
        first, word = (1, "row") if self.first_line is None else (self.first_line, "line")
        listed = ", ".join(str(int(row) + first) for row in rows[: min(count, 5)])
        return f"{word}{'s' * (count > 1)} {listed}{', ...' if count > 5 else ''}"

    def blocks(self, rows: range = ALL) -> Iterator[tuple[np.ndarray, float]]:
        """Read numbers (M, columns), nan where a value is missing or not a number, with the fraction read so far."""
        parts = {name: self.sums.get(name, (name,)) for name in self.columns}
        logged = tuple(dict.fromkeys(part for names in parts.values() for part in names))
        with system_refusals(self.path):
            for frame, done in self.frames(logged, rows):
                read = {name: _floats(frame[:, k]) for k, name in enumerate(logged)}
                for column in self.columns:
                    for text in (read[part][1] for part in parts[column]):
                        if text is not None:
                            self.texts.setdefault(column, text)
                    self.clocks.update([column] * any(read[part][2] for part in parts[column]))
                numbers = {name: column for name, (column, *_) in read.items()}
                columns = [combined(name, numbers) if name in self.sums else numbers[name] for name in self.columns]
                yield np.column_stack(columns), done

    def dated(self) -> list[str]:
        """List the columns that begin with a date, a clock time or a duration."""
        if self.columns:
            next(self.blocks(range(1)), None)
        return [name for name in self.columns if name in self.clocks]

    def arrays(self) -> dict[str, np.ndarray]:
        """Read whole columns (N,) by name."""
        values = store((values for values, _ in self.blocks()), (len(self.columns),))
        return dict(zip(self.columns, values.T, strict=True))


def numbers(count: int) -> tuple[str, ...]:
    """Name the columns of a log without header, from 1."""
    return tuple(str(k + 1) for k in range(count))


def _floats(series: pl.Series) -> tuple[np.ndarray, str | None, bool]:
    """Read the finite numbers of a column, nan for other entries; the first of these; whether they are times in s."""
    import polars as pl

    column, times = series, None
    if not series.dtype.is_temporal():
        column = series.cast(pl.Float64, strict=False)
    if series.dtype.is_temporal() or (series.dtype == pl.String and column.null_count() == len(column)):
        times = seconds(series)
    is_clock, column = times is not None, column if times is None else times
    values = column.cast(pl.Float64, strict=False).to_numpy().astype(float)  # null becomes nan
    bad = np.flatnonzero(~np.isfinite(values))
    if not bad.size:
        return values, None, is_clock
    values[bad] = np.nan
    entry = series[int(bad[0])]
    return values, "" if entry is None else str(entry), is_clock


@contextmanager
def readable(path: Path, kind: str) -> Iterator[None]:
    """Turn whatever a library raises on a damaged file into one sentence; ``kind`` such as ``a MAT file``."""
    try:
        yield
    except GtauError:
        raise
    except MemoryError:
        raise GtauError(
            f"{path}, read as {kind}, asks for more memory than there is; export it again, in parts."
        ) from None
    except Exception as error:  # libraries raise what they like, down to AssertionError
        if isinstance(error, OSError) and error.errno is not None:  # of the system; HDF5's have no number
            raise
        reason = short(str(error) or type(error).__name__, 200).rstrip(".")
        raise GtauError(f"{path} cannot be read as {kind} ({reason}); export the log again.") from None


def common_length(path: Path, lengths: Mapping[str, int], more: int = 0) -> int:
    """Count the rows of columns that must have as many, up to some rows ``more``."""
    if max(lengths.values()) - min(lengths.values()) > more:
        (first, rows), *rest = lengths.items()
        second = next(name for name, count in rest if count != rows)
        raise GtauError(
            f"'{first}' has {rows} rows but '{second}' has {lengths[second]}; give columns that were sampled "
            "together, or each topic's own stamps (time: {position: COLUMN, command: COLUMN}).",
            source=path,
        )
    return max(lengths.values())


LONGEST_STEP = 3.0  # usual steps of a signal, beyond which it is not interpolated but missing


def interpolated(log: np.ndarray, step: float, time: np.ndarray) -> np.ndarray:
    """Interpolate a ``log`` (K, 1 + c) at instants (M,): values (M, c), nan in far longer steps than ``step`` (s)."""
    known = np.isfinite(time)
    commands = np.full((len(time), log.shape[1] - 1), np.nan)
    if not known.any():
        return commands
    at = time[known]
    begin = max(int(np.searchsorted(log[:, 0], at.min(), side="right")) - 1, 0)
    end = int(np.searchsorted(log[:, 0], at.max())) + 1
    stamps, *logged = block(log, begin, end).T
    after = np.clip(np.searchsorted(stamps, at, side="left"), 0, len(stamps) - 1)
    before = np.maximum(after - (stamps[after] != at), 0)
    between = (stamps[after] - stamps[before] <= LONGEST_STEP * step) & (stamps[after] >= at) & (stamps[before] <= at)
    values = np.column_stack([np.interp(at, stamps, command) for command in logged])
    commands[known] = np.where(between[:, None], values, np.nan)
    return commands


COSTLY = 0.02  # share of the samples that a repair drops or interpolates, from which it is a warning


def reading(kind: str, text: str, advice: str = "", joints: Sequence[str] = ()) -> Finding:
    """Note how a log was read."""
    return Finding(kind, tuple(joints), text=text, advice=advice, grade=Grade.INFORMATION, shown_as="reading")


def repair(
    kind: str, share: float, text: str, advice: str = "", joints: Sequence[str] = (), time: float | None = None
) -> Finding:
    """Note a repair of a ``share`` of the samples: a warning where it costs many of them."""
    grade = Grade.WARNING if share > COSTLY else Grade.INFORMATION
    return replace(reading(kind, text, advice, joints), share=share, time=time, grade=grade, shown_as="repair")


def listed(columns: Iterable[str], most: int = 8) -> str:
    """List some columns, the first of many."""
    columns = tuple(columns)
    return ", ".join(map(short, columns[:most])) + ", ..." * (len(columns) > most)


def listed_joints(joints: Sequence[str]) -> str:
    """Write ``joint 'a'``, ``joints 'a' and 'b'``."""
    return f"joint{'s' * (len(joints) > 1)} {' and '.join(map(quoted, joints))}"


DATE = re.compile(r"\d{1,4}[-/.](\d{1,2}|[A-Za-z]{3})[-/.]\d{1,4}([T ]|$)|20\d{6}T\d{6}")
CLOCK = re.compile(r"(?:(\d+) days?,? *)?(?:(\d+):)?(\d+):(\d\d?(?:\.\d+)?)")  # Excel shows minutes and seconds
SPAN = re.compile(r"([-+]?[\d.]+(?:[eE][-+]?\d+)?) *([A-Za-zµ]+)")  # as MATLAB writes a duration: 0.002 sec
DAY = 86400.0  # s
HALF_DAYS = "%I:%M:%S%.f %p"
FORMATS = (None, "%d-%b-%Y %H:%M:%S%.f", f"%m/%d/%Y {HALF_DAYS}")  # by Polars' guess, of MATLAB, of LabVIEW


def is_instant(text: str) -> bool:
    """Decide whether a text is a date, a clock time or a duration."""
    span = SPAN.fullmatch(text)
    if span and (unit := read_unit(span[2])):
        return unit.measures == "time"
    return bool(DATE.match(text) or CLOCK.match(text))


def seconds(column: pl.Series) -> pl.Series | None:
    """Convert dates, clock times and durations, or texts of such, to s, null where one is not; None for others."""
    import polars as pl

    if column.dtype == pl.String:
        column = column.str.replace(r"(\d),(\d)", "$1.$2")
        texts = column.drop_nulls()
        return _parsed(column, texts[0]) if len(texts) and is_instant(texts[0]) else None
    if not column.dtype.is_temporal():
        return None
    if column.dtype == pl.Duration:
        return column.dt.total_nanoseconds() * 1e-9
    nanoseconds = column.dtype == pl.Time  # of dates they would overflow
    return column.cast(pl.Int64) * 1e-9 if nanoseconds else column.cast(pl.Datetime("us")).cast(pl.Int64) * 1e-6


def with_date(clock: str, columns: Mapping[str, np.ndarray]) -> str:
    """Return a column of times, plus the one of the date where it holds clock times of a day; the columns are in s."""
    days = [name for name, values in columns.items() if (values >= DAY).all() and not (values % DAY).any()]
    if not days or np.nanmax(columns[clock]) > DAY:
        return clock
    return " + ".join(name if name.isidentifier() else f"`{name}`" for name in (days[0], clock))


def _parsed(texts: pl.Series, first: str) -> pl.Series | None:
    import polars as pl

    if span := SPAN.fullmatch(first):
        number = texts.str.extract(rf"^([-+.\deE]+) *{re.escape(span[2])}$").cast(pl.Float64, strict=False)
        unit = read_unit(span[2])
        return number * COMMON["time"].get(unit.text if unit else "", 60.0)  # s to ns, or min
    if not DATE.match(first):
        if first[-1] in "mM":
            return seconds(texts.str.to_time(HALF_DAYS, strict=False))
        days, hours, minutes, rest = texts.str.extract_groups(f"^{CLOCK.pattern}$").struct.unnest().cast(pl.Float64)
        return days.fill_null(0.0) * DAY + hours.fill_null(0.0) * 3600 + minutes * 60 + rest
    guesses = (texts.str.to_datetime(form, strict=False, time_zone="UTC") for form in FORMATS)
    return next((seconds(dates) for dates in guesses if dates.null_count() < len(dates)), None)
