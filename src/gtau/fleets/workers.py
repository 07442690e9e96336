"""Map a function over processes of this machine or the workers of a Dask scheduler, any of which may die."""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Awaitable, Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from itertools import islice
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any

from gtau.errors import GtauError, needing

if TYPE_CHECKING:
    from distributed import Client

Function = Callable[[Any], Any]
Mapper = Callable[[Function, Sequence[Any]], Iterable[tuple[int, Any]]]
"""Calls a function for every item; yields the index of each item with the result, or a GtauError, in any order."""
QUIET = "ignore:resource_tracker"  # warning option of the process that cleans up what killed workers leave
LIMITS = {"GTAU_THREADS": "1", "POLARS_MAX_THREADS": "1"}
"""Environment of a worker process: one thread each, as there are as many processes as cores."""
PATIENCE = 15.0  # s to wait for a scheduler, and for its first worker
WITHOUT_WORKERS = 60.0  # s until the work is given up: workers may be starting again
_ONE_AT_A_TIME = threading.Lock()  # in a process: CasADi's symbolic expressions are not thread-safe


class WorkerDied(GtauError):
    """The worker of an item died, or another one of the same executor."""


def mapper_of(
    submit: Callable[[Function, Any], Future[Any]],
    failure: Callable[[BaseException], GtauError],
    at_once: int = sys.maxsize,
    check: Callable[[], None] = lambda: None,
) -> Mapper:
    """Make a map from a function that submits items to an executor.

    ``failure`` turns a future's exception into a GtauError, or raises it and ends all work. At most ``at_once`` items
    are submitted at a time, since all of them may fail with one worker; those whose worker died are tried once more,
    one by one. ``check`` is called at least once a second, and may raise.
    """

    def results(function: Function, items: Sequence[Any], indices: Iterable[int]) -> Iterator[tuple[int, Any]]:
        waiting, futures = iter(indices), dict[Future[Any], int]()
        while True:
            for k in islice(waiting, at_once - len(futures)):
                futures[submit(function, items[k])] = k
            if not futures:
                return
            done = wait(futures, timeout=1.0, return_when=FIRST_COMPLETED).done
            check()
            for future in done:
                error = CancelledError() if future.cancelled() else future.exception()
                yield futures.pop(future), future.result() if error is None else failure(error)

    def mapped(function: Function, items: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        died = []
        for k, result in results(function, items, range(len(items))):
            if isinstance(result, WorkerDied):
                died.append(k)
            else:
                yield k, result
        for k in died:
            yield from results(function, items, [k])

    return mapped


def serial_map(function: Function, items: Sequence[Any]) -> Iterator[tuple[int, Any]]:
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
    options = {"timeout": None, "initializer": _end_with, "initargs": (watched,), "env": LIMITS}
    executor = partial(get_reusable_executor, jobs, **options)  # a new one where a process of the last one died

    def submit(function: Function, item: Any) -> Future[Any]:
        with shielded_from_terminal():
            return executor().submit(function, item)

    def failure(error: BaseException) -> GtauError:
        if isinstance(error, BrokenExecutor):
            return WorkerDied("its process died twice, usually for lack of memory; give it more.")
        raise error

    with watched, held:
        try:
            yield mapper_of(submit, failure, jobs)
        finally:
            executor().shutdown(kill_workers=True)


def _end_with(parent: Connection) -> None:
    """End this worker process when the other end of the pipe closes, that is, when its parent ends in any way."""

    def watch() -> None:
        with suppress(EOFError, OSError):
            parent.recv_bytes()  # nobody writes
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def shielded_from_terminal() -> Iterator[None]:
    """Shield processes and threads begun within from a terminal's Ctrl-C and SIGHUP, by which they seem to fail."""
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


@contextmanager
def dask_workers(
    address: str, patience: float = PATIENCE, without_workers: float = WITHOUT_WORKERS
) -> Iterator[Mapper]:
    """Open a map over the workers of the Dask scheduler at ``address``, or of this machine: ``local``.

    Leaving cancels the work that is still going on. Raises GtauError where Dask is missing, the scheduler cannot be
    reached, stops or has no workers for some time, or they have another gtau.
    """
    with needing("--dask", "distributed", "dask"):
        from distributed import Client, LocalCluster
    logging.getLogger("distributed.client").disabled = True  # what it logs with a traceback, a sentence says
    with ExitStack() as stack:
        if address == "local":
            options = {"n_workers": os.cpu_count(), "threads_per_worker": 1, "env": LIMITS}
            with shielded_from_terminal():
                cluster = LocalCluster(dashboard_address=":0", silence_logs="CRITICAL", **options)
            address = stack.enter_context(cluster).scheduler_address
        try:
            client = stack.enter_context(Client(address, timeout=patience))
        except (OSError, ValueError) as error:
            raise GtauError(
                f"the Dask scheduler '{address}' cannot be reached ({error}); give an address such as "
                "tcp://host:8786, or 'local'."
            ) from None
        check_workers(client, address, patience)

        def submit(function: Function, item: Any) -> Future[Any]:
            # Not client.get_executor(): it takes a result whose worker dies as it arrives for an exception.
            task = client.submit(_work, installed(), function, item, pure=False)
            answer = Future[Any]()
            client.loop.add_callback(_hand_on, task, answer)
            return answer

        seen = time.monotonic()

        def check() -> None:
            nonlocal seen
            if client.status == "running" and client.scheduler_info()["workers"]:
                seen = time.monotonic()
            elif time.monotonic() > seen + without_workers:
                raise GtauError(
                    f"the Dask scheduler has had no workers for {without_workers:.0f} s; check workers and network, "
                    "and run the same command again."
                )

        yield mapper_of(submit, _dask_failure, check=check)


async def _hand_on(task: Awaitable[Any], answer: Future[Any]) -> None:
    """Set the outcome of a Dask task, which is computed again where it was lost, on a future of this process."""
    try:
        answer.set_result(await task)
    except BaseException as error:
        answer.set_exception(error)


def check_workers(client: Client, address: str, patience: float) -> None:
    """Check that there are workers and that they run the gtau version of this process; raises GtauError."""
    try:
        client.wait_for_workers(1, timeout=patience)
    except TimeoutError:
        raise GtauError(
            f"the Dask scheduler '{address}' has no workers; start some with 'dask worker {address} --nthreads 1'."
        ) from None
    for worker, theirs in client.run(version, "gtau", on_error="return").items():
        _check_version(worker, theirs, installed())


def installed() -> str:
    """Return the version of gtau in this process."""
    return version("gtau")


def _check_version(worker: str, theirs: object, ours: str) -> None:
    if isinstance(theirs, PackageNotFoundError):
        raise GtauError(f"the Dask worker {worker} has no gtau; install gtau {ours} there.")
    if theirs != ours:
        raise GtauError(
            f"the Dask worker {worker} has gtau {theirs} and this machine {ours}; install the same version everywhere."
        )


def _work(expected: str, function: Function, item: Any) -> Any:
    """Process an item on a worker, which may have joined after :func:`check_workers`."""
    from distributed import get_worker

    _check_version(get_worker().address, installed(), expected)
    with _ONE_AT_A_TIME:
        return function(item)


def _dask_failure(error: BaseException) -> GtauError:
    from distributed import CancelledError as DaskCancelledError, KilledWorker
    from distributed.comm.core import CommClosedError

    if isinstance(error, KilledWorker):
        return WorkerDied(
            f"it killed one Dask worker after the other, the last one {error.last_worker.address}, usually for lack "
            "of memory; give them more."
        )
    if isinstance(error, (CancelledError, DaskCancelledError, CommClosedError)):
        raise GtauError(
            "the Dask scheduler stopped or cancelled the work; start it, and run the same command again."
        ) from None
    if isinstance(error, GtauError):
        return error
    raise error
