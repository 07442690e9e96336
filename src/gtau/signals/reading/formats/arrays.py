"""Files of named arrays: NumPy archives, MAT files (version 7.3: HDF5; older ones by SciPy), and HDF5 files."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gtau.errors import GtauError, missing_extra, quoted
from gtau.signals.reading.formats import WIDEST, LogTable, common_length, readable
from gtau.signals.storage import block_size

if TYPE_CHECKING:
    import polars as pl

Shape = tuple[int, ...]

HDF5 = b"\x89HDF\r\n\x1a\n"  # after 512 bytes of MATLAB's own
NUMERIC = ["double", "single", "logical", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64"]
MOST_ARRAYS = 5000  # and groups, found in 2 s; data sets of 200 demonstrations have 3000
DEEPEST = 32  # groups in each other; the time to find what is in them grows as their square
DENSEST = 2000  # numbers in a byte of a file: Deflate packs 1032 bytes into one


def open_npz(path: Path) -> LogTable:
    """Find the numeric arrays of an archive; pickled objects are refused, as reading them can run code."""
    shapes, pickled = dict[str, Shape](), list[str]()
    with readable(path, "a NumPy archive"), np.load(path, allow_pickle=False) as archive:
        _refuse_many(path, len(archive.files))
        members = {*archive.zip.namelist()}
        for name in archive.files:
            file = name if name in members else f"{name}.npy"
            if (header := _header(archive.zip, file)) is None:
                continue
            shape, dtype = header
            if dtype.hasobject:
                pickled.append(name)
            elif dtype.kind in "biuf":
                shapes[name] = shape
    if not shapes and pickled:
        raise GtauError(
            f"{path} holds pickled objects ('{pickled[0]}'), which are not read as they can run code; save plain "
            "numeric arrays (np.savez(path, t=..., q=..., current=...))."
        )

    @contextmanager
    def load(names: Collection[str]) -> Iterator[Mapping[str, Any]]:
        with np.load(path, allow_pickle=False) as archive:
            yield {name: archive[name] for name in names}

    return _table(path, shapes, load)


def _refuse_many(path: Path, count: int) -> None:
    if count > MOST_ARRAYS:
        raise GtauError(f"it holds more than {MOST_ARRAYS} arrays; export the signals of one motion.", source=path)


def _header(archive: Any, file: str) -> tuple[Shape, np.dtype[Any]] | None:
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
    """Find the numeric arrays of a MAT file; the field ``q`` of a struct ``log``, which is read once, is ``log.q``."""
    with path.open("rb") as file:
        file.seek(512)
        if file.read(len(HDF5)) == HDF5:
            return open_hdf5(path, "a MAT file of version 7.3", between=".")
    from scipy.io import loadmat, whosmat

    def variables(names: Collection[str]) -> dict[str, np.ndarray]:
        loaded = loadmat(path, simplify_cells=True, verify_compressed_data_integrity=True, variable_names=names)
        return dict(_arrays({name: loaded[name] for name in names}, ""))

    shapes: dict[str, Shape] = {}
    with readable(path, "a MAT file"):
        for name, shape, kind in whosmat(path):
            if kind == "struct":
                shapes |= {field: array.shape for field, array in variables([name]).items()}
            elif kind in NUMERIC:
                shapes[name] = tuple(length for length in shape if length != 1)

    def load(names: Collection[str]) -> AbstractContextManager[Mapping[str, Any]]:
        arrays = variables({name.partition(".")[0] for name in names})
        if lost := set(names) - arrays.keys():
            raise GtauError(f"'{min(lost)}' holds complex numbers; give a column of real ones.", source=path)
        return nullcontext(arrays)

    return _table(path, shapes, load)


def _arrays(values: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, np.ndarray]]:
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _arrays(value, f"{prefix}{name}.")
        elif isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
            yield prefix + name, value


def open_hdf5(path: Path, kind: str = "an HDF5 file", between: str = "/") -> LogTable:
    """Find the numeric datasets of a file, of its groups too; their names are joined by ``between``."""
    try:
        import h5py
    except ImportError:
        raise missing_extra(f"reading {path} ({kind})", "h5py", "hdf5") from None

    visited = list[str]()
    datasets, shapes, units = dict[str, str](), dict[str, Shape](), dict[str, str]()

    def visit(name: str, item: Any) -> None:
        visited.append(name)
        _refuse_many(path, len(visited))
        if name.count("/") > DEEPEST:
            raise GtauError(f"its groups are nested more than {DEEPEST} deep; export the log flatter.", source=path)
        if not isinstance(item, h5py.Dataset):
            return
        if item.is_virtual or item.external:
            raise GtauError(
                f"the values of {quoted(name)} are in other files; give a file that holds them.", source=path
            )
        if item.dtype.kind in "biuf" and not name.startswith("#"):
            column = name.replace("/", between)
            datasets[column], shapes[column] = name, item.shape
            unit = item.attrs.get("units", item.attrs.get("unit"))
            if isinstance(unit, str | bytes):
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
    shapes: Mapping[str, Shape],
    load: Callable[[Collection[str]], AbstractContextManager[Mapping[str, Any]]],
    units: Mapping[str, str] | None = None,
) -> LogTable:
    """Make a table of named arrays, whose longer axis counts the samples; ``load`` opens some of them.

    A two-dimensional array ``q`` of N samples by n gives the columns ``q[1]`` to ``q[n]``; what is wider than
    ``WIDEST``, of more axes or a single number is left out.
    """
    places: dict[str, tuple[str, tuple[Any, ...]]] = {}  # array, and the index of a column in it
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
        for k in range(size // long):
            column = name if size == long else f"{name}[{k + 1}]"
            number = (k,) * (len(shape) - 1)
            index = (*number, ...) if shape[-1] == long else (..., *number)
            places[column], rows[column] = (name, index), long

    def frames(names: Sequence[str], wanted: range) -> Iterator[tuple[pl.DataFrame, float]]:
        import polars as pl

        count = common_length(path, {name: rows[name] for name in names}, more=1)  # a last row that others lack
        with readable(path, "a log"), load({places[name][0] for name in names}) as arrays:
            end = min(wanted.stop, count)
            for start in range(wanted.start, end, block_size()):
                stop, frame = min(start + block_size(), end), {}
                for name in names:
                    array, index = places[name]
                    at = tuple(slice(start, stop) if k is ... else k for k in index)
                    column = np.asarray(arrays[array][at], dtype=float)
                    frame[name] = np.pad(column, (0, stop - start - len(column)), constant_values=np.nan)
                yield pl.DataFrame(frame), stop / count

    written = units or {}
    column_units = {name: unit for name, (array, _) in places.items() if (unit := written.get(array))}
    return LogTable(path, tuple(places), frames, units=column_units)


LOG_FORMATS = {".npz": open_npz, ".mat": open_mat, ".h5": open_hdf5, ".hdf5": open_hdf5}
