"""Work spread over the workers of a Dask scheduler, or over a cluster of processes made for it."""

from __future__ import annotations

import logging
import os
import pickle
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from queue import Empty, Queue
from typing import TYPE_CHECKING, Any, TypeVar

from gtau.errors import GtauError, missing_extra
from gtau.parallel.executor import Spread, serial_executor
from gtau.parallel.process_executor import LIMITS, ignore_sigint

if TYPE_CHECKING:
    from distributed import Client, Future

Item = TypeVar("Item")
Made = TypeVar("Made")
PATIENCE = 15.0  # s to wait for a scheduler, and for its first worker
LONELY = 60.0  # s without any worker, which may be starting again
RETRIES = 2  # after an error that is not gtau's own: a network drive that was away, a full disk
_ONE_AT_A_TIME = threading.Lock()  # in a process: symbolic expressions are not made for threads


@contextmanager
def connected(address: str) -> Iterator[Client]:
    """A client of the scheduler at ``address``, or of processes of this machine where that is ``local``.

    On leaving, work that is still going on is cancelled.

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
        with ignore_sigint():
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
    _check_scheduler(address)
    with _quiet("distributed.client"), Client(address, timeout=PATIENCE) as client:
        _check_workers(client, address)
        yield client


@contextmanager
def _quiet(logger: str) -> Iterator[None]:
    """What goes wrong with a scheduler is said in a sentence, and not with a traceback in a log."""
    known = logging.getLogger(logger)
    before = known.level
    known.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        known.setLevel(before)


@contextmanager
def where_to_work(address: str | None) -> Iterator[Spread]:
    """The spread over the workers at ``address``, or the one that works here; raises as :func:`connected`."""
    if address is None:
        yield serial_executor
        return
    with connected(address) as client:
        yield partial(on_workers, client=client)


def _check_scheduler(address: str) -> None:
    """Ask for its name: a client that cannot be made leaves threads behind."""
    import asyncio

    from distributed import rpc

    async def identity() -> dict[str, Any]:
        async with rpc(address) as scheduler:
            return await asyncio.wait_for(scheduler.identity(), PATIENCE)

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


def _check_workers(client: Client, address: str) -> None:
    try:
        client.wait_for_workers(1, timeout=PATIENCE)
    except TimeoutError:
        raise GtauError(
            f"the Dask scheduler '{address}' has no workers; start some with 'dask worker {address} --nthreads 1'."
        ) from None
    found = client.run(version, "gtau", on_error="return")
    for worker, theirs in found.items():
        if isinstance(theirs, PackageNotFoundError):
            raise GtauError(f"the Dask worker {worker} has no gtau; install gtau {installed()} there.")
        if theirs != installed():
            raise _other_version(worker, theirs, installed())


def installed() -> str:
    """The version of gtau in this process."""
    return version("gtau")


def _other_version(worker: str, theirs: str, ours: str) -> GtauError:
    return GtauError(
        f"the Dask worker {worker} has gtau {theirs} and this machine {ours}; install the same version everywhere."
    )


def on_workers(
    function: Callable[[Item], Made], items: Sequence[Item], client: Client
) -> Iterator[tuple[int, Made | GtauError]]:
    """Call a function for every item on the workers; what a worker that dies was at is done by another one.

    Yields
    ------
    int, object
        Number of an item and what became of it, in the order in which they are finished; a GtauError for an item
        that gtau refused, or that one worker after the other died of.
    """
    died = []
    for k, result in _on_workers(function, items, client):
        if isinstance(result, Lost):
            died.append(k)  # perhaps of what another item did to its worker
        else:
            yield k, result
    for k in died:
        yield from ((k, result) for _, result in _on_workers(function, [items[k]], client))


class Lost(GtauError):
    """Workers died at an item."""


def _on_workers(
    function: Callable[[Item], Made], items: Sequence[Item], client: Client
) -> Iterator[tuple[int, Made | GtauError]]:
    sent = [pickle.dumps(item) for item in items]  # to be opened by a worker, and not by the scheduler on the way
    begun = client.map(partial(_work, function, installed()), sent, pure=False, retries=RETRIES)
    number = {future.key: k for k, future in enumerate(begun)}
    finished: Queue[Future[Any]] = Queue()
    for future in begun:
        future.add_done_callback(finished.put)
    try:
        for _ in begun:
            future = _next(finished, client)
            yield number[future.key], _result(future)
            future.release()
    finally:
        if client.status == "running":
            client.cancel([future for future in begun if not future.done()])


def _next(finished: Queue[Future[Any]], client: Client) -> Future[Any]:
    """The next one that is finished; raises GtauError where for too long there has been no worker to finish one."""
    seen = time.monotonic()
    while True:
        try:
            return finished.get(timeout=1.0)
        except Empty:
            if client.status == "running" and client.scheduler_info()["workers"]:
                seen = time.monotonic()
            elif time.monotonic() > seen + LONELY:
                raise GtauError(
                    f"the Dask scheduler has had no workers for {LONELY:.0f} s; see whether they or the network "
                    "are down, start them, and the same command again."
                ) from None


def _work(function: Callable[[Item], Made], expected: str, sent: bytes) -> Made | GtauError:
    """What a worker does; a refusal is a result, as there is no use in trying again."""
    from distributed import get_worker

    address = get_worker().address
    if installed() != expected:
        return _other_version(address, installed(), expected)
    with _ONE_AT_A_TIME:
        try:
            return function(_opened(sent, address))
        except GtauError as error:
            return error
        except OSError as error:
            raise OSError(f"the Dask worker {address} failed ({error}); see to its disks and network.") from None


def _opened(sent: bytes, address: str) -> Any:
    """An item as it was before it was sent; what it needs of a log is read now."""
    try:
        return pickle.loads(sent)
    except GtauError as error:
        raise GtauError(f"on the Dask worker {address}, {error}") from None


def _result(future: Future[Any]) -> Any:
    from distributed import CancelledError, KilledWorker
    from distributed.comm.core import CommClosedError

    try:
        return future.result()
    except KilledWorker as killed:
        return Lost(
            f"Dask workers died at it, one after the other, the last one {killed.last_worker.address}, most often for "
            "want of memory; give them more."
        )
    except (CancelledError, CommClosedError):
        raise GtauError(
            "the Dask scheduler went away or cancelled the work; start it, and the same command again."
        ) from None
    except OSError as error:  # again and again
        return GtauError(str(error))
