"""Arrays larger than memory, written and read block by block, and the size of these blocks."""

from __future__ import annotations

import mmap
import tempfile
from collections.abc import Iterable, Iterator
from contextvars import ContextVar
from typing import BinaryIO, cast

import numpy as np

from gtau.errors import GtauError

BYTES = 64  # of a text file that are read at once, and of an array that are kept in memory, for a sample of a block
LOOKED_AT = 4  # blocks of samples from which quantiles are computed. Of 2^18 samples the one that 0.1 % exceed is
# exceeded by 0.088 to 0.112 %.

SAMPLES: ContextVar[int] = ContextVar("samples", default=1 << 16)
"""Samples of a block."""


def block_size() -> int:
    """Return the number of samples (rows of a table) that are processed at once, which bounds the memory."""
    return SAMPLES.get()


def stride_of(samples: int) -> int:
    """Choose the step between the samples of a long log from which quantiles are computed."""
    return max(-(-samples // (LOOKED_AT * block_size())), 1)


def spans(samples: int, size: int = 0, before: int = 0) -> Iterator[tuple[int, int]]:
    """Yield start and stop of blocks of ``size`` that make up ``samples``, each with some samples ``before`` it."""
    size = size or block_size()
    return ((max(start - before, 0), min(start + size, samples)) for start in range(0, samples, size))


def blocks(array: np.ndarray, before: int = 0) -> Iterator[np.ndarray]:
    """Copy an array of any length block by block, each with some rows ``before`` it."""
    return (block(array, start, stop) for start, stop in spans(len(array), before=before))


def steps(array: np.ndarray) -> Iterator[np.ndarray]:
    """Compute the steps from row to row of an array of any length, block by block."""
    return (np.diff(part, axis=0) for part in blocks(array, before=1))


class Store:
    """Array that grows by blocks of rows of a ``width``; a long one is stored in a file deleted with it.

    The file has no name: it is in the folder for temporary files, and even a killed program leaves nothing there.
    """

    def __init__(self, width: tuple[int, ...] = (), dtype: type = float):
        self._width, self._dtype = width, dtype
        self._held: list[np.ndarray] = []
        self._rows = self._size = 0
        self._file: BinaryIO | None = None

    def append(self, rows: np.ndarray) -> None:
        """Add rows at the end."""
        self._held.append(np.array(rows, dtype=self._dtype))
        self._rows += len(rows)
        self._size += self._held[-1].nbytes
        if self._size > BYTES * block_size():
            self._write()

    def array(self) -> np.ndarray:
        """Return all rows."""
        if self._file is None:
            return np.concatenate([np.zeros((0, *self._width), self._dtype), *self._held])
        self._write()
        with self._file as file:
            mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        return np.ndarray((self._rows, *self._width), self._dtype, mapped)

    def _write(self) -> None:
        try:
            if self._file is None:
                self._file = cast(BinaryIO, tempfile.TemporaryFile())  # noqa: SIM115 (it lives as long as what is mapped)
            for rows in self._held:
                self._file.write(rows.tobytes())
            self._file.flush()
        except OSError as error:
            raise GtauError(
                f"a long log needs some GB in the folder for temporary files, {tempfile.gettempdir()}, which is full "
                f"({(error.strerror or str(error)).lower()}); make room there, or set TMPDIR to another folder."
            ) from None
        self._held.clear()


def store(parts: Iterable[np.ndarray], width: tuple[int, ...] = (), dtype: type = float) -> np.ndarray:
    """Store blocks of rows one after the other as one array; see :class:`Store`."""
    rows = Store(width, dtype)
    for part in parts:
        rows.append(part)
    return rows.array()


def stored_like(array: np.ndarray, parts: Iterable[np.ndarray]) -> np.ndarray:
    """Store blocks of rows with the shape and type of an array's rows."""
    return store(parts, array.shape[1:], array.dtype.type)


def rows_at(array: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Copy the rows of an array of any length at increasing ``places``."""
    pieces = ((start, places[slice(*np.searchsorted(places, (start, stop)))]) for start, stop in spans(len(array)))
    return stored_like(array, (block(array, start, start + block_size())[at - start] for start, at in pieces))


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
