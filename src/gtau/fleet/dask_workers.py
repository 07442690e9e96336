"""Map over the workers of a Dask scheduler, or over a local cluster of processes."""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any, TypeVar

from gtau.errors import GtauError, missing_extra
from gtau.fleet.processes import LIMITS, completed, shielded_from_terminal, submit_all

if TYPE_CHECKING:
    from distributed import Client

Item = TypeVar("Item")
Made = TypeVar("Made")
PATIENCE = 15.0  # s to wait for a scheduler, and for its first worker
WITHOUT_WORKERS = 60.0  # s until the work is given up: workers may be starting again
RETRIES = 2  # after an error that is not gtau's own: a network drive that was away, a full disk
_ONE_AT_A_TIME = threading.Lock()  # in a process: CasADi's symbolic expressions are not thread-safe


@contextmanager
def connected(address: str, patience: float = PATIENCE) -> Iterator[Client]:
    """Open a client of the scheduler at ``address``, or of processes of this machine where that is ``local``.

    Leaving cancels the work that is still going on.

    Parameters
    ----------
    address : str
        ``tcp://host:8786``, or ``local``.
    patience : float
        Seconds to wait for the scheduler, and for its first worker.

    Raises
    ------
    GtauError
        Dask is missing, the scheduler cannot be reached or has no workers, or they have another gtau.
    """
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise missing_extra("--dask", "distributed", "dask") from None
    if address == "local":
        with shielded_from_terminal():
            cluster = LocalCluster(
                n_workers=os.cpu_count(),
                threads_per_worker=1,
                dashboard_address=None,
                env=LIMITS,
                silence_logs="CRITICAL",
            )
        with cluster, Client(cluster) as client:
            yield client
        return
    _check_scheduler(address, patience)
    with _silenced("distributed.client"), Client(address, timeout=patience) as client:
        _check_workers(client, address, patience, installed())
        yield client


@contextmanager
def _silenced(logger: str) -> Iterator[None]:
    """Silence a log: scheduler errors are reported in one sentence, without a traceback."""
    known = logging.getLogger(logger)
    before = known.level
    known.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        known.setLevel(before)


def _check_scheduler(address: str, patience: float) -> None:
    """Check that the scheduler responds: a client that fails to connect leaves threads behind."""
    import asyncio

    from distributed import rpc

    async def identity() -> dict[str, Any]:
        async with rpc(address) as scheduler:
            return await asyncio.wait_for(scheduler.identity(), patience)

    try:
        found = asyncio.run(identity())["type"]
        reason = "" if found == "Scheduler" else f"this is a {found.lower()}"
    except OSError:
        reason = "it does not answer"
    except ValueError as error:
        reason = str(error)
    if reason:
        raise GtauError(
            f"the Dask scheduler '{address}' cannot be reached ({reason}); give an address such as tcp://host:8786, or "
            "'local'."
        )


def _check_workers(client: Client, address: str, patience: float, ours: str) -> None:
    try:
        client.wait_for_workers(1, timeout=patience)
    except TimeoutError:
        raise GtauError(
            f"the Dask scheduler '{address}' has no workers; start some with 'dask worker {address} --nthreads 1'."
        ) from None
    for worker, theirs in client.run(version, "gtau", on_error="return").items():
        if isinstance(theirs, PackageNotFoundError):
            raise GtauError(f"the Dask worker {worker} has no gtau; install gtau {ours} there.")
        if theirs != ours:
            raise _other_version(worker, theirs, ours)


def installed() -> str:
    """Return the version of gtau in this process."""
    return version("gtau")


def _other_version(worker: str, theirs: str, ours: str) -> GtauError:
    return GtauError(
        f"the Dask worker {worker} has gtau {theirs} and this machine {ours}; install the same version everywhere."
    )


def dask_map(
    function: Callable[[Item], Made], items: Sequence[Item], client: Client, without_workers: float = WITHOUT_WORKERS
) -> Iterator[tuple[int, Made | GtauError]]:
    """Map a function over items on the workers; an item whose worker dies is retried on another worker.

    Parameters
    ----------
    function : callable
        Of one item.
    items : sequence
        Sent pickled.
    client : Client
        From :func:`connected`.
    without_workers : float
        Seconds without any worker until the work is given up.

    Yields
    ------
    int, object
        Index of an item and its result, in the order in which they finish; a GtauError for an item that gtau
        refused, or that repeatedly killed its worker.

    Raises
    ------
    GtauError
        Where the scheduler stops or its workers are gone for too long.
    """
    killed = {}
    for k, result in _results(function, dict(enumerate(items)), client, without_workers):
        if isinstance(result, WorkersDied):
            killed[k] = items[k]  # perhaps another item killed the workers
        else:
            yield k, result
    for k, item in killed.items():
        yield from _results(function, {k: item}, client, without_workers)


class WorkersDied(GtauError):
    """Workers died while they worked on an item."""


def _results(
    function: Callable[[Item], Made], items: Mapping[int, Item], client: Client, without_workers: float
) -> Iterator[tuple[int, Made | GtauError]]:
    executor = client.get_executor(pure=False, retries=RETRIES)
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

    futures = submit_all(executor, partial(_work, function, installed()), items)
    try:
        for k, future in completed(futures, check):
            seen = time.monotonic()
            yield k, _result(future)
    finally:
        for future in futures:
            future.cancel()


def _work(function: Callable[[Item], Made], expected: str, item: Item) -> Made | GtauError:
    """Process an item on a worker; a refusal is a result, as a retry is useless."""
    from distributed import get_worker

    address = get_worker().address
    if installed() != expected:
        return _other_version(address, installed(), expected)
    with _ONE_AT_A_TIME:
        try:
            return function(item)
        except GtauError as error:
            return error
        except OSError as error:
            raise OSError(f"the Dask worker {address} failed ({error}); check its disks and network.") from None


def _result(future: Any) -> Any:
    from distributed import CancelledError as DaskCancelledError
    from distributed import KilledWorker
    from distributed.comm.core import CommClosedError

    try:
        return future.result()
    except KilledWorker as killed:
        return WorkersDied(
            f"it killed one Dask worker after the other, the last one {killed.last_worker.address}, usually for lack "
            f"of memory; give them more."
        )
    except (CancelledError, DaskCancelledError, CommClosedError):
        raise GtauError(
            "the Dask scheduler stopped or cancelled the work; start it, and run the same command again."
        ) from None
    except OSError as error:  # at every attempt
        return GtauError(str(error))
