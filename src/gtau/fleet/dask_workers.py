"""Map over the workers of a Dask scheduler, or over a local cluster of processes."""

from __future__ import annotations

import asyncio
import logging
import os
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

from gtau.errors import GtauError, missing_extra
from gtau.fleet.mapping import LIMITS, Mapper, WorkerDied, Workers, shielded_from_terminal

if TYPE_CHECKING:
    from distributed import Client

PATIENCE = 15.0  # s to wait for a scheduler, and for its first worker
WITHOUT_WORKERS = 60.0  # s until the work is given up: workers may be starting again
_ONE_AT_A_TIME = threading.Lock()  # in a process: CasADi's symbolic expressions are not thread-safe


@contextmanager
def dask_workers(
    address: str, patience: float = PATIENCE, without_workers: float = WITHOUT_WORKERS
) -> Iterator[Mapper]:
    """Open a map over the workers of the scheduler at ``address``, or over processes of this machine: ``local``.

    Leaving cancels the work that is still going on. ``patience`` is the time for the scheduler and its first worker
    to answer, and ``without_workers`` that without any worker until the work is given up, in s.

    Raises
    ------
    GtauError
        Dask is missing, the scheduler cannot be reached, stops or has no workers, or they have another gtau.
    """
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise missing_extra("--dask", "distributed", "dask") from None
    logging.getLogger("distributed.client").disabled = True  # what it logs with a traceback, a sentence says
    with ExitStack() as stack:
        if address == "local":
            options = {"n_workers": os.cpu_count(), "threads_per_worker": 1, "env": LIMITS}
            with shielded_from_terminal():
                cluster = LocalCluster(dashboard_address=":0", silence_logs="CRITICAL", **options)
            address = stack.enter_context(cluster).scheduler_address
        _check_scheduler(address, patience)
        client = stack.enter_context(Client(address, timeout=patience))
        _check_workers(client, address, patience)

        submit = client.get_executor(pure=False).submit
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

        yield Workers(partial(submit, _work, installed()), _failure, check=check).map


def _check_scheduler(address: str, patience: float) -> None:
    """Check that the scheduler responds: a client that fails to connect leaves threads and tracebacks behind."""
    from distributed import rpc

    async def identity() -> str:
        async with rpc(address) as scheduler:
            answer = await asyncio.wait_for(scheduler.identity(), patience)
        return str(answer["type"]).lower()

    try:
        kind = asyncio.run(identity())
        reason = "" if kind == "scheduler" else f"this is a {kind}"
    except OSError:
        reason = "it does not answer"
    except ValueError as error:
        reason = str(error)
    if reason:
        raise GtauError(
            f"the Dask scheduler '{address}' cannot be reached ({reason}); give an address such as tcp://host:8786, or "
            "'local'."
        )


def _check_workers(client: Client, address: str, patience: float) -> None:
    try:
        client.wait_for_workers(1, timeout=patience)
    except TimeoutError:
        raise GtauError(
            f"the Dask scheduler '{address}' has no workers; start some with 'dask worker {address} --nthreads 1'."
        ) from None
    for worker, theirs in client.run(version, "gtau", on_error="return").items():
        if isinstance(theirs, PackageNotFoundError):
            raise GtauError(f"the Dask worker {worker} has no gtau; install gtau {installed()} there.")
        _check_version(worker, theirs, installed())


def installed() -> str:
    """Return the version of gtau in this process."""
    return version("gtau")


def _check_version(worker: str, theirs: str, ours: str) -> None:
    if theirs != ours:
        raise GtauError(
            f"the Dask worker {worker} has gtau {theirs} and this machine {ours}; install the same version everywhere."
        )


def _work(expected: str, function: Callable[[Any], Any], item: Any) -> Any:
    """Process an item on a worker, which may have come after the check of the others."""
    from distributed import get_worker

    _check_version(get_worker().address, installed(), expected)
    with _ONE_AT_A_TIME:
        return function(item)


def _failure(error: BaseException) -> GtauError:
    from distributed import CancelledError as DaskCancelledError
    from distributed import KilledWorker
    from distributed.comm.core import CommClosedError

    if isinstance(error, KilledWorker):
        return WorkerDied(
            f"it killed one Dask worker after the other, the last one {error.last_worker.address}, usually for lack "
            f"of memory; give them more."
        )
    if isinstance(error, (CancelledError, DaskCancelledError, CommClosedError)):
        raise GtauError(
            "the Dask scheduler stopped or cancelled the work; start it, and run the same command again."
        ) from None
    if isinstance(error, GtauError):
        return error
    raise error
