"""Tables in memory as logs: Polars and pandas data frames, arrays, mappings of columns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from gtau.errors import GtauError

NAME = "table"


@contextmanager
def as_log(table: Any) -> Iterator[Path]:
    """Write a table as a Parquet file that exists as long as the context, so that it is read and checked as any log.

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
