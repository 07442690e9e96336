"""Map over the workers of an executor, which may die: processes of this machine, or what Dask has."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any

from gtau.errors import GtauError

Mapper = Callable[[Callable[[Any], Any], Sequence[Any]], Iterable[tuple[int, Any]]]
"""Calls a function for every item, in this process or elsewhere.

It yields the index of each item with the function's result as soon as that is there, in any order. A GtauError in
place of the result says why there is none.
"""
QUIET = "ignore:resource_tracker"  # warning option of the process that cleans up what killed workers leave
LIMITS = {"GTAU_THREADS": "1", "POLARS_MAX_THREADS": "1"}
"""Environment of a worker process: one thread each, as there are as many processes as cores."""


class WorkerDied(GtauError):
    """The worker of an item died, or another one of the same executor."""


@dataclass(frozen=True)
class Workers:
    """A :class:`concurrent.futures.Executor` by its ``submit``, and how its workers fail.

    ``failure`` makes a GtauError of a future's exception, :class:`WorkerDied` where its worker died, or raises what
    ends all work. ``at_once`` items at most are submitted at a time: all of them may fail with one worker. ``check``
    is called at least once a second, and may raise.
    """

    submit: Callable[[Callable[[Any], Any], Any], Future[Any]]
    failure: Callable[[BaseException], GtauError]
    at_once: int = sys.maxsize
    check: Callable[[], None] = lambda: None

    def map(self, function: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        """Map as a :data:`Mapper`; items whose worker died are tried once more, one by one."""
        died = []
        for k, result in self._results(function, items, range(len(items))):
            if isinstance(result, WorkerDied):
                died.append(k)
            else:
                yield k, result
        for k in died:
            yield from self._results(function, items, [k])

    def _results(
        self, function: Callable[[Any], Any], items: Sequence[Any], indices: Iterable[int]
    ) -> Iterator[tuple[int, Any]]:
        waiting, futures = deque(indices), dict[Future[Any], int]()
        while waiting or futures:
            while waiting and len(futures) < self.at_once:
                k = waiting.popleft()
                futures[self.submit(function, items[k])] = k
            done = wait(futures, timeout=1.0, return_when=FIRST_COMPLETED).done
            self.check()
            for future in done:
                error = CancelledError() if future.cancelled() else future.exception()
                yield futures.pop(future), future.result() if error is None else self.failure(error)


def serial_map(function: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[tuple[int, Any]]:
    """Process the items one by one in this process."""
    return enumerate(map(function, items))


@contextmanager
def processes(jobs: int) -> Iterator[Mapper]:
    """Open a map over ``jobs`` processes of this machine, which end on leaving; with one job, in this process."""
    if jobs == 1:
        yield serial_map
        return
    from loky import get_reusable_executor

    watched, held = Pipe(duplex=False)
    options = {"timeout": None, "initializer": end_with, "initargs": (watched,), "env": LIMITS}
    executor = partial(get_reusable_executor, jobs, **options)  # a new one where a process of the last one died

    def submit(function: Callable[[Any], Any], item: Any) -> Future[Any]:
        with shielded_from_terminal():
            return executor().submit(function, item)

    with watched, held:
        try:
            yield Workers(submit, _failure, jobs).map
        finally:
            executor().shutdown(kill_workers=True)


def _failure(error: BaseException) -> GtauError:
    if isinstance(error, BrokenExecutor):
        return WorkerDied("its process died twice, usually for lack of memory; give it more.")
    raise error


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
