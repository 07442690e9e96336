"""Work in processes of this machine."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TypeVar

from gtau.errors import GtauError
from gtau.parallel.executor import serial_map, submit_all

Item = TypeVar("Item")
Made = TypeVar("Made")
LIMITS = {"GTAU_THREADS": "1", "POLARS_MAX_THREADS": "1"}
"""Environment of a worker process: one thread each, as there are as many processes as cores."""


def process_map(
    function: Callable[[Item], Made], items: Sequence[Item], jobs: int
) -> Iterator[tuple[int, Made | GtauError]]:
    """Map a function over items in ``jobs`` processes; with one job, in this one.

    Yields
    ------
    int, object
        Index of an item and its result, in the order in which they finish; a GtauError for an item whose process
        died twice, the second time with nothing else in it.
    """
    if jobs == 1:
        yield from serial_map(function, items)
        return
    left = dict(enumerate(items))
    while left:
        yield from _until_death(function, left, tuple(left), jobs)
        # A process died. Shards are handed out in order, so it was at one of the first that are left.
        for k in tuple(left)[: handed_out(jobs)]:
            yield from _until_death(function, left, (k,), 1)
            if k in left:
                del left[k]
                yield k, GtauError("its process died twice, most often for lack of memory; give it more.")


def handed_out(jobs: int) -> int:
    """Return how many items loky hands to its workers at once, at most: those at work, as many again, and one."""
    return 2 * jobs + 1


def _until_death(
    function: Callable[[Item], Made], left: dict[int, Item], indices: Iterable[int], jobs: int
) -> Iterator[tuple[int, Made]]:
    """Work on some of the items ``left``, and remove those that finish, until all have or a process dies."""
    from loky import BrokenProcessPool, ProcessPoolExecutor

    items = {k: left[k] for k in indices}
    executor = ProcessPoolExecutor(min(jobs, len(items)), env=LIMITS)
    try:
        with ignore_sigint():
            finished = submit_all(executor, function, items)
        for k, future in finished:
            if not isinstance(future.exception(), BrokenProcessPool):
                del left[k]
                yield k, future.result()
    except BaseException:
        executor.shutdown(wait=False, kill_workers=True)
        raise
    executor.shutdown()


@contextmanager
def ignore_sigint() -> Iterator[None]:
    """Shield processes and threads begun within from Ctrl-C; whoever began them ends them, if need be afterwards."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing.resource_tracker import ensure_running

    from loky.backend.resource_tracker import ensure_running as ensure_loky_running

    ensure_running()  # now: where it begins, it unblocks signals
    ensure_loky_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
