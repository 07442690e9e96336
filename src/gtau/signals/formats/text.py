"""Text logs: columns separated by commas, semicolons, tabs or spaces, in blocks of whole lines."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from gtau.errors import GtauError
from gtau.signals.formats.table import Table
from gtau.signals.formats.text_layout import BOM, Layout, decoded, layout_of, refuse_long_line, split
from gtau.signals.storage import sizes

if TYPE_CHECKING:
    import polars as pl


def open_text(path: Path) -> Table:
    """Find the columns of a text log.

    Decimal commas are allowed except between comma separated columns. What stands before the table is skipped, and a
    note says so. Without a header the columns are named by their number from 1.

    Raises
    ------
    GtauError
        The file is empty or no text.
    """
    layout = layout_of(path)

    def frames(names: Sequence[str], rows: range) -> Iterator[tuple[pl.DataFrame, float]]:
        first = 0
        wanted = [layout.columns.index(name) for name in names]
        for text, done in _whole_lines(path, layout.first_byte):
            frame = _frame(path, layout, text, wanted)
            part = frame[max(rows.start - first, 0) : max(rows.stop - first, 0)]
            first += len(frame)
            if len(part):
                yield part, done
            if first >= rows.stop:
                return

    return Table(layout.columns, frames, layout.first_line, "line", layout.numbered, layout.notes)


def _frame(path: Path, layout: Layout, text: bytes, wanted: list[int]) -> pl.DataFrame:
    import polars as pl

    columns = [f"column_{k + 1}" for k in range(len(layout.columns))]
    if layout.separator == " ":
        text = re.sub(rb"(?m)^ +| +(?=\r?$)", b"", re.sub(rb" {2,}", b" ", text))
    end = text.find(b"\n") if b"\n" in text else len(text)
    if lacking := len(columns) - 1 - text.count(layout.separator.encode(), 0, end):  # a cut row, which Polars takes
        text = text[:end].rstrip(b"\r") + layout.separator.encode() * lacking + text[end:]  # for all there are

    def read(text: bytes) -> pl.DataFrame:
        return pl.read_csv(
            text,
            has_header=False,
            separator=layout.separator,
            schema=dict.fromkeys(columns, pl.String),
            columns=sorted(columns[k] for k in wanted),
            raise_if_empty=False,
        )

    try:
        frame = read(text)
    except pl.exceptions.PolarsError as error:
        again = "".join(decoded(line) for line in text.splitlines(keepends=True))
        if "\ufffd" in again or again.encode() == text:
            raise GtauError(_unreadable_line(path, layout, str(error))) from None
        frame = read(again.encode())
    entries = pl.col(pl.String).str.strip_chars()
    if layout.separator != ",":
        entries = entries.str.replace(",", ".", literal=True)
    return frame.select(columns[k] for k in wanted).select(entries)


def _whole_lines(path: Path, begin: int) -> Iterator[tuple[bytes, float]]:
    """Read blocks of whole lines from the byte ``begin`` on, each with the part of the file that is then read."""
    size, torn = path.stat().st_size, b""
    with path.open("rb") as file:
        file.seek(begin)
        if not begin and file.read(len(BOM)) != BOM:
            file.seek(0)
        while read := file.read(sizes().text):
            end = read.rfind(b"\n") + 1
            if end:
                text, torn = torn + read[:end], b""
                yield text, file.tell() / size
            torn += read[end:]
            refuse_long_line(path, len(torn))
    if torn:
        yield torn, 1.0


def _unreadable_line(path: Path, layout: Layout, reason: str) -> str:
    count = len(layout.columns)
    with path.open("rb") as file:
        for number, line in enumerate(map(decoded, file), start=1):
            found = len(split(line, layout.separator))
            if number >= layout.first_line and found > count:
                where = f"line {layout.first_line}" if layout.numbered else "the header"
                return (
                    f"{path}, line {number} has {found} columns where {where} has {count}; correct or delete the line "
                    "(a header must name every column)."
                )
            if number >= layout.first_line and "\ufffd" in line:
                return (
                    f"{path}, line {number} is not text: the log is damaged there; delete the line, or record the log "
                    f"again."
                )
    return f"{path} is not a readable CSV file ({reason.splitlines()[0]})."
