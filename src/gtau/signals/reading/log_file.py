"""Log files of any format, or tables in memory: requested columns as numbers, block by block."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

import numpy as np

from gtau.documents.files import system_refusals
from gtau.errors import GtauError
from gtau.extensions import find
from gtau.signals.reading.formats import Table
from gtau.signals.reading.formats.columnar import INFO
from gtau.signals.reading.formats.rosbag import LOG_FORMATS as BAGS
from gtau.signals.reading.formats.text import open_text


def reader_of(ending: str) -> Callable[[Path], Table] | None:
    """Find the reader of files whose name has an ending (``.npz``); None where it has none of its own."""
    found = find("gtau.log_formats", "gtau.signals.reading.formats", ending, Callable)
    return cast("Callable[[Path], Table] | None", found)


def read_log(path: str | Path, names: Iterable[str]) -> Table:
    """Locate columns of a log by name, unchecked; the ending of its name gives the format, see :func:`reader_of`.

    Raises
    ------
    GtauError
        The file cannot be read, or a column is not in it.
    """
    table = find_columns(Path(path))
    names = tuple(dict.fromkeys(names))
    _refuse_missing(names, table)
    return replace(table, columns=names)


def find_columns(path: Path) -> Table:
    """Find all columns of a log, whatever its format; raises GtauError where it cannot be read."""
    with system_refusals(path):
        if not path.is_dir():
            path.open("rb").close()  # the system's reason, not a library's, where there is no such file
        reader = reader_of(_ending(path)) or open_text
        return reader(path)


def _ending(path: Path) -> str:
    """Return the ending of a file's name, or that of the files in a folder."""
    if path.is_dir():
        return ".db3" if (path / "metadata.yaml").is_file() else ".parquet"
    return path.suffix.lower()


def is_log_folder(path: Path) -> bool:
    """Decide whether a folder is one log: a rosbag2, Parquet files, or a LeRobot data set."""
    return any((path / name).is_file() for name in ("metadata.yaml", INFO)) or any(path.glob("*.parquet"))


def is_rosbag(path: Path) -> bool:
    """Decide by its name whether a path is a bag."""
    return path.suffix.lower() in BAGS or (path / "metadata.yaml").is_file()


def _refuse_missing(names: Iterable[str], table: Table) -> None:
    path, columns = table.path, table.columns
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
                f"there is no column '{name}'; the file has no header, so its {len(columns)} columns are named "
                f"1 to {len(columns)}.",
                source=path,
            )
        close = get_close_matches(name, columns, n=1)
        hint = f"did you mean '{close[0]}'? The" if close else "the"
        listed = ", ".join(columns[:40]) + (", ..." if len(columns) > 40 else "")
        raise GtauError(f"there is no column '{name}'; {hint} columns are {listed}.", source=path)


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
        path = Path(folder) / "table.parquet"
        _frame(table).write_parquet(path)
        try:
            yield path
        except GtauError as error:
            raise GtauError(str(error).replace(str(path), "the table")) from None


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
            f"the table cannot be used as a log ({str(error).splitlines()[0]}); correct its columns."
        ) from None
