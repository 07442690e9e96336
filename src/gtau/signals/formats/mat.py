"""MAT files: up to version 7 by SciPy, version 7.3 as the HDF5 file that it is."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from gtau.errors import GtauError
from gtau.signals.formats.hdf5 import open_hdf5
from gtau.signals.formats.table import Table, readable, table_of_arrays

HDF5 = b"\x89HDF\r\n\x1a\n"  # after 512 bytes of MATLAB's own
NUMERIC = ("double", "single", "logical", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)))


def open_mat(path: Path) -> Table:
    """Find the numeric arrays of a MAT file; those of a struct ``log`` are named ``log.q``.

    Only requested variables are read, and each struct once, since its fields exist only in it.

    Raises
    ------
    GtauError
        The file is damaged, or of version 7.3 and h5py is not installed.
    """
    with path.open("rb") as file:
        file.seek(512)
        if file.read(len(HDF5)) == HDF5:
            return open_hdf5(path, "a MAT file of version 7.3", between=".")
    from scipy.io import loadmat, whosmat

    def variables(*names: str) -> dict[str, np.ndarray]:
        found = loadmat(path, simplify_cells=True, verify_compressed_data_integrity=True, variable_names=names)
        return dict(_arrays({name: found[name] for name in names}, ""))

    shapes: dict[str, tuple[int, ...]] = {}
    with readable(path, "a MAT file"):
        for name, shape, kind in whosmat(path):
            if kind == "struct":
                shapes |= {field: array.shape for field, array in variables(name).items()}
            elif kind in NUMERIC:
                shapes[name] = tuple(length for length in shape if length != 1)

    @contextmanager
    def load(names: Collection[str]) -> Iterator[Mapping[str, Any]]:
        arrays = variables(*{name.partition(".")[0] for name in names})
        if lost := set(names) - arrays.keys():
            raise GtauError(f"{path}: '{min(lost)}' holds complex numbers; give a column of real ones.")
        yield arrays

    return table_of_arrays(path, shapes, load)


def _arrays(values: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, np.ndarray]]:
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _arrays(value, f"{prefix}{name}.")
        elif isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
            yield prefix + name, value
