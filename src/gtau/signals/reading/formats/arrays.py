"""Files of named arrays: NumPy archives (``.npz``), MAT files, and HDF5 files (``.h5``, ``.hdf5``).

SciPy reads MAT files up to version 7; MAT files of version 7.3 are HDF5 files.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gtau.errors import GtauError, missing_extra, quoted
from gtau.signals.reading.formats import WIDEST, LogTable, common_length, readable
from gtau.signals.storage import block_size

if TYPE_CHECKING:
    import polars as pl

HDF5 = b"\x89HDF\r\n\x1a\n"  # after 512 bytes of MATLAB's own
NUMERIC = ["double", "single", "logical", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64"]
MOST_ARRAYS = 5000  # and groups, found in 2 s; data sets of 200 demonstrations have 3000
DEEPEST = 32  # groups in each other; the time to find what is in them grows as their square
DENSEST = 2000  # numbers in a byte of a file: Deflate packs 1032 bytes into one


def open_npz(path: Path) -> LogTable:
    """Find the numeric arrays of an archive; pickled objects are refused, as reading them can run code."""
    with readable(path, "a NumPy archive"), np.load(path, allow_pickle=False) as archive:
        _refuse_many(path, len(archive.files))
        members = {*archive.zip.namelist()}
        files = {name: name if name in members else f"{name}.npy" for name in archive.files}
        headers = {name: header for name, file in files.items() if (header := _header(archive.zip, file)) is not None}
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

    return _table(path, arrays, load)


def _refuse_many(path: Path, count: int) -> None:
    if count > MOST_ARRAYS:
        raise GtauError(f"it holds more than {MOST_ARRAYS} arrays; export the signals of one motion.", source=path)


def _header(archive: Any, file: str) -> tuple[tuple[int, ...], np.dtype[Any]] | None:
    """Read shape and type of an array, without its values; None for another member of the archive."""
    with archive.open(file) as member:
        try:
            version = np.lib.format.read_magic(member)
        except ValueError:
            return None
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read(member)
    return shape, dtype


def open_mat(path: Path) -> LogTable:
    """Find the numeric arrays of a MAT file; the field ``q`` of a struct ``log`` is named ``log.q``.

    Only requested variables are read, and each struct once, since its fields exist only in it.
    """
    with path.open("rb") as file:
        file.seek(512)
        if file.read(len(HDF5)) == HDF5:
            return open_hdf5(path, "a MAT file of version 7.3", between=".")
    from scipy.io import loadmat, whosmat

    def variables(*names: str) -> dict[str, np.ndarray]:
        loaded = loadmat(path, simplify_cells=True, verify_compressed_data_integrity=True, variable_names=names)
        return dict(_arrays({name: loaded[name] for name in names}, ""))

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
            raise GtauError(f"'{min(lost)}' holds complex numbers; give a column of real ones.", source=path)
        yield arrays

    return _table(path, shapes, load)


def _arrays(values: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, np.ndarray]]:
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _arrays(value, f"{prefix}{name}.")
        elif isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
            yield prefix + name, value


def open_hdf5(path: Path, kind: str = "an HDF5 file", between: str = "/") -> LogTable:
    """Find the numeric datasets of a file, of its groups too; their names are joined by ``between``.

    Nothing is read before it is asked for, and then in blocks.
    """
    try:
        import h5py
    except ImportError:
        raise missing_extra(f"reading {path} ({kind})", "h5py", "hdf5") from None

    datasets: dict[str, str] = {}
    shapes: dict[str, tuple[int, ...]] = {}
    units: dict[str, str] = {}

    count = 0

    def visit(name: str, item: Any) -> None:
        nonlocal count
        count += 1
        _refuse_many(path, count)
        if name.count("/") > DEEPEST:
            raise GtauError(f"its groups are nested more than {DEEPEST} deep; export the log flatter.", source=path)
        if isinstance(item, h5py.Dataset) and (item.is_virtual or item.external):
            raise GtauError(
                f"the values of {quoted(name)} are in other files; give a file that holds them.", source=path
            )
        if isinstance(item, h5py.Dataset) and item.dtype.kind in "biuf" and not name.startswith("#"):
            column = name.replace("/", between)
            datasets[column], shapes[column] = name, item.shape
            if isinstance(unit := item.attrs.get("units", item.attrs.get("unit")), str | bytes):
                units[column] = unit if isinstance(unit, str) else unit.decode(errors="replace")

    with readable(path, kind), h5py.File(path, "r") as file:
        file.visititems(visit)

    @contextmanager
    def load(names: Collection[str]) -> Iterator[Mapping[str, Any]]:
        with h5py.File(path, "r") as file:
            yield {column: file[datasets[column]] for column in names}

    return _table(path, shapes, load, units)


def _table(
    path: Path,
    shapes: Mapping[str, tuple[int, ...]],
    load: Callable[[Collection[str]], AbstractContextManager[Mapping[str, Any]]],
    units: Mapping[str, str] | None = None,
) -> LogTable:
    """Make a table of named arrays, whose longer axis counts the samples; ``load`` opens some of them.

    A two-dimensional array ``q`` of N samples by n gives the columns ``q[1]`` to ``q[n]``; what is wider than
    ``WIDEST``, of more axes or a single number is left out. The ``units`` are by array.
    """
    places: dict[str, tuple[str, tuple[int, ...], tuple[int, ...]]] = {}  # array, and what is before and after samples
    rows: dict[str, int] = {}
    most = DENSEST * path.stat().st_size
    for name, shape in shapes.items():
        size, long = math.prod(shape), max(shape, default=0)
        if size > most:
            raise GtauError(
                f"{quoted(name)} is said to hold {size} numbers, more than the file can; export the log again.",
                source=path,
            )
        if size < 2 or len(shape) > 2 or size > WIDEST * long:
            continue
        last = shape[-1] == long
        for k in range(size // long):
            column = name if size == long else f"{name}[{k + 1}]"
            number = (k,) * (len(shape) - 1)
            places[column], rows[column] = (name, number if last else (), () if last else number), long

    def frames(names: Sequence[str], wanted: range) -> Iterator[tuple[pl.DataFrame, float]]:
        import polars as pl

        count = common_length(path, {name: rows[name] for name in names}, more=1)  # a last row that others lack
        with readable(path, "a log"), load({places[name][0] for name in names}) as arrays:
            end = min(wanted.stop, count)
            for start in range(wanted.start, end, block_size()):
                stop, frame = min(start + block_size(), end), {}
                for name in names:
                    array, before, after = places[name]
                    column = np.asarray(arrays[array][(*before, slice(start, stop), *after)], dtype=float)
                    frame[name] = np.append(column, [np.nan] * (stop - start - len(column)))
                yield pl.DataFrame(frame), stop / count

    array_units = units or {}
    column_units = {name: array_units[place[0]] for name, place in places.items() if array_units.get(place[0])}
    return LogTable(path, tuple(places), frames, units=column_units)


LOG_FORMATS = {".npz": open_npz, ".mat": open_mat, ".h5": open_hdf5, ".hdf5": open_hdf5}
