"""Readers of log formats, one module per family, and what each returns: a :class:`Table` of columns, not yet read."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from gtau.errors import GtauError
from gtau.signals.notes import Note

if TYPE_CHECKING:
    import polars as pl

WIDEST = 256  # columns of one array; a wider one is an image or a map, not signals


@dataclass(frozen=True)
class Table:
    """Columns of a log, found but not yet read.

    ``frames`` reads columns by name, some rows of them: Polars frames, block by block, each with the fraction of the
    log that is then read. Row 0 is in ``first_line`` of a text file; other logs have rows, counted from 1.
    ``numbered``: the log has no header, and its columns are named by their number. ``notes`` report what the reader
    left out; ``unusable`` says of columns that hold no numbers what to do. ``episodes`` are the rows of each, by its
    number, where the log is of several. ``labels`` say what columns are whose names do not, and ``rate`` (Hz) how
    often its rows were recorded, where files beside the log do.
    """

    columns: tuple[str, ...]
    frames: Callable[[Sequence[str], range], Iterator[tuple[pl.DataFrame, float]]]
    first_line: int = 1
    line_word: str = "row"
    numbered: bool = False
    notes: tuple[Note, ...] = ()
    unusable: Mapping[str, str] = field(default_factory=dict)
    episodes: Mapping[int, range] = field(default_factory=dict)
    labels: Mapping[str, str] = field(default_factory=dict)
    rate: float | None = None


@contextmanager
def readable(path: Path, kind: str) -> Iterator[None]:
    """Turn whatever a library raises on a damaged file into one sentence; ``kind`` such as ``a MAT file``."""
    try:
        yield
    except (GtauError, MemoryError):
        raise
    except Exception as error:  # libraries raise what they like, down to AssertionError
        if isinstance(error, OSError) and error.errno is not None:  # of the system; HDF5's have no number
            raise
        reason = (str(error).splitlines() or [type(error).__name__])[0].rstrip(".")
        raise GtauError(f"{path} cannot be read as {kind} ({reason}); export the log again.") from None


def common_length(path: Path, lengths: Mapping[str, int]) -> int:
    """Count the rows of columns that must have as many; raises GtauError."""
    if len(set(lengths.values())) > 1:
        (one, rows), *others = lengths.items()
        other = next(name for name, count in others if count != rows)
        raise GtauError(
            f"{path}: '{one}' has {rows} rows but '{other}' has {lengths[other]}; give columns that were sampled "
            "together, or each topic's own stamps (time: {position: COLUMN, command: COLUMN})."
        )
    return next(iter(lengths.values()))
