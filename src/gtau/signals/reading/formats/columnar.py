"""Parquet files, folders of them, Feather files (Arrow IPC), and lines of JSON objects, by Polars.

A column of lists of numbers, such as ``observation.state`` of LeRobot, gives columns ``observation.state[1]`` and so
on, the field ``q`` of a structure ``arm`` the column ``arm.q``; rows of another ``episode_index`` are another episode.
``meta/info.json`` of its data set says which joints these are (https://huggingface.co/docs/lerobot): ``fps``, and by
feature its ``names``, a list or lists by their kind (``{"motors": [...]}``). Frames are in
``data/chunk-000/file-000.parquet``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from gtau.documents.files import in_order, json_in
from gtau.errors import GtauError
from gtau.signals.reading.formats import WIDEST, LogTable
from gtau.signals.storage import block_size

if TYPE_CHECKING:
    import polars as pl

EPISODE = "episode_index"
INFO = "meta/info.json"
DEPTH = 3  # folders between a file of frames and the data set


def open_parquet(path: Path) -> LogTable:
    """Find the columns of a Parquet file, of a folder of them (``part_2`` before ``part_10``), or of a data set."""
    import polars as pl

    parts = [path]
    if path.is_dir():
        parts = in_order(path.glob("*.parquet")) or in_order(path.glob("data/*/*.parquet"))
    if not parts:
        raise GtauError(f"the folder {path} holds no .parquet files; give a log as CSV or as .parquet.")
    return _table(path, parts, pl.scan_parquet, "Parquet")


def open_feather(path: Path) -> LogTable:
    """Find the columns of a Feather file, version 2 (Arrow IPC)."""
    import polars as pl

    return _table(path, [path], pl.scan_ipc, "Feather")


def open_json_lines(path: Path) -> LogTable:
    """Find the columns of a file with one JSON object a line."""
    import polars as pl

    return _table(path, [path], partial(pl.scan_ndjson, infer_schema_length=None), "JSON lines")


def _table(path: Path, parts: Sequence[Path], scan: Callable[[Path], pl.LazyFrame], form: str) -> LogTable:
    import polars as pl

    def refused(error: Exception) -> GtauError:
        return GtauError(f"{path} is not a readable {form} file ({str(error).splitlines()[0]}); export the log again.")

    try:
        tables = [scan(part) for part in parts]
        schema = tables[0].collect_schema()
        lengths = [table.select(pl.len()).collect().item() for table in tables]
        columns = _columns(schema, tables[0])
        episodes = _episodes(tables, schema)
    except pl.exceptions.PolarsError as error:
        raise refused(error) from None

    def frames(names: Sequence[str], rows: range) -> Iterator[tuple[pl.DataFrame, float]]:
        for name in names:
            kind = schema.get(name)
            if kind is not None and not (kind.is_numeric() or kind.is_temporal() or kind in (pl.String, pl.Boolean)):
                raise GtauError(f"{path}, column '{name}' holds {kind} values; write it as numbers.")
        first = 0  # row of the part
        for table, length in zip(tables, lengths, strict=True):
            begin, end = max(rows.start - first, 0), min(rows.stop - first, length)
            for start in range(begin, end, block_size()):
                stop = min(start + block_size(), end)
                try:
                    frame = table.select([columns[name] for name in names]).slice(start, stop - start).collect()
                except pl.exceptions.PolarsError as error:
                    raise refused(error) from None
                yield frame, (first + stop) / sum(lengths)
            first += length

    return LogTable(path, tuple(columns), frames, episodes=episodes)


def _columns(schema: Mapping[str, pl.DataType], table: pl.LazyFrame) -> dict[str, pl.Expr]:
    """Name the columns, and what selects them: one for each item of a column of lists, as many as the first row has."""
    import polars as pl

    columns: list[pl.Expr] = []
    entries: list[tuple[str, Any, pl.Expr]] = [(name, kind, pl.col(name)) for name, kind in schema.items()]
    while entries:
        name, kind, column = entries.pop(0)
        if isinstance(kind, pl.Struct):
            inside = ((field.name, field.dtype) for field in kind.fields)
            entries[:0] = [(f"{name}.{part}", dtype, column.struct.field(part)) for part, dtype in inside]
            continue
        width = 0
        if isinstance(kind, pl.List | pl.Array) and kind.inner.is_numeric():
            lists = column.cast(pl.List(kind.inner)).list
            first = table.select(lists.len()).head(1).collect()
            width = int(first.item() or 0) if len(first) else 0
        if 0 < width <= WIDEST:
            columns += [lists.get(k, null_on_oob=True).alias(f"{name}[{k + 1}]") for k in range(width)]
        else:
            columns.append(column.alias(name))
    return {column.meta.output_name(): column for column in columns}


def _episodes(parts: Sequence[pl.LazyFrame], schema: Mapping[str, pl.DataType]) -> dict[int, range]:
    import polars as pl

    if EPISODE not in schema or not schema[EPISODE].is_integer():
        return {}
    runs = pl.concat([part.select(EPISODE).collect() for part in parts])[EPISODE].rle().struct.unnest()
    if len(runs) < 2 or runs["value"].n_unique() < len(runs):
        return {}
    ends = runs["len"].cum_sum()
    episodes = zip(runs["value"], ends - runs["len"], ends, strict=True)
    return {int(number): range(start, stop) for number, start, stop in episodes if number is not None}


def data_set(log: Path, columns: Sequence[str]) -> tuple[float | None, dict[str, str]]:
    """Read rate (Hz) and labels of ``columns`` from the data set of a file of frames, or their folder, if any."""
    folders = [log, *log.absolute().parents[:DEPTH]]
    file = next((folder / INFO for folder in folders if (folder / INFO).is_file()), None)
    if file is None or not (log.is_dir() or log.suffix.lower() in LOG_FORMATS):
        return None, {}
    try:
        info = json_in(file.read_text(encoding="utf-8"))
        rate = None if info.get("fps") is None else float(info["fps"])
        features = {name: _flat(feature.get("names")) for name, feature in info.get("features", {}).items()}
    except (OSError, ValueError, TypeError, AttributeError):
        raise GtauError(
            f"{file} is not a readable description of a LeRobot data set; correct it, or move {log.name} out of "
            "its folder."
        ) from None
    return rate, {
        f"{feature}[{k + 1}]": f"{feature}/{name}"
        for feature, names in features.items()
        if f"{feature}[{len(names)}]" in columns and f"{feature}[{len(names) + 1}]" not in columns
        for k, name in enumerate(names)
    }


def _flat(names: Any) -> list[str]:
    if isinstance(names, Mapping):
        names = list(names.values())
    if isinstance(names, list):
        return [name for group in names for name in _flat(group)]
    return [names] if isinstance(names, str) else []


@contextmanager
def as_log(table: Any) -> Iterator[Path]:
    """Write a table to a temporary Parquet file for the context, so that it is read and checked like any log."""
    with TemporaryDirectory(prefix="gtau-") as folder:
        path = Path(folder) / "table.parquet"
        _frame(table).write_parquet(path)
        try:
            yield path
        except GtauError as error:
            raise GtauError(str(error).replace(str(path), "the table")) from None


def _frame(table: Any) -> Any:
    import polars

    if isinstance(table, polars.DataFrame | polars.LazyFrame):
        return table.lazy().collect()
    if isinstance(table, np.ndarray) and table.dtype.names:
        columns = {name: table[name] for name in table.dtype.names}
    elif isinstance(table, np.ndarray) and table.ndim == 2:
        columns = {str(k): column for k, column in enumerate(table.T, 1)}
    elif isinstance(table, Mapping) or hasattr(table, "columns"):  # the latter pandas, which need not be installed
        columns = {str(name): np.asarray(table[name]) for name in getattr(table, "columns", table)}
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


LOG_FORMATS = {
    ".parquet": open_parquet,
    ".feather": open_feather,
    ".arrow": open_feather,
    ".jsonl": open_json_lines,
    ".ndjson": open_json_lines,
}
