"""Map a function over items, with any :class:`concurrent.futures.Executor`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from typing import Any

Mapper = Callable[[Callable[[Any], Any], Sequence[Any]], Iterable[tuple[int, Any]]]
"""Calls a function for every item, in this process or elsewhere.

It yields the index of each item with the function's result as soon as that is there, in any order. A GtauError in
place of the result says why there is none.
"""


def serial_map(function: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[tuple[int, Any]]:
    """Work in this process, one item after the other."""
    return enumerate(map(function, items))


def submit_all(executor: Executor, function: Callable[[Any], Any], items: Mapping[int, Any]) -> dict[Future[Any], int]:
    """Submit every item now; return the index of each by its future, for :func:`completed`."""
    return {executor.submit(function, item): k for k, item in items.items()}


def completed(
    futures: dict[Future[Any], int], check: Callable[[], None] = lambda: None
) -> Iterator[tuple[int, Future[Any]]]:
    """Yield the index of each item with its future once that is done, and remove it from ``futures``.

    Parameters
    ----------
    futures : dict
        From :func:`submit_all`.
    check : callable
        Called about once a second while nothing finishes; may raise.
    """
    while futures:
        done = wait(futures, timeout=1.0, return_when=FIRST_COMPLETED).done
        if not done:
            check()
        for future in done:
            yield futures.pop(future), future
