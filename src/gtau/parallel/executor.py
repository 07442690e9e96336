"""Where work is done: here, or spread over processes and workers, with results in the order in which they come."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from gtau.errors import GtauError

if TYPE_CHECKING:
    from gtau.estimation.regression.dataset import Mapper

Spread = Callable[[Callable[[Any], Any], Sequence[Any]], Iterable[tuple[int, Any]]]
"""Calls a function for every item, somewhere.

It gives the number of each item with what the function returned, in any order, each as soon as it is there; an
GtauError in its place says why there is nothing.
"""


def serial_executor(function: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[tuple[int, Any]]:
    """The spread that works in this process, one item after the other."""
    return enumerate(map(function, items))


def in_turn(spread: Spread) -> Mapper:
    """The mapper of a spread: results in the order of the items; a GtauError among them is raised."""

    def mapper(function: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[Any]:
        early: dict[int, Any] = {}
        turn = 0
        for k, result in spread(function, items):
            if isinstance(result, GtauError):
                raise result
            early[k] = result
            while turn in early:
                yield early.pop(turn)
                turn += 1

    return mapper
