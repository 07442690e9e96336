"""Where work is done: here, or spread over processes and workers, with results in the order in which they come."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from idim.errors import IdimError

if TYPE_CHECKING:
    from idim.estimation.data import Mapper

Spread = Callable[[Callable[[Any], Any], Sequence[Any]], Iterable[tuple[int, Any]]]
"""Calls a function for every item, somewhere.

It gives the number of each item with what the function returned, in any order, each as soon as it is there; an
IdimError in its place says why there is nothing.
"""


def here(function: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[tuple[int, Any]]:
    """The spread that works in this process, one item after the other."""
    return enumerate(map(function, items))


def in_turn(spread: Spread) -> Mapper:
    """The mapper of a spread: results in the order of the items; an IdimError among them is raised."""

    def mapper(function: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[Any]:
        early: dict[int, Any] = {}
        turn = 0
        for k, result in spread(function, items):
            if isinstance(result, IdimError):
                raise result
            early[k] = result
            while turn in early:
                yield early.pop(turn)
                turn += 1

    return mapper
