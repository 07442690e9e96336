"""Map a function over shards, with any :class:`concurrent.futures.Executor`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from typing import TYPE_CHECKING, Any

from gtau.errors import GtauError

if TYPE_CHECKING:
    from gtau.estimation.regression.dataset import Mapper

ShardMap = Callable[[Callable[[Any], Any], Sequence[Any]], Iterable[tuple[int, Any]]]
"""Calls a function for every shard, in this process or elsewhere.

It yields the index of each shard with the function's result as soon as that is there, in any order. A GtauError in
place of the result says why there is none.
"""


def serial_map(function: Callable[[Any], Any], shards: Sequence[Any]) -> Iterator[tuple[int, Any]]:
    """Work in this process, one shard after the other."""
    return enumerate(map(function, shards))


def submit_shards(
    executor: Executor,
    function: Callable[[Any], Any],
    shards: Mapping[int, Any],
    check: Callable[[], None] = lambda: None,
) -> Iterator[tuple[int, Future[Any]]]:
    """Submit every shard now; yield the index of each with its future once that is done.

    Closing the iterator cancels the futures that are left.

    Parameters
    ----------
    executor : Executor
        Where to work.
    function : callable
        Of one shard.
    shards : mapping
        From index to shard.
    check : callable
        Called about once a second while nothing finishes; may raise.
    """
    return _completed({executor.submit(function, shard): k for k, shard in shards.items()}, check)


def _completed(futures: dict[Future[Any], int], check: Callable[[], None]) -> Iterator[tuple[int, Future[Any]]]:
    try:
        while futures:
            done = wait(futures, timeout=1.0, return_when=FIRST_COMPLETED).done
            if not done:
                check()
            for future in done:
                yield futures.pop(future), future
    finally:
        for future in futures:
            future.cancel()


def in_order(shard_map: ShardMap) -> Mapper:
    """Turn a shard map into a mapper: results in the order of the shards, a GtauError among them raised."""

    def mapper(function: Callable[[Any], Any], shards: Sequence[Any]) -> Iterator[Any]:
        early: dict[int, Any] = {}
        following = 0
        for k, result in shard_map(function, shards):
            if isinstance(result, GtauError):
                raise result
            early[k] = result
            while following in early:
                yield early.pop(following)
                following += 1

    return mapper
