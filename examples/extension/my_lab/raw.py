"""Logs of the recorder: a line with the names of the columns, then rows of numbers of 8 bytes."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import polars as pl

from gtau.signals.reading.formats import LogTable

ROWS = 100_000  # of a block


def open_raw(path: Path) -> LogTable:
    """Find the columns of a log."""
    with path.open("rb") as file:
        names = tuple(file.readline().decode().split())
        begin = file.tell()
    rows = np.memmap(path, np.float64, "r", begin).reshape(-1, len(names))

    def frames(wanted: Sequence[str], part: range) -> Iterator[tuple[pl.DataFrame, float]]:
        stop = min(part.stop, len(rows))
        for first in range(part.start, stop, ROWS):
            block = rows[first : min(first + ROWS, stop)]
            yield pl.DataFrame({name: block[:, names.index(name)] for name in wanted}), first / len(rows)

    return LogTable(path, names, frames)
