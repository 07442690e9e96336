"""MAT files: up to version 7 by SciPy, version 7.3 as the HDF5 file that it is."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from gtau.signals.formats.hdf5 import open_hdf5
from gtau.signals.formats.table import Table, readable, table_of_arrays

HDF5 = b"\x89HDF\r\n\x1a\n"  # after 512 bytes of MATLAB's own


def open_mat(path: Path) -> Table:
    """Find the numeric arrays of a MAT file; those of a struct ``log`` are named ``log.q``.

    Raises
    ------
    GtauError
        The file is damaged, or of version 7.3 and h5py is not installed.
    """
    with path.open("rb") as file:
        file.seek(512)
        if file.read(len(HDF5)) == HDF5:
            return open_hdf5(path, "a MAT file of version 7.3", between=".")
    from scipy.io import loadmat

    with readable(path, "a MAT file"):
        content = loadmat(path, simplify_cells=True, verify_compressed_data_integrity=True)
    arrays = dict(_arrays({name: value for name, value in content.items() if not name.startswith("__")}, ""))

    @contextmanager
    def load(_: Collection[str]) -> Iterator[Mapping[str, Any]]:
        yield arrays

    return table_of_arrays(path, {name: array.shape for name, array in arrays.items()}, load)


def _arrays(values: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, np.ndarray]]:
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _arrays(value, f"{prefix}{name}.")
        elif isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
            yield prefix + name, value
