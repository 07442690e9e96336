"""Keys of content: equal for equal inputs wherever they lie, different after any change."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import cache, partial
from importlib.metadata import version
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np

from gtau.documents.files import in_order
from gtau.errors import GtauError
from gtau.signals.sizes import sizes
from gtau.signals.storage import block, spans

Digests = dict[int, tuple[object, bytes]]
LIBRARIES = ("casadi", "numba", "numpy", "polars", "scipy")


def content_key(value: Any, digests: Digests | None = None) -> str:
    """Compute the SHA-256 of a value's content, a hexadecimal text.

    Files and folders count by their bytes, not by their names; functions by their names, not by their source.

    Parameters
    ----------
    value : object
        Dataclasses, pydantic models, mappings, sequences, arrays, numbers, texts, paths and functions, nested.
    digests : dict, optional
        Digests of large arrays already read, by their address; added to. It spares reading them again for every key.

    Raises
    ------
    GtauError
        Where a file cannot be read.
    TypeError
        For an object without content.
    """
    found = hashlib.sha256()
    _fold(found, value, {} if digests is None else digests)
    return found.hexdigest()


@cache
def library_versions() -> tuple[str, ...]:
    """Return the versions of the libraries that compute the numbers."""
    return tuple(f"{name} {version(name)}" for name in LIBRARIES)


@cache
def program_digest() -> str:
    """Digest the source of the package and the versions of the libraries: any edit changes it."""
    root = Path(__file__).parents[1]
    found = hashlib.sha256(" ".join(library_versions()).encode())
    for path in sorted(root.rglob("*.py")):
        found.update(str(path.relative_to(root)).encode() + b"\0" + hashlib.sha256(path.read_bytes()).digest())
    return found.hexdigest()


def _fold(found: Any, value: Any, digests: Digests) -> None:
    """Add a value to a hash, with its type and size so that no two ways to nest the same items look alike."""
    kind = type(value)
    found.update(f"({kind.__module__}.{kind.__qualname__} ".encode())
    match value:
        case None | bool() | int() | float() | complex() | np.generic():
            found.update(repr(value).encode())
        case str():
            found.update(f"{len(value)} {value}".encode(errors="surrogateescape"))
        case bytes():
            found.update(f"{len(value)} ".encode() + value)
        case Path():
            found.update(_of_path(value).encode())
        case np.ndarray():
            if value.dtype.hasobject:
                raise TypeError("an array of objects has no content key")
            found.update(f"{value.dtype.str} {value.shape} ".encode())
            found.update(_of_array(value, digests))
        case Mapping():
            for key, each in value.items():
                _fold(found, key, digests)
                _fold(found, each, digests)
        case frozenset() | set():
            for key in sorted(content_key(each, digests) for each in value):
                found.update(key.encode())
        case list() | tuple():
            for each in value:
                _fold(found, each, digests)
        case slice() | range():
            _fold(found, (value.start, value.stop, value.step), digests)
        case partial():
            _fold(found, (value.func, value.args, value.keywords), digests)
        case FunctionType() if "<" not in value.__qualname__:
            found.update(f"{value.__module__}.{value.__qualname__}".encode())
        case _ if is_dataclass(value):
            for field in fields(value):
                _fold(found, (field.name, getattr(value, field.name)), digests)
        case _ if hasattr(kind, "model_fields"):  # a pydantic model
            for name in kind.model_fields:
                _fold(found, (name, getattr(value, name)), digests)
        case _:
            raise TypeError(f"a {kind.__qualname__} has no content key")
    found.update(b")")


def _of_array(array: np.ndarray, digests: Digests) -> bytes:
    """Digest an array's bytes, read in blocks: it may be a memory-mapped file."""
    if id(array) in digests:
        return digests[id(array)][1]
    found, rows = hashlib.sha256(), np.atleast_1d(array)
    for start, stop in spans(len(rows)):
        found.update(np.ascontiguousarray(block(rows, start, stop)).data)
    if array.size > sizes().block:
        digests[id(array)] = array, found.digest()
    return found.digest()


def _of_path(path: Path) -> str:
    """Digest a file's bytes, or the names and digests of a folder's files."""
    try:
        if path.is_dir():
            parts = in_order(each for each in path.iterdir() if each.is_file())
            return " ".join(f"{len(each.name)} {each.name} {_of_path(each)}" for each in parts)
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise GtauError(f"{path} cannot be read: {(error.strerror or str(error)).lower()}; check the path.") from None
