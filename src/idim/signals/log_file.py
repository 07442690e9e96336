"""One log file, CSV or Parquet: the columns asked for, as numbers."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from idim.errors import IdimError

if TYPE_CHECKING:
    import polars as pl

SEPARATORS = ";\t, "  # a semicolon or tab first: their files may hold decimal commas
MISSING = ("", "na", "n/a", "null", "none")


@dataclass(frozen=True)
class LogFile:
    """Columns of a log.

    ``columns`` are float arrays (N,), nan where a value is missing or no number; ``texts`` holds,
    for every column that has such a value, the first one as written. Row 0 stands in ``first_line``
    of a text file; a Parquet file has rows, counted from 1.
    """

    path: Path
    columns: dict[str, np.ndarray]
    texts: dict[str, str]
    first_line: int = 1
    line_word: str = "line"


def read_log(path: str | Path, names: Iterable[str]) -> LogFile:
    """Read columns of a log by name.

    A ``.parquet`` file is read as such, anything else as CSV: columns separated by commas, semicolons,
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
    IdimError
        The file cannot be read, or a column is not in it.
    """
    path = Path(path)
    try:
        return _read_parquet(path, names) if path.suffix.lower() == ".parquet" else _read_csv(path, names)
    except OSError as error:
        raise IdimError(f"{path} cannot be read: {(error.strerror or str(error)).lower()}; check the path.") from None
    except UnicodeDecodeError:
        raise IdimError(f"{path} is not a text file; give a log as CSV or as .parquet.") from None


def _read_csv(path: Path, names: Iterable[str]) -> LogFile:
    import polars as pl

    with path.open(encoding="utf-8-sig") as file:
        first = file.readline().lstrip("# ").rstrip("\r\n")
    if not first:
        raise IdimError(f"{path} is empty or begins with an empty line; give a log with one sample a line.")
    separator = next((each for each in SEPARATORS if each in first), ",")
    fields = [field.strip().strip('"').strip() for field in first.split(separator)]
    header = not all(_is_number(field) or field.lower() in MISSING for field in fields)
    index = _find(path, names, fields if header else [str(i + 1) for i in range(len(fields))], header)
    stored = {name: f"column_{i + 1}" for name, i in index.items()}
    try:
        table = pl.read_csv(
            path,
            has_header=False,
            skip_rows=int(header),
            separator=separator,
            schema={f"column_{i + 1}": pl.String for i in range(len(fields))},
            columns=list(stored.values()),
        )
    except pl.exceptions.PolarsError as error:
        raise IdimError(_unreadable_line(path, separator, len(fields), str(error))) from None
    columns, texts = {}, {}
    for name, column in stored.items():
        text = table[column].str.strip_chars()
        if separator != ",":
            text = text.str.replace(",", ".", literal=True)
        columns[name], texts[name] = _numbers(text)
    return LogFile(path, columns, texts, first_line=1 + header)


def _read_parquet(path: Path, names: Iterable[str]) -> LogFile:
    import polars as pl

    try:
        schema = pl.read_parquet_schema(path)
        wanted = list(_find(path, names, list(schema), header=True))
        table = pl.read_parquet(path, columns=wanted)
    except pl.exceptions.PolarsError as error:
        raise IdimError(f"{path} is not a readable Parquet file ({str(error).splitlines()[0]}).") from None
    columns, texts = {}, {}
    for name in wanted:
        if not (schema[name].is_numeric() or schema[name] == pl.String):
            raise IdimError(f"{path}, column '{name}' holds {schema[name]} values; write it as numbers.")
        columns[name], texts[name] = _numbers(table[name])
    return LogFile(path, columns, texts, line_word="row")


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True


def _numbers(series: pl.Series) -> tuple[np.ndarray, str]:
    """Numbers of a column, nan where there is none, and the first entry that is none."""
    import polars as pl

    numbers = series.cast(pl.Float64, strict=False).to_numpy().astype(float)  # null becomes nan
    bad = np.flatnonzero(~np.isfinite(numbers))
    text = "" if not bad.size or series[int(bad[0])] is None else str(series[int(bad[0])])
    return numbers, text


def _find(path: Path, names: Iterable[str], columns: list[str], header: bool) -> dict[str, int]:
    """Positions of the wanted columns."""
    index = {}
    for name in names:
        if columns.count(name) > 1:
            raise IdimError(f"{path} has {columns.count(name)} columns named '{name}'; rename them.")
        if name not in columns:
            if not header:
                raise IdimError(
                    f"{path} has no column '{name}': it has no header, so its {len(columns)} columns are named "
                    f"1 to {len(columns)}."
                )
            close = get_close_matches(name, columns, n=1)
            hint = f"did you mean '{close[0]}'? Its" if close else "its"
            listed = ", ".join(columns[:40]) + (", ..." if len(columns) > 40 else "")
            raise IdimError(f"{path} has no column '{name}'; {hint} columns are {listed}.")
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
