"""Arrays larger than memory, written and read block by block, and the size of these blocks."""

from __future__ import annotations

import mmap
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import BinaryIO, cast

import numpy as np

from gtau.errors import GtauError


@dataclass(frozen=True)
class Sizes:
    """Sizes that bound the memory of a long log; results depend on the last one only.

    Attributes
    ----------
    block : int
        Samples processed at once.
    in_memory : int
        Largest array kept in memory, bytes.
    rows, text : int
        Rows of a table, and bytes of a text file, that are read at once.
    looked_at : int
        Samples from which quantiles are computed. Of 2^18 the one that 0.1 % exceed is exceeded by 0.088 to 0.112 %.
    """

    block: int = 1 << 16
    in_memory: int = 1 << 22
    rows: int = 1 << 16
    text: int = 1 << 22
    looked_at: int = 1 << 18


_current: ContextVar[Sizes] = ContextVar("sizes", default=Sizes())  # noqa: B039 (it is frozen)


def sizes() -> Sizes:
    """Return the sizes in use."""
    return _current.get()


@contextmanager
def working_with(chosen: Sizes) -> Iterator[None]:
    """Use other sizes in this thread for the duration of the context."""
    token = _current.set(chosen)
    try:
        yield
    finally:
        _current.reset(token)


def stride_of(samples: int) -> int:
    """Choose the step between the samples of a long log from which quantiles are computed."""
    return max(-(-samples // sizes().looked_at), 1)


def spans(samples: int, size: int = 0) -> Iterator[tuple[int, int]]:
    """Yield the first sample, and the one after the last, of blocks of ``size`` that make up ``samples``."""
    size = size or sizes().block
    return ((start, min(start + size, samples)) for start in range(0, samples, size))


class Store:
    """Array that grows by blocks; a long one is stored in a file deleted with it.

    The file has no name: it is in the folder for temporary files (``TMPDIR``), and even a killed program leaves
    nothing there.

    Parameters
    ----------
    width : tuple of int
        Shape of a row.
    dtype : type
        Of the entries.
    """

    def __init__(self, width: tuple[int, ...] = (), dtype: type = float):
        self._width, self._dtype = width, dtype
        self._held: list[np.ndarray] = []
        self._rows = self._size = 0
        self._file: BinaryIO | None = None

    def append(self, rows: np.ndarray) -> None:
        """Add rows at the end; raises GtauError where the folder for temporary files is full."""
        self._held.append(np.array(rows, dtype=self._dtype))
        self._rows += len(rows)
        self._size += self._held[-1].nbytes
        if self._size > sizes().in_memory:
            self._write()

    def array(self) -> np.ndarray:
        """Return all rows; raises GtauError where the folder for temporary files is full."""
        if self._file is None:
            return np.concatenate([np.zeros((0, *self._width), self._dtype), *self._held])
        self._write()
        return _mapped(self._file, (self._rows, *self._width), self._dtype)

    def _write(self) -> None:
        with _room():
            if self._file is None:
                self._file = cast(BinaryIO, tempfile.TemporaryFile())  # noqa: SIM115 (it lives as long as what is mapped)
            for rows in self._held:
                self._file.write(rows.tobytes())
            self._file.flush()
        self._held.clear()


@contextmanager
def _room() -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise GtauError(
            f"a long log needs some GB in the folder for temporary files, {tempfile.gettempdir()}, which is full "
            f"({(error.strerror or str(error)).lower()}); make room there, or set TMPDIR to "
            "another folder."
        ) from None


def _mapped(file: BinaryIO, shape: tuple[int, ...], dtype: type) -> np.ndarray:
    with file:
        return np.ndarray(shape, dtype, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))


def store(blocks: Iterable[np.ndarray], width: tuple[int, ...] = (), dtype: type = float) -> np.ndarray:
    """Store the blocks one after the other as one array; see :class:`Store`."""
    rows = Store(width, dtype)
    for each in blocks:
        rows.append(each)
    return rows.array()


def rows_at(array: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Copy the rows of an array of any length at increasing ``places``."""
    rows = Store(array.shape[1:], array.dtype.type)
    for start, stop in spans(len(array)):
        first, last = np.searchsorted(places, [start, stop])
        rows.append(block(array, start, stop)[places[first:last] - start])
    return rows.array()


def block(array: np.ndarray, start: int, stop: int) -> np.ndarray:
    """Copy some rows of an array; a stored one releases their memory afterwards."""
    copy = array[start:stop].copy()
    file = stored(array)
    if file is not None and hasattr(mmap, "MADV_DONTNEED"):
        file.madvise(mmap.MADV_DONTNEED)
    return copy


def stored(array: np.ndarray) -> mmap.mmap | None:
    """Return the file of an array that is not in memory."""
    owner: object = array
    while isinstance(owner, np.ndarray):
        owner = owner.base
    return owner if isinstance(owner, mmap.mmap) else None
