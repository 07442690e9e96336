"""One log file, CSV or Parquet: the columns asked for, as numbers, block by block."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gtau.documents.files import in_order
from gtau.errors import GtauError
from gtau.signals.storage import store

if TYPE_CHECKING:
    import polars as pl

SEPARATORS = ";\t, "  # a semicolon or tab first: their files may hold decimal commas
MISSING = ("", "na", "n/a", "null", "none")
BYTES = 1 << 22  # of a CSV file that are read at once
ROWS = 1 << 16  # of a Parquet file
ALL = range(1 << 62)  # rows

Place = tuple[int, int]
"""A row of a text file and the byte at which it begins."""


@dataclass(frozen=True)
class LogFile:
    """Columns ``names`` of a log, found but not yet read.

    ``texts`` holds, as far as the log has been read, for every column with a value that is missing or no
    number, the first one as written. Row 0 stands in ``first_line`` of a text file; a Parquet file has rows,
    counted from 1. ``frames`` gives tables of all these columns, of some rows, with the part of the log that is then
    done. ``places`` holds, as far as a text file has been read, rows and the bytes at which they begin.
    """

    path: Path
    names: tuple[str, ...]
    texts: dict[str, str]
    places: list[Place]
    frames: Callable[[range, Place], Iterator[tuple[pl.DataFrame, float]]]
    first_line: int = 1
    line_word: str = "line"

    def blocks(self, rows: range = ALL, place: Place = (0, 0)) -> Iterator[tuple[np.ndarray, float]]:
        """Numbers (M, columns), nan where a value is missing or no number, with the part of the log then done.

        Parameters
        ----------
        rows : range
            Those wanted.
        place : tuple of int
            One of the ``places``, at or before the first of them, found when the log was read before.

        Raises
        ------
        GtauError
            Where the file cannot be read on.
        """
        with _refusals(self.path):
            for frame, done in self.frames(rows, place):
                values = np.empty((len(frame), len(self.names)))
                for k, name in enumerate(self.names):
                    values[:, k], text = _numbers(frame[:, k])
                    if text is not None:
                        self.texts.setdefault(name, text)
                yield values, done

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """Whole columns (N,) by name; raises GtauError where the file cannot be read on."""
        table = store((values for values, _ in self.blocks()), (len(self.names),))
        return {name: table[:, k] for k, name in enumerate(self.names)}


def read_log(path: str | Path, names: Iterable[str]) -> LogFile:
    """Find columns of a log by name, to be read as :class:`LogFile` says.

    A ``.parquet`` file is read as such, a folder as the ``.parquet`` files in it one after the other (``part_2``
    before ``part_10``), anything else as CSV: columns separated by commas, semicolons,
    tabs or single spaces, decimal commas allowed except between comma separated columns. A first line
    that consists of numbers is data, and the columns are then named by their number from 1.

    Parameters
    ----------
    path : str or Path
        The log.
    names : iterable of str
        Columns wanted.

    Returns
    -------
    LogFile
        The wanted columns, unchecked.

    Raises
    ------
    GtauError
        The file cannot be read, or a column is not in it.
    """
    path, names = Path(path), tuple(dict.fromkeys(names))
    with _refusals(path):
        if path.is_dir() or path.suffix.lower() == ".parquet":
            return _of_parquet(path, names)
        return _of_csv(path, names)


@contextmanager
def _refusals(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise GtauError(f"{path} cannot be read: {(error.strerror or str(error)).lower()}; check the path.") from None
    except UnicodeDecodeError:
        raise GtauError(f"{path} is not a text file; give a log as CSV or as .parquet.") from None


def _of_csv(path: Path, names: tuple[str, ...]) -> LogFile:
    with path.open(encoding="utf-8-sig") as file:
        first = file.readline().lstrip("# ").rstrip("\r\n")
    if not first:
        raise GtauError(f"{path} is empty or begins with an empty line; give a log with one sample a line.")
    separator = next((each for each in SEPARATORS if each in first), ",")
    fields = [field.strip().strip('"').strip() for field in first.split(separator)]
    header = not all(_is_number(field) or field.lower() in MISSING for field in fields)
    index = _find(path, names, fields if header else [str(i + 1) for i in range(len(fields))], header)

    places: list[Place] = []

    def frames(rows: range, place: Place) -> Iterator[tuple[pl.DataFrame, float]]:
        first = place[0]
        for begin, text, done in _whole_lines(path, header, place[1]):
            if not places or places[-1][0] < first:
                places.append((first, begin))
            frame = _csv_frame(path, text, separator, len(fields), [index[name] for name in names])
            wanted = frame[max(rows.start - first, 0) : max(rows.stop - first, 0)]
            first += len(frame)
            if len(wanted):
                yield wanted, done
            if first >= rows.stop:
                return

    return LogFile(path, names, {}, places, frames, first_line=1 + header)


def _csv_frame(path: Path, text: bytes, separator: str, count: int, wanted: list[int]) -> pl.DataFrame:
    import polars as pl

    columns = [f"column_{i + 1}" for i in range(count)]
    try:
        frame = pl.read_csv(
            text,
            has_header=False,
            separator=separator,
            schema=dict.fromkeys(columns, pl.String),
            columns=sorted(columns[i] for i in wanted),
            raise_if_empty=False,
        )
    except pl.exceptions.PolarsError as error:
        raise GtauError(_unreadable_line(path, separator, count, str(error))) from None
    entries = pl.col(pl.String).str.strip_chars()
    if separator != ",":
        entries = entries.str.replace(",", ".", literal=True)
    return frame.select(columns[i] for i in wanted).select(entries)


def _whole_lines(path: Path, header: bool, begin: int) -> Iterator[tuple[int, bytes, float]]:
    """Lines of a text file from the byte ``begin`` on, many at once and each of them whole.

    With the byte at which they begin, and the part of the file that is then done.
    """
    size, torn = path.stat().st_size, b""
    with path.open("rb") as file:
        if begin:
            file.seek(begin)
        elif header:
            file.readline()
        elif file.read(3) != b"\xef\xbb\xbf":  # a byte-order mark
            file.seek(0)
        begin = file.tell()
        while read := file.read(BYTES):
            end = read.rfind(b"\n") + 1
            if end:
                text, torn = torn + read[:end], b""
                yield begin, text, file.tell() / size
                begin += len(text)
            torn += read[end:]
    if torn:
        yield begin, torn, 1.0


def _of_parquet(path: Path, names: tuple[str, ...]) -> LogFile:
    import polars as pl

    parts = in_order(path.glob("*.parquet")) if path.is_dir() else [path]
    if not parts:
        raise GtauError(f"the folder {path} holds no .parquet files; give a log as CSV or as .parquet.")
    try:
        schema = pl.read_parquet_schema(parts[0])
        lengths = [pl.scan_parquet(part).select(pl.len()).collect().item() for part in parts]
    except pl.exceptions.PolarsError as error:
        raise _no_parquet(path, error) from None
    for name in _find(path, names, list(schema), header=True):
        if schema[name].is_temporal():
            raise GtauError(
                f"{path}, column '{name}' holds dates or times ({schema[name]}); write the seconds since the first "
                "sample, as numbers."
            )
        if not (schema[name].is_numeric() or schema[name] == pl.String):
            raise GtauError(f"{path}, column '{name}' holds {schema[name]} values; write it as numbers.")

    def frames(rows: range, place: Place) -> Iterator[tuple[pl.DataFrame, float]]:
        first = 0  # row of the part
        for part, length in zip(parts, lengths, strict=True):
            begin, end = max(rows.start - first, 0), min(rows.stop - first, length)
            for start in range(begin, end, ROWS):
                stop = min(start + ROWS, end)
                try:
                    frame = pl.scan_parquet(part).select(names).slice(start, stop - start).collect()
                except pl.exceptions.PolarsError as error:
                    raise _no_parquet(path, error) from None
                yield frame, (first + stop) / sum(lengths)
            first += length

    return LogFile(path, names, {}, [], frames, line_word="row")


def _no_parquet(path: Path, error: Exception) -> GtauError:
    return GtauError(f"{path} is not a readable Parquet file ({str(error).splitlines()[0]}).")


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True


def _numbers(series: pl.Series) -> tuple[np.ndarray, str | None]:
    """Numbers of a column, nan where there is none, and the first entry that is none, if any."""
    import polars as pl

    numbers = series.cast(pl.Float64, strict=False).to_numpy().astype(float)  # null becomes nan
    bad = np.flatnonzero(~np.isfinite(numbers))
    if not bad.size:
        return numbers, None
    entry = series[int(bad[0])]
    return numbers, "" if entry is None else str(entry)


def _find(path: Path, names: Iterable[str], columns: list[str], header: bool) -> dict[str, int]:
    """Positions of the wanted columns."""
    index = {}
    for name in names:
        if columns.count(name) > 1:
            raise GtauError(f"{path} has {columns.count(name)} columns named '{name}'; rename them.")
        if name not in columns:
            if not header:
                raise GtauError(
                    f"{path} has no column '{name}': it has no header, so its {len(columns)} columns are named "
                    f"1 to {len(columns)}."
                )
            close = get_close_matches(name, columns, n=1)
            hint = f"did you mean '{close[0]}'? Its" if close else "its"
            listed = ", ".join(columns[:40]) + (", ..." if len(columns) > 40 else "")
            raise GtauError(f"{path} has no column '{name}'; {hint} columns are {listed}.")
        index[name] = columns.index(name)
    return index


def _unreadable_line(path: Path, separator: str, count: int, reason: str) -> str:
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        for number, line in enumerate(file, start=1):
            found = line.count(separator) + 1
            if found > count:
                return (
                    f"{path}, line {number} has {found} columns where the first line has {count}; "
                    "correct the line (a header must name every column)."
                )
    return f"{path} is not a readable CSV file ({reason.splitlines()[0]})."
