"""Work spread over processes of this machine."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from typing import TypeVar

from gtau.errors import GtauError
from gtau.parallel.executor import serial_executor

Item = TypeVar("Item")
Made = TypeVar("Made")
LIMITS = {"GTAU_THREADS": "1", "POLARS_MAX_THREADS": "1"}
"""Environment of a worker process: one thread each, as there are as many processes as cores."""


def in_processes(
    function: Callable[[Item], Made], items: Sequence[Item], jobs: int
) -> Iterator[tuple[int, Made | GtauError]]:
    """Call a function for every item in ``jobs`` processes; with one job, in this one.

    Yields
    ------
    int, object
        Number of an item and what became of it, in the order in which they are finished; a GtauError for an item
        whose process died twice, the second time with nothing else in it.
    """
    if jobs == 1:
        yield from serial_executor(function, items)
        return
    left = dict(enumerate(items))
    while left:
        yield from _finished(_until_broken(function, left, jobs), left)
        # A process died. Items are begun in order, so it was at one of the first that are left.
        for k, item in list(left.items())[: jobs + 1]:
            yield from _finished(_until_broken(function, {k: item}, 1), left)
            if left.pop(k, None) is not None:
                yield k, GtauError("the process that worked on it died, most often for want of memory; give it more.")


def _finished(made: Iterator[tuple[int, Made]], left: dict[int, Item]) -> Iterator[tuple[int, Made]]:
    with closing(made):  # type: ignore[type-var]
        for k, result in made:
            del left[k]
            yield k, result


def _until_broken(function: Callable[[Item], Made], items: dict[int, Item], jobs: int) -> Iterator[tuple[int, Made]]:
    """Results in processes of their own, until all are there or a process dies."""
    from concurrent.futures import ProcessPoolExecutor, as_completed
    from concurrent.futures.process import BrokenProcessPool
    from multiprocessing import active_children, get_context

    pool, others = ProcessPoolExecutor(min(jobs, len(items)), get_context("spawn"), _begin), active_children()
    try:
        with ignore_sigint():
            futures = {pool.submit(function, item): k for k, item in items.items()}
        for future in as_completed(futures):
            yield futures[future], future.result()
    except BrokenProcessPool:
        pass
    except BaseException:
        for child in active_children():
            if child not in others:
                child.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def ignore_sigint() -> Iterator[None]:
    """Processes and threads begun within do not hear Ctrl-C; whoever began them does, if need be afterwards."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing.resource_tracker import ensure_running

    ensure_running()  # now: where it begins, it unblocks signals
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin() -> None:
    """A worker's first step."""
    os.environ.update(LIMITS)
