"""NumPy archives (``.npz``)."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from gtau.errors import GtauError
from gtau.signals.formats.table import Table, readable, table_of_arrays


def open_npz(path: Path) -> Table:
    """Find the numeric arrays of an archive; pickled objects are refused, as reading them can run code.

    Raises
    ------
    GtauError
        The file is damaged, or holds pickled objects and no arrays.
    """
    with readable(path, "a NumPy archive"), np.load(path, allow_pickle=False) as archive:
        headers = {name: header for name in archive.files if (header := _header(archive, name)) is not None}
    pickled = [name for name, (_, dtype) in headers.items() if dtype.hasobject]
    arrays = {name: shape for name, (shape, dtype) in headers.items() if dtype.kind in "biuf"}
    if not arrays and pickled:
        raise GtauError(
            f"{path} holds pickled objects ('{pickled[0]}'), which are not read as they can run code; save plain "
            "numeric arrays (np.savez(path, t=..., q=..., current=...))."
        )

    @contextmanager
    def load(names: Collection[str]) -> Iterator[Mapping[str, Any]]:
        with np.load(path, allow_pickle=False) as archive:
            read = {name: archive[name] for name in names}
        yield read

    return table_of_arrays(path, arrays, load)


def _header(archive: Any, name: str) -> tuple[tuple[int, ...], np.dtype[Any]] | None:
    """Read shape and type of an array, without its values; None for another member of the archive."""
    members = archive.zip.namelist()
    with archive.zip.open(name if name in members else f"{name}.npy") as member:
        try:
            version = np.lib.format.read_magic(member)
        except ValueError:
            return None
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read(member)
    return shape, dtype
