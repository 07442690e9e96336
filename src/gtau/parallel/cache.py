"""Cache of factors: a job that is run again, or resumed, reads them instead of reducing the logs anew.

A library was measured in place of these files: ``diskcache`` stores an entry of 2 MB in 4 to 12 ms and reads it in 0.5
to 0.8 ms, this module in 5 to 6 and 2.1 (1.6 of them the digest that shows damage, which diskcache lacks). It costs 60
ms to import, needs SQLite's locks on network drives, unpickles what it reads and has had no release since 2023.
"""

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
from gtau.estimation.regression.factors import FACTORS_VERSION, STRETCHES, Factors
from gtau.parallel.content_hash import content_key, library_versions
from gtau.parallel.executor import ShardMap

LARGEST = 2 << 30  # bytes of the cache; beyond them the least recently used entries are removed
WORTH = 1 << 17  # samples of a shard: reducing fewer takes about as long as looking them up


def cache_folder() -> Path:
    """Return the folder of the cache: ``GTAU_CACHE``, or the platform's place for caches."""
    if chosen := os.environ.get("GTAU_CACHE"):
        return Path(chosen)
    try:
        home = Path.home()
    except RuntimeError:  # a user without one, as in a container: nothing can be written there, and nothing is cached
        home = Path(os.devnull)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", home / "AppData" / "Local")) / "gtau" / "cache"
    if sys.platform == "darwin":
        return home / "Library" / "Caches" / "gtau"
    return Path(os.environ.get("XDG_CACHE_HOME") or home / ".cache") / "gtau"


def caching_map(shard_map: ShardMap, folder: Path, worth: int = WORTH, largest: int = LARGEST) -> ShardMap:
    """Take the factors of shards from a cache, and leave only the others to ``shard_map``.

    A result is stored as soon as it is there. Its key is the content of the shard (samples, robot, columns, filter,
    weights), the format version of factors and the versions of the libraries.

    Parameters
    ----------
    shard_map : callable
        Where to work on what is not in the cache.
    folder : Path
        Of the cache; made where it is missing. Where it is not writable, nothing is stored.
    worth : int
        Samples from which on a shard is cached.
    largest : int
        Bytes of the cache.
    """

    def cached_map(function: Callable[[Shard], Factors], shards: Sequence[Shard]) -> Iterator[tuple[int, object]]:
        digests: dict[int, tuple[object, bytes]] = {}
        entries = [
            folder / f"{factors_key(function, shard, digests)}.factors" if _samples(shard) >= worth else None
            for shard in shards
        ]
        left = []
        for k, entry in enumerate(entries):
            stored = None if entry is None else _read(entry)
            if stored is None:
                left.append(k)
            else:
                yield k, stored
        try:
            for index, result in shard_map(function, [shards[k] for k in left]):
                k = left[index]
                entry = entries[k]
                if entry is not None and isinstance(result, Factors):
                    _store(entry, result)
                yield k, result
        finally:
            _shrink(folder, largest)

    return cached_map


def factors_key(
    function: Callable[[Shard], Factors],
    shard: Shard,
    digests: dict[int, tuple[object, bytes]] | None = None,
    version: int = FACTORS_VERSION,
) -> str:
    """Compute the key of a shard's factors; see :func:`gtau.parallel.content_hash.content_key`."""
    return content_key((version, library_versions(), function, _nameless(shard)), digests)


def _samples(shard: Shard) -> int:
    return len(shard.prepared) * len(shard.stretches) // STRETCHES


def _nameless(shard: Shard) -> Shard:
    """Remove what the factors do not depend on: they are the same for another payload mass."""
    run = replace(shard.prepared.run, name="", payload=None, notes=())
    return replace(shard, prepared=replace(shard.prepared, run=run))


def _read(entry: Path) -> Factors | None:
    """Read the factors of an entry; None where there is none or it is damaged."""
    try:
        content = entry.read_bytes()
    except OSError:
        return None
    digest, body = content[:32], content[32:]
    if hashlib.sha256(body).digest() != digest:
        return None
    with suppress(OSError):
        os.utime(entry)  # the time of last use
    with np.load(io.BytesIO(body), allow_pickle=False) as arrays:
        return Factors(**{field.name: arrays[field.name] for field in fields(Factors) if field.name in arrays})


def _store(entry: Path, factors: Factors) -> None:
    body = io.BytesIO()
    arrays = {field.name: getattr(factors, field.name) for field in fields(Factors)}
    np.savez(body, **{name: array for name, array in arrays.items() if array is not None})
    with suppress(GtauError, OSError):  # a full disk is no reason to stop
        entry.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(entry, hashlib.sha256(body.getvalue()).digest() + body.getvalue())


def _shrink(folder: Path, largest: int) -> None:
    """Remove the least recently used entries of a cache that is too large."""
    with suppress(OSError):  # another process may shrink it too
        entries = [(path.stat(), path) for path in folder.glob("*.factors")]
        total = 0
        for status, path in sorted(entries, key=lambda entry: -entry[0].st_mtime_ns):
            total += status.st_size
            if total > largest:
                path.unlink(missing_ok=True)
