"""Files of named arrays: NumPy's, MAT files (version 7.3: HDF5; older ones by SciPy), HDF5 and TDMS files."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gtau.errors import GtauError, needing, quoted
from gtau.signals.reading.formats import WIDEST, LogTable, common_length, numbers, readable
from gtau.signals.storage import block_size

if TYPE_CHECKING:
    import polars as pl

Shape = tuple[int, ...]

TIMED = "biufmM"  # kinds of numbers, durations and dates
EPISODE = re.compile(r"(.*/)?(demo|demonstration|episode|ep|trial|traj|trajectory|rollout|run)_?(\d+)/(.*)")
HDF5 = b"\x89HDF\r\n\x1a\n"  # after 512 bytes of MATLAB's own
NUMERIC = ["double", "single", "logical", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64"]
MOST_ARRAYS = 5000  # and groups, found in 2 s; data sets of 200 demonstrations have 3000
DEEPEST = 32  # groups in each other; the time to find what is in them grows as their square
DENSEST = 2000  # numbers in a byte of a file: Deflate packs 1032 bytes into one


def open_npy(path: Path) -> LogTable:
    """Find the columns of an array, by the fields of a structured one, else by number."""
    with readable(path, "a NumPy array"):
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    fields = {name: array[name] for name in array.dtype.names or ()} or {"": array}
    shapes = {name: field.shape for name, field in fields.items() if field.dtype.kind in TIMED}
    titles = {"": numbers(min(array.shape))} if array.ndim == 2 else {"": numbers(1)}
    return _table(path, shapes, lambda names: nullcontext({name: fields[name] for name in names}), titles=titles)


def open_npz(path: Path) -> LogTable:
    """Find the numeric arrays of an archive; pickled objects are refused, as reading them can run code.

    The field ``q`` of a structured array ``log`` is ``log.q``; the only array of texts names the columns of a matrix.
    """
    shapes, pickled = dict[str, Shape](), list[str]()
    places, texts = dict[str, tuple[str, str | None]](), list[str]()
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
            elif dtype.kind == "U" and len(shape) == 1 and shape[0] <= WIDEST:
                texts.append(name)
            for field, (kind, *_) in (dtype.fields or {}).items():
                if kind.base.kind in TIMED:
                    places[f"{name}.{field}"], shapes[f"{name}.{field}"] = (name, field), (*shape, *kind.shape)
            if dtype.kind in TIMED:
                places[name], shapes[name] = (name, None), shape
        columns = archive[texts[0]].tolist() if len(texts) == 1 else []
    if not shapes and pickled:
        raise GtauError(
            f"{path} holds pickled objects ('{pickled[0]}'), which are not read as they can run code; save plain "
            "numeric arrays (np.savez(path, t=..., q=..., current=...))."
        )
    matrices = [name for name, shape in shapes.items() if len(shape) == 2 and min(shape) == len(columns) > 1]
    unique = len({*columns}) == len(columns) and not {*columns} & shapes.keys()
    titles = {matrices[0]: columns} if len(matrices) == 1 and unique else {}

    @contextmanager
    def load(names: Collection[str]) -> Iterator[Mapping[str, Any]]:
        with np.load(path, allow_pickle=False) as archive:
            read = {member: archive[member] for member in {places[name][0] for name in names}}
            wanted = {name: places[name] for name in names}
            yield {
                name: read[member] if field is None else read[member][field] for name, (member, field) in wanted.items()
            }

    return _table(path, shapes, load, titles=titles)


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
    """Find the numeric arrays of a MAT file; the field ``q`` of a struct ``log``, which is read once, is ``log.q``.

    A signal of a structure with time, of Simulink, has the name of its label: ``out.q1.values``.
    """
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
        elif isinstance(value, list) and all(isinstance(item, Mapping) for item in value):  # Simulink's signals
            for k, item in enumerate(value, start=1):
                label = item.get("label")
                yield from _arrays(item, f"{prefix}{label if isinstance(label, str) and label else f'{name}[{k}]'}.")
        elif isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
            yield prefix + name, value.squeeze()


def open_hdf5(path: Path, kind: str = "an HDF5 file", between: str = "/") -> LogTable:
    """Find the numeric datasets of a file, of its groups too; their names are joined by ``between``."""
    with needing(f"reading {path} ({kind})", "h5py", "hdf5"):
        import h5py

    visited = list[str]()
    shapes, units = dict[str, Shape](), dict[str, str]()

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
            shapes[name] = item.shape
            unit = item.attrs.get("units", item.attrs.get("unit"))
            if isinstance(unit, str | bytes):
                units[name] = unit if isinstance(unit, str) else unit.decode(errors="replace")

    with readable(path, kind), h5py.File(path, "r") as file:
        file.visititems(visit)
    parts, episodes = _demonstrations(shapes)
    parts = {column.replace("/", between): names for column, names in parts.items()}
    joined = {
        column: (sum(shapes[name][0] for name in names), *shapes[names[0]][1:]) for column, names in parts.items()
    }

    @contextmanager
    def load(names: Collection[str]) -> Iterator[Mapping[str, Any]]:
        with h5py.File(path, "r") as file:
            read = {column: [file[name] for name in parts[column]] for column in names}
            yield {column: some[0] if len(some) == 1 else np.concatenate(some) for column, some in read.items()}

    by_column = {column: units[names[0]] for column, names in parts.items() if names[0] in units}
    return replace(_table(path, joined, load, by_column), episodes=episodes)


def _demonstrations(shapes: Mapping[str, Shape]) -> tuple[dict[str, list[str]], dict[int, range]]:
    """Put datasets ``demo_0/t``, ``demo_1/t`` one after another as ``t``; return also the rows of each demonstration.

    A column must have as many rows as others in each of them. Other datasets are columns of their own.
    """
    split = {name: EPISODE.fullmatch(name) for name in shapes}
    matches = {name: match for name, match in split.items() if match}
    if len(matches) < len(split) or not split:
        return {name: [name] for name, shape in shapes.items() if shape}, {}
    parts: dict[str, dict[int, str]] = {}
    for name in sorted(matches, key=lambda name: int(matches[name][3])):
        parts.setdefault((matches[name][1] or "") + matches[name][4], {})[int(matches[name][3])] = name
    lengths = {column: [(k, *shapes[name][:1]) for k, name in names.items()] for column, names in parts.items()}
    usual, _ = Counter(map(tuple, lengths.values())).most_common(1)[0]
    ends = list(accumulate(rows for _, rows in usual))
    episodes = {k: range(end - rows, end) for (k, rows), end in zip(usual, ends, strict=True)}
    kept = {column: [*names.values()] for column, names in parts.items() if tuple(lengths[column]) == usual}
    return kept, episodes if len(episodes) > 1 else {}


def open_tdms(path: Path) -> LogTable:
    """Find the numeric channels of a file of LabVIEW, with a column ``time`` where they are waveforms."""
    with needing(f"reading {path} (a TDMS file)", "nptdms", "tdms"):
        from nptdms import TdmsFile

    with readable(path, "a TDMS file"), TdmsFile.open(path) as file:
        groups = {group.name: group.channels() for group in file.groups()}
        prefix = {name: f"{name}/" if len(groups) > 1 else "" for name in groups}
        channels = {prefix[group] + channel.name: channel for group, some in groups.items() for channel in some}
        channels = {name: channel for name, channel in channels.items() if channel.dtype.kind in TIMED and len(channel)}
        places = {name: (channel.group_name, channel.name) for name, channel in channels.items()}
        shapes = {name: (len(channel),) for name, channel in channels.items()}
        units = {name: str(channel.properties.get("unit_string", "")) for name, channel in channels.items()}
        waveforms = {group: some[0] for group, some in groups.items() if some and "wf_increment" in some[0].properties}
        times = {f"{prefix[group]}time": channel for group, channel in waveforms.items()}
        steps = {name: channel.properties["wf_increment"] for name, channel in times.items() if name not in shapes}
        shapes |= {name: (len(times[name]),) for name in steps}

    @contextmanager
    def load(names: Collection[str]) -> Iterator[Mapping[str, Any]]:
        with TdmsFile.open(path) as file:
            computed = {name: steps[name] * np.arange(*shapes[name]) for name in names if name in steps}
            yield {name: file[places[name][0]][places[name][1]] for name in names if name not in steps} | computed

    return _table(path, shapes, load, {name: unit for name, unit in units.items() if unit})


def _table(
    path: Path,
    shapes: Mapping[str, Shape],
    load: Callable[[Collection[str]], AbstractContextManager[Mapping[str, Any]]],
    units: Mapping[str, str] | None = None,
    titles: Mapping[str, Sequence[str]] | None = None,
) -> LogTable:
    """Make a table of named arrays, whose longer axis counts the samples; ``load`` opens some of them.

    A two-dimensional array ``q`` of N samples by n gives the columns ``q[1]`` to ``q[n]``, or its ``titles``; what is
    wider than ``WIDEST``, of more axes or a single number is left out.
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
            column = titles[name][k] if titles and name in titles else name if size == long else f"{name}[{k + 1}]"
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
                    column = np.asarray(arrays[array][at if len(at) > 1 else at[0]])
                    column = column if column.dtype.kind in "mM" else column.astype(float)
                    frame[name] = pl.Series(column).extend_constant(None, stop - start - len(column))
                yield pl.DataFrame(frame), stop / count

    written = units or {}
    column_units = {name: unit for name, (array, _) in places.items() if (unit := written.get(array))}
    return LogTable(path, tuple(places), frames, units=column_units)


LOG_FORMATS = {
    ".npy": open_npy,
    ".npz": open_npz,
    ".tdms": open_tdms,
    ".mat": open_mat,
    ".h5": open_hdf5,
    ".hdf5": open_hdf5,
}
