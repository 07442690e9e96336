"""HDF5 files (``.h5``, ``.hdf5``), and MAT files of version 7.3, which are such."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from gtau.errors import missing_extra
from gtau.signals.formats.table import Table, readable, table_of_arrays


def open_hdf5(path: Path, kind: str = "an HDF5 file", between: str = "/") -> Table:
    """Find the numeric datasets of a file, of its groups too; their names are joined by ``between``.

    Nothing is read before it is asked for, and then in blocks.

    Raises
    ------
    GtauError
        h5py is not installed, or the file is damaged.
    """
    try:
        import h5py
    except ImportError:
        raise missing_extra(f"reading {path} ({kind})", "h5py", "hdf5") from None

    datasets: dict[str, str] = {}
    shapes: dict[str, tuple[int, ...]] = {}

    def visit(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and item.dtype.kind in "biuf" and not name.startswith("#"):
            column = name.replace("/", between)
            datasets[column], shapes[column] = name, item.shape

    with readable(path, kind), h5py.File(path, "r") as file:
        file.visititems(visit)

    @contextmanager
    def load(names: Collection[str]) -> Iterator[Mapping[str, Any]]:
        with h5py.File(path, "r") as file:
            yield {column: file[datasets[column]] for column in names}

    return table_of_arrays(path, shapes, load)
