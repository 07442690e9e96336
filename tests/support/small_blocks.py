"""Logs read in small blocks, as long ones are."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from gtau.signals.storage import SAMPLES


@contextmanager
def working_with(samples: int) -> Iterator[None]:
    """Process blocks of this many ``samples`` in this thread while the context lasts."""
    token = SAMPLES.set(samples)
    try:
        yield
    finally:
        SAMPLES.reset(token)
