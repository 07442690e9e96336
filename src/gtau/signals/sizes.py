"""How much of a long log is worked on at once."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass


@dataclass(frozen=True)
class Sizes:
    """Sizes that bound the memory that a long log takes; results do not depend on them.

    Attributes
    ----------
    block : int
        Samples that are worked on at once.
    in_memory : int
        Bytes of an array that are not worth a file.
    rows, text : int
        Rows of a table, and bytes of a text file, that are read at once.
    """

    block: int = 1 << 16
    in_memory: int = 1 << 22
    rows: int = 1 << 16
    text: int = 1 << 22


_current: ContextVar[Sizes] = ContextVar("sizes", default=Sizes())  # noqa: B039 (it is frozen)


def sizes() -> Sizes:
    """Return the sizes in use."""
    return _current.get()


@contextmanager
def working_with(chosen: Sizes) -> Iterator[None]:
    """Use other sizes, in this thread and as long as the context lasts."""
    token = _current.set(chosen)
    try:
        yield
    finally:
        _current.reset(token)
