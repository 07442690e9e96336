"""Map in this process, and in local processes."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import contextmanager, suppress
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any, TypeVar

from gtau.errors import GtauError

Mapper = Callable[[Callable[[Any], Any], Sequence[Any]], Iterable[tuple[int, Any]]]
"""Calls a function for every item, in this process or elsewhere.

It yields the index of each item with the function's result as soon as that is there, in any order. A GtauError in
place of the result says why there is none.
"""


def serial_map(function: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[tuple[int, Any]]:
    """Process the items one by one in this process."""
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


Item = TypeVar("Item")
Made = TypeVar("Made")
QUIET = "ignore:resource_tracker"  # warning option of the process that cleans up what killed workers leave
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
                yield k, GtauError("its process died twice, usually for lack of memory; give it more.")


def handed_out(jobs: int) -> int:
    """Return the maximum number of items that loky hands out at once: twice the number of jobs, and one."""
    return 2 * jobs + 1


def _until_death(
    function: Callable[[Item], Made], left: dict[int, Item], indices: Iterable[int], jobs: int
) -> Iterator[tuple[int, Made]]:
    """Process the items ``left``, and remove finished ones, until all are done or a process dies."""
    from loky import BrokenProcessPool, ProcessPoolExecutor

    items = {k: left[k] for k in indices}
    watched, held = Pipe(duplex=False)
    with watched, held:
        with shielded_from_terminal():  # its locks begin a process that looks after them
            executor = ProcessPoolExecutor(min(jobs, len(items)), initializer=end_with, initargs=(watched,), env=LIMITS)
        try:
            with shielded_from_terminal():
                futures = submit_all(executor, function, items)
            for k, future in completed(futures):
                if not isinstance(future.exception(), BrokenProcessPool):
                    del left[k]
                    yield k, future.result()
        except BaseException:
            executor.shutdown(wait=False, kill_workers=True)  # cancels what is left: loky fails on what we cancel
            raise
        executor.shutdown()


def end_with(parent: Connection) -> None:
    """End this worker process when the other end of the pipe closes, that is, when its parent ends in any way."""

    def watch() -> None:
        with suppress(EOFError, OSError):
            parent.recv_bytes()  # nobody writes
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def shielded_from_terminal() -> Iterator[None]:
    """Shield processes and threads begun within from Ctrl-C and from SIGHUP; they end with the process that began them.

    A terminal signals them too, and those that die before this process reports it would be taken for failures.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing.resource_tracker import ensure_running

    from loky.backend.resource_tracker import ensure_running as ensure_loky_running

    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGHUP})
    sys.warnoptions.append(QUIET)
    try:
        ensure_running()  # now: where it begins, it unblocks SIGINT
        ensure_loky_running()
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        yield
    finally:
        sys.warnoptions.remove(QUIET)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
