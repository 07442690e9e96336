"""A cache of finished factors: a job that is run again, or goes on, takes them instead of computing them."""

from __future__ import annotations

import hashlib
import io
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from gtau.documents.files import write_atomically
from gtau.errors import GtauError
from gtau.estimation.regression.dataset import Shard
from gtau.estimation.regression.factors import STRETCHES, Factors
from gtau.parallel.content_hash import content_key
from gtau.parallel.executor import Spread

LARGEST = 2 << 30  # bytes that the cache may hold; beyond them what was used longest ago goes
WORTH = 1 << 17  # samples of a part: fewer are computed about as fast as they are looked up


def cache_folder() -> Path:
    """Where the cache lies: what GTAU_CACHE says, or a folder in the user's place for caches."""
    if chosen := os.environ.get("GTAU_CACHE"):
        return Path(chosen)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local")) / "gtau" / "cache"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "gtau"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "gtau"


def caching_executor(spread: Spread, folder: Path, worth: int = WORTH) -> Spread:
    """A spread that takes the factors of parts from a cache, and lets ``spread`` work only on the others.

    What becomes finished is stored at once. The key of a part is its content: samples, robot, columns, filter,
    weights, and the source of the program.

    Parameters
    ----------
    spread : Spread
        Where to work on what is not in the cache.
    folder : Path
        Of the cache; made where it is missing. Where it cannot be written nothing is stored.
    worth : int
        Samples from which on a part is worth its place.
    """

    def spread_and_store(function: Callable[[Shard], Factors], parts: Sequence[Shard]) -> Iterator[tuple[int, object]]:
        digests: dict[int, tuple[object, bytes]] = {}
        entries = [
            folder / f"{content_key((function, _nameless(part)), digests)}.factors" if _samples(part) >= worth else None
            for part in parts
        ]
        left = []
        for k, entry in enumerate(entries):
            stored = None if entry is None else _read(entry)
            if stored is None:
                left.append(k)
            else:
                yield k, stored
        try:
            for place, result in spread(function, [parts[k] for k in left]):
                k = left[place]
                entry = entries[k]
                if entry is not None and isinstance(result, Factors):
                    _store(entry, result)
                yield k, result
        finally:
            _shrink(folder)

    return spread_and_store


def _samples(part: Shard) -> int:
    return len(part.prepared) * len(part.stretches) // STRETCHES


def _nameless(part: Shard) -> Shard:
    """The part without what its factors do not depend on: another payload's mass needs no new ones."""
    run = replace(part.prepared.run, name="", payload=None, notes=())
    return replace(part, prepared=replace(part.prepared, run=run))


def _read(entry: Path) -> Factors | None:
    """Factors of an entry; None where there is none or it is damaged."""
    try:
        content = entry.read_bytes()
    except OSError:
        return None
    digest, body = content[:32], content[32:]
    if hashlib.sha256(body).digest() != digest:
        return None
    with suppress(OSError):
        os.utime(entry)  # it was used
    with np.load(io.BytesIO(body), allow_pickle=False) as arrays:
        return Factors(**{field.name: arrays[field.name] for field in fields(Factors) if field.name in arrays})


def _store(entry: Path, factors: Factors) -> None:
    body = io.BytesIO()
    arrays = {field.name: getattr(factors, field.name) for field in fields(Factors)}
    np.savez(body, **{name: array for name, array in arrays.items() if array is not None})
    with suppress(GtauError, OSError):  # a full disk is no reason to stop
        entry.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(entry, hashlib.sha256(body.getvalue()).digest() + body.getvalue())


def _shrink(folder: Path) -> None:
    """Remove what was used longest ago where the cache is too large."""
    with suppress(OSError):  # another process may be at it too
        entries = [(path.stat(), path) for path in folder.glob("*.factors")]
        total = 0
        for status, path in sorted(entries, key=lambda entry: -entry[0].st_mtime_ns):
            total += status.st_size
            if total > LARGEST:
                path.unlink(missing_ok=True)
