"""Text logs: columns separated by commas, semicolons, tabs or spaces, in blocks of whole lines.

Loggers write titles, settings and units before their table, and a log that was cut begins with half a row. The table
begins with the first ``ROWS_ALIKE`` lines of mostly numbers that have as many fields.
"""

from __future__ import annotations

import csv
import gzip
import re
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from itertools import accumulate, islice
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, cast

from gtau.documents.files import BINARY, LOG, kind_of, refuse_other_kind
from gtau.errors import GtauError
from gtau.findings import Finding
from gtau.signals.reading.formats import LogTable, is_instant, numbers, reading
from gtau.signals.reading.units import unit_row
from gtau.signals.storage import BYTES, block_size

if TYPE_CHECKING:
    import polars as pl

SEPARATORS = ";\t, "  # a semicolon or tab first: their files may hold decimal commas
MISSING = ("", "na", "n/a", "null", "none", "nan")
LOOK = 200  # lines at most that stand before a table,
ENOUGH = 1 << 21  # bytes of them, after which a header and some rows of any width have been read
ROWS_ALIKE = 4
LONGEST = 1 << 20  # bytes of a line; in the shared logs 954 at most
BOM = b"\xef\xbb\xbf"


def open_text(path: Path) -> LogTable:
    """Find the columns of a text log, named by their number from 1 without a header; text before it is noted."""
    lines, first_byte = _first_lines(path)
    texts = [_decoded(line).lstrip("# ").rstrip("\r\n") for line in lines]
    fields = [_fields(text) for text in texts]
    written = [k for k, names in enumerate(fields) if any(names)]
    if not written:
        raise GtauError(f"{path} is empty or begins with an empty line; give a log with one sample a line.")
    first = _first_row(fields, written)
    if path.suffix.lower() != ".gz" and (first is None or kind_of(path) is not BINARY):  # zeros may precede a table
        refuse_other_kind(path, LOG)
    # Without rows, or with none of numbers, the first line names what the others lack.
    header = written[0] if first is None else _header(texts, fields, first)
    begin = written[0] + 1 if first is None else first
    row = written[0] if first is None else first
    separator, width = _separator(texts[row]), len(fields[row])
    if "\ufffd" in "".join(fields[row if header is None else header]):
        raise GtauError(f"{path} is not a text file; give a log as CSV or as .parquet.")
    if header is not None and any(fields[row][len(fields[header]) :]):
        raise GtauError(
            f"line {row + 1} has {width} columns where the header in line {header + 1} has {len(fields[header])}; "
            "correct the line (a header must name every column, and a decimal comma between commas makes two of one).",
            source=path,
        )

    titles = [k for k in range(begin if header is None else header, begin) if len(fields[k]) == width]
    titles = titles or ([] if header is None else [header])
    quoted = (entries for text, entries in zip(texts[row:], fields[row:], strict=True) if '"' in text)
    decimal_commas = separator != "," or _decimal_commas(quoted)
    columns, units, title_lines = _columns({k: fields[k] for k in titles}, width)
    first_byte += sum(map(len, lines[:begin]))

    def frames(names: Sequence[str], rows: range) -> Iterator[tuple[pl.DataFrame, float]]:
        places = {name: k for k, name in enumerate(columns)}
        row, wanted = 0, [places[name] for name in names]
        for text, done in _whole_lines(path, first_byte):
            frame = _frame(table, separator, decimal_commas, text, wanted)
            part = frame[max(rows.start - row, 0) : max(rows.stop - row, 0)]
            row += len(frame)
            if len(part):
                yield part, done
            if row >= rows.stop:
                return

    notes: tuple[Finding, ...] = ()
    if skipped := [k + 1 for k in written if k < begin and k not in title_lines]:
        which = f"lines {skipped[0]} to {skipped[-1]}" if len(skipped) > 1 else f"line {skipped[0]}"
        names = "" if header is None else f", took the names of its columns from line {title_lines[0] + 1}"
        notes = (reading("skipped lines", text=f"skipped {which} before the table{names}"),)
    table = LogTable(path, columns, frames, begin + 1, notes, units=units)
    return table


def _columns(titles: dict[int, tuple[str, ...]], width: int) -> tuple[tuple[str, ...], dict[str, str], list[int]]:
    """Name columns by the lines above a table, with the units in one of them; return also the lines that were taken.

    A name that spans columns, as over merged cells of a spreadsheet, stands before the names in the line below.
    """
    first = next((k for k, fields in titles.items() if len(set(filter(None, fields))) == width), LOOK)
    units = {k: row for k, fields in titles.items() if len(titles) > 1 and (row := unit_row(fields, k > first))}
    unit_line = max(units, default=None)
    names = {k: fields for k, fields in titles.items() if k != unit_line}
    names = {k: fields for k, fields in names.items() if sum(map(bool, fields)) > 1} or names  # a title is no names
    if not names:
        return numbers(width), {}, []
    (line, columns), *below = names.items()
    title_lines = [line] if unit_line is None else [line, unit_line]
    columns += ("",) * (width - len(columns))
    if below and len(set(columns)) < width:
        spanning: Iterator[str] = accumulate(columns, lambda before, name: name or before)
        columns = tuple(f"{name} {lower}".strip() for name, lower in zip(spanning, below[0][1], strict=True))
        title_lines.append(below[0][0])
    by_column = zip(columns, units[unit_line] if unit_line is not None else (), strict=False)
    return columns, {name: unit for name, unit in by_column if unit}, title_lines


@contextmanager
def _opened(path: Path) -> Iterator[tuple[BinaryIO, BinaryIO]]:
    """Open a text, also a compressed one, and the file as it is stored."""
    with path.open("rb") as raw:
        if path.suffix.lower() != ".gz":
            yield raw, raw
            return
        try:
            yield cast(BinaryIO, gzip.GzipFile(fileobj=raw)), raw
        except (EOFError, gzip.BadGzipFile, zlib.error) as error:
            raise GtauError(f"{path} cannot be unpacked ({error}); give the unpacked log, or copy it again.") from None


def _first_lines(path: Path) -> tuple[list[bytes], int]:
    """Read the lines that may precede a table, and find the byte at which they begin; refuse other text."""
    with _opened(path) as (file, _):
        head = file.read(1 << 12)
        if head.startswith((b"\xff\xfe", b"\xfe\xff")) and head.count(0) > 0.3 * len(head):
            raise GtauError("the log is text in UTF-16; save it as UTF-8 (in Excel: 'CSV UTF-8').", source=path)
        if head.count(b"\r") > ROWS_ALIKE and b"\n" not in head:
            raise GtauError(
                f"{path} ends its lines with carriage returns alone; save it with line feeds ('Unix' or 'PC')."
            )
        begin = len(BOM) if head.startswith(BOM) else 0
        file.seek(begin)
        lines: list[bytes] = []
        while len(lines) < LOOK and file.tell() < ENOUGH and (line := file.readline(LONGEST + 1)):
            _refuse_long_line(path, len(line), len(lines) + 1)
            lines.append(line)
    return lines, begin


def _separator(text: str) -> str:
    outside = re.sub(r'"[^"]*"', "", text)
    return next((character for part in (outside, text) for character in SEPARATORS if character in part), ",")


def _fields(text: str) -> tuple[str, ...]:
    fields, unquoted = _split(text, _separator(text))
    stripped = (field.strip() for field in fields)
    if unquoted:  # remaining quotes belong to a name
        return tuple(stripped)
    return tuple(field.strip("'" if field.startswith("'") else '"').strip() for field in stripped)


def _is_row(fields: Sequence[str]) -> bool:
    numbers = sum(_is_number(field) for field in fields)
    rest = sum(field.lower() in MISSING for field in fields)
    instant = not _is_number(fields[0]) and is_instant(fields[0])
    begins = _is_number(fields[0]) or fields[0].lower() in MISSING or instant
    return begins and numbers > 0 and 2 * (numbers + rest + instant) > len(fields)


def _first_row(fields: Sequence[tuple[str, ...]], written: Sequence[int]) -> int | None:
    """Find the first of ``ROWS_ALIKE`` similar rows, or of the last few, among the ``written`` lines."""
    row = cache(lambda k: _is_row(fields[k]))
    for i, k in enumerate(written):
        if all(row(line) and len(fields[line]) == len(fields[k]) for line in written[i : i + ROWS_ALIKE]):
            return k
    return next(filter(row, written), None)


def _header(texts: Sequence[str], fields: Sequence[tuple[str, ...]], first: int) -> int | None:
    """Find the line that names the columns: the topmost line just before the rows with as many fields."""
    header, nearest, width = None, None, len(fields[first])
    for line in reversed(range(first)):
        if any(fields[line]) and not _is_row(fields[line]):
            nearest = line if nearest is None else nearest
            if len(fields[line]) == width:
                header = line
                continue
        if header is not None:
            return header
    if header is not None or nearest is None:
        return header
    alike = _separator(texts[nearest]) == _separator(texts[first])
    # One that lacks names, which is refused, or a title.
    return nearest if alike and 2 * len(fields[nearest]) >= width else None


def _refuse_long_line(path: Path, length: int, number: int | None = None) -> None:
    """Refuse a line too long for a row of a table, before it fills the memory; raises GtauError."""
    if length > LONGEST:
        where = "a line" if number is None else f"line {number}"
        raise GtauError(
            f"{where} is longer than {LONGEST >> 20} MB, too long for a row of a log; write one sample per line.",
            source=path,
        )


def _decoded(raw: bytes) -> str:
    """Decode a line in UTF-8, or else in Windows-1252 where that gives printable characters alone."""
    try:
        return raw.decode()
    except UnicodeDecodeError:
        text = raw.decode("cp1252", errors="replace")
        return text if text.replace("\t", "").rstrip("\r\n").isprintable() else raw.decode(errors="replace")


def _split(text: str, separator: str) -> tuple[list[str], bool]:
    """Split a line into fields, and say whether quotes were removed; any number of spaces separates as one does."""
    if '"' in text:
        try:
            return next(csv.reader([text.strip(" ")], delimiter=separator, skipinitialspace=True)), True
        except csv.Error:  # a field of rubble, longer than any name
            pass
    return text.split() if separator == " " and text.strip() else text.split(separator), False


def _is_number(text: str) -> bool:
    try:
        return float(text.replace(",", ".")) == float(text.replace(",", "."))
    except ValueError:
        return False


def _decimal_commas(rows: Iterable[Sequence[str]]) -> bool:
    """Decide whether quoted numbers between commas have decimal commas, and not thousands behind these."""
    numbers = [field for row in rows for field in row if _is_number(field)]
    commas = [number for number in numbers if "," in number]
    return "." not in "".join(numbers) and not all(re.fullmatch(r"[-+]?[1-9]\d{0,2},\d{3}", text) for text in commas)


def _frame(table: LogTable, separator: str, decimal_commas: bool, text: bytes, wanted: list[int]) -> pl.DataFrame:
    import polars as pl

    columns = [f"column_{k + 1}" for k in range(len(table.columns))]
    if separator == " ":
        text = re.sub(rb"(?m)^ +| +(?=\r?$)", b"", re.sub(rb" {2,}", b" ", text))
    end = text.find(b"\n") if b"\n" in text else len(text)
    if lacking := len(columns) - 1 - text.count(separator.encode(), 0, end):  # a cut row, which Polars takes
        text = text[:end].rstrip(b"\r") + separator.encode() * lacking + text[end:]  # for all there are

    def read(text: bytes) -> pl.DataFrame:
        schema, names = dict.fromkeys(columns, pl.String), sorted(columns[k] for k in wanted)
        return pl.read_csv(
            text, has_header=False, separator=separator, schema=schema, columns=names, raise_if_empty=False
        )

    try:
        try:
            frame = read(text)
        except pl.exceptions.PolarsError:
            again = "".join(_decoded(line) for line in text.splitlines(keepends=True))
            if "\ufffd" in again or again.encode() == text:
                raise
            frame = read(again.encode())
    except pl.exceptions.PolarsError as error:
        raise GtauError(_unreadable_line(table, separator, str(error))) from None
    entries = pl.col(pl.String).str.strip_chars()
    if decimal_commas:
        entries = entries.str.replace(",", ".", literal=True)
    return frame.select(columns[k] for k in wanted).select(entries)


def _whole_lines(path: Path, begin: int) -> Iterator[tuple[bytes, float]]:
    """Read blocks of whole lines from the byte ``begin`` on, each with the part of the file that is then read."""
    size, torn = path.stat().st_size, b""
    with _opened(path) as (file, raw):
        file.seek(begin)
        while read := file.read(BYTES * block_size()):
            end = read.rfind(b"\n") + 1
            if end:
                text, torn = torn + read[:end], b""
                yield text, raw.tell() / size
            torn += read[end:]
            _refuse_long_line(path, len(torn))
    if torn:
        yield torn, 1.0


def _unreadable_line(table: LogTable, separator: str, reason: str) -> str:
    path, count, first = table.path, len(table.columns), table.first_line or 1
    where = f"line {first}" if table.numbered else "the header"
    with _opened(path) as (file, _):
        for number, line in islice(enumerate(map(_decoded, file), start=1), first - 1, None):
            if (fields := len(_split(line, separator)[0])) > count:
                advice = "correct or delete the line (a header must name every column)"
                return f"{path}, line {number} has {fields} columns where {where} has {count}; {advice}."
            if "\ufffd" in line:
                advice = "delete the line, or record the log again"
                return f"{path}, line {number} is not text: the log is damaged there; {advice}."
    return f"{path} is not a readable CSV file ({reason.splitlines()[0]})."


LOG_FORMATS = {".csv": open_text, ".gz": open_text}
"""It reads any other ending too."""
