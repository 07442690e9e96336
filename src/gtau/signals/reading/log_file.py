"""Log files of any format, or tables in memory: requested columns as numbers, block by block."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from gtau.errors import GtauError
from gtau.extensions import Extensions
from gtau.signals.reading.formats import Table
from gtau.signals.reading.formats.columnar import INFO, open_parquet
from gtau.signals.reading.formats.rosbag import open_rosbag
from gtau.signals.reading.formats.text import open_text
from gtau.signals.storage import store

if TYPE_CHECKING:
    import polars as pl


FORMATS: Extensions[Callable[[Path], Table]] = Extensions("gtau.log_formats", "gtau.signals.reading.formats", Callable)
"""Readers by the ending of the file's name; any other file is text."""

ALL = range(1 << 62)  # rows


@dataclass(frozen=True)
class LogFile:
    """Columns ``names`` of a log, located but not yet read.

    ``texts`` holds, as far as the log has been read, for every column with a value that is missing or not a number,
    the first one as written.
    """

    path: Path
    names: tuple[str, ...]
    texts: dict[str, str]
    table: Table

    def blocks(self, rows: range = ALL) -> Iterator[tuple[np.ndarray, float]]:
        """Read numbers (M, columns), nan where a value is missing or not a number, with the fraction read so far.

        Parameters
        ----------
        rows : range
            Those wanted.

        Raises
        ------
        GtauError
            Where the file cannot be read on.
        """
        with _refusals(self.path):
            for frame, done in self.table.frames(self.names, rows):
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
    """Locate columns of a log by name, as a :class:`LogFile`.

    The file name extension gives the format; see :data:`FORMATS`.

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
    table = find_columns(path)
    _refuse_missing(path, names, table)
    return LogFile(path, names, {}, table)


def find_columns(path: Path) -> Table:
    """Find all columns of a log, whatever its format; raises GtauError where it cannot be read."""
    with _refusals(path):
        if path.is_dir():
            return open_rosbag(path) if (path / "metadata.yaml").is_file() else open_parquet(path)
        path.open("rb").close()  # the system's reason, not a library's, where there is no such file
        return (FORMATS.find(path.suffix.lower()) or open_text)(path)


def is_log_folder(path: Path) -> bool:
    """Decide whether a folder is one log: a rosbag2, Parquet files, or a LeRobot data set."""
    return any((path / each).is_file() for each in ("metadata.yaml", INFO)) or any(path.glob("*.parquet"))


def is_rosbag(path: Path) -> bool:
    """Decide by its name whether a path is a bag."""
    return (path / "metadata.yaml").is_file() or FORMATS.built_in.get(path.suffix.lower()) is open_rosbag


@contextmanager
def _refusals(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise GtauError(f"{path} cannot be read: {(error.strerror or str(error)).lower()}; check the path.") from None


def _numbers(series: pl.Series) -> tuple[np.ndarray, str | None]:
    """Read numbers of a column, nan for other entries, and the first non-numeric entry, if any."""
    import polars as pl

    numbers = series.cast(pl.Float64, strict=False).to_numpy().astype(float)  # null becomes nan
    bad = np.flatnonzero(~np.isfinite(numbers))
    if not bad.size:
        return numbers, None
    entry = series[int(bad[0])]
    return numbers, "" if entry is None else str(entry)


def _refuse_missing(path: Path, names: Iterable[str], table: Table) -> None:
    columns = list(table.columns)
    if not columns:
        raise GtauError(
            f"{path} holds no columns of numbers; save the signals as plain numeric arrays, not as objects such as "
            "tables or time series."
        )
    for name in names:
        if columns.count(name) > 1:
            raise GtauError(f"{path} has {columns.count(name)} columns named '{name}'; rename them.")
        if name in table.unusable:
            raise GtauError(f"{path}, column '{name}' {table.unusable[name]}.")
        if name in columns:
            continue
        if table.numbered:
            raise GtauError(
                f"{path}: there is no column '{name}'; the file has no header, so its {len(columns)} columns are named "
                f"1 to {len(columns)}."
            )
        close = get_close_matches(name, columns, n=1)
        hint = f"did you mean '{close[0]}'? The" if close else "the"
        listed = ", ".join(columns[:40]) + (", ..." if len(columns) > 40 else "")
        raise GtauError(f"{path}: there is no column '{name}'; {hint} columns are {listed}.")


NAME = "table"


@contextmanager
def as_log(table: Any) -> Iterator[Path]:
    """Write a table to a temporary Parquet file for the context, so that it is read and checked like any log.

    Parameters
    ----------
    table : polars.DataFrame, pandas.DataFrame, mapping or ndarray
        Columns by name; those of an array (N, columns) without names are numbered from 1.

    Raises
    ------
    GtauError
        Where it is none of these, or its columns have different lengths.
    """
    with TemporaryDirectory(prefix="gtau-") as folder:
        path = Path(folder) / f"{NAME}.parquet"
        _frame(table).write_parquet(path)
        try:
            yield path
        except GtauError as error:
            raise GtauError(str(error).replace(str(path), f"the {NAME}")) from None


def _frame(table: Any) -> Any:
    import polars

    if isinstance(table, polars.DataFrame):
        return table
    if isinstance(table, polars.LazyFrame):
        return table.collect()
    if isinstance(table, np.ndarray) and table.dtype.names:
        columns = {name: table[name] for name in table.dtype.names}
    elif isinstance(table, np.ndarray) and table.ndim == 2:
        columns = {str(k): column for k, column in enumerate(table.T, 1)}
    elif isinstance(table, Mapping) or hasattr(table, "columns"):  # the latter pandas, which need not be installed
        columns = {
            str(name): np.asarray(table[name]) for name in (table.columns if hasattr(table, "columns") else table)
        }
    else:
        raise GtauError(
            f"a log cannot be a {type(table).__name__}; give the path of a file, a Polars or pandas data frame, a "
            "mapping of columns, or an array of samples by columns."
        )
    try:
        return polars.DataFrame(columns)
    except (polars.exceptions.PolarsError, TypeError, ValueError) as error:
        raise GtauError(
            f"the {NAME} cannot be used as a log ({str(error).splitlines()[0]}); correct its columns."
        ) from None
