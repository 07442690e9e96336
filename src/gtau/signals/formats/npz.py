"""NumPy archives (``.npz``)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
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
        arrays, pickled = {}, []
        for name in archive.files:
            try:
                array = archive[name]
            except ValueError:  # an object array
                pickled.append(name)
                continue
            if array.dtype.kind in "biuf":
                arrays[name] = array
    if not arrays and pickled:
        raise GtauError(
            f"{path} holds pickled objects ('{pickled[0]}'), which are not read as they can run code; save plain "
            "numeric arrays (np.savez(path, t=..., q=..., current=...))."
        )

    @contextmanager
    def load() -> Iterator[Mapping[str, Any]]:
        yield arrays

    return table_of_arrays(path, {name: array.shape for name, array in arrays.items()}, load)
