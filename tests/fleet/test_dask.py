"""Work on Dask workers: real processes, one of them killed, and everything that a cluster may lack."""

from __future__ import annotations

import os
import signal
import socket
import sys
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import SimpleNamespace

import pytest
from process_functions import fragile, held, refusing, slow_square
from programs import wait_until

from gtau.errors import GtauError
from gtau.fleets.workers import LIMITS, check_workers, dask_workers, shielded_from_terminal

distributed = pytest.importorskip("distributed")


def local_cluster(n_workers: int):
    with shielded_from_terminal():
        return distributed.LocalCluster(
            n_workers=n_workers, threads_per_worker=1, dashboard_address=":0", env=LIMITS, silence_logs="CRITICAL"
        )


@contextmanager
def client_of(n_workers: int) -> Iterator:
    """A client of worker processes; where the machine is busy one that was killed may not come back."""
    import dask

    with dask.config.set({"distributed.scheduler.allowed-failures": 1}):  # worker starts take time
        cluster = local_cluster(n_workers)
    with cluster, distributed.Client(cluster) as client:
        yield client


@pytest.fixture(scope="module")
def client() -> Iterator:
    """A client of two workers that no test kills."""
    with client_of(2) as client:
        yield client


def test_a_worker_killed_in_the_middle_changes_nothing() -> None:
    with client_of(2) as client:
        before, killed, results = client.run(os.getpid), [], {}
        with dask_workers(client.scheduler.address) as mapper:
            for k, result in mapper(slow_square, range(40)):
                if not killed:
                    killed.append(min(before.values()))
                    os.kill(killed[0], signal.SIGKILL)
                results[k] = result
        assert killed[0] not in client.run(os.getpid).values()
    assert results == {k: k * k for k in range(40)}


@pytest.mark.parametrize(
    ("function", "says", "workers"),
    [(refusing, "no three.", 1), (fragile, "it killed one Dask worker after the other", 5)],  # of which four die
    ids=["refused", "lost"],
)
def test_refused_and_lost_items_are_reported_and_the_others_are_done(function, says: str, workers: int) -> None:
    with client_of(workers) as client, dask_workers(client.scheduler.address) as mapper:
        results = dict(mapper(function, range(5)))
    assert says in str(results.pop(3))
    assert results == {k: k * k for k in (0, 1, 2, 4)}


@pytest.mark.slow
def test_workers_that_do_not_come_back() -> None:
    with local_cluster(1) as cluster, dask_workers(cluster.scheduler_address, without_workers=2.0) as mapper:
        results = iter(mapper(time.sleep, [0.01, 60]))
        next(results)
        cluster.scale(0)
        with pytest.raises(GtauError, match="the Dask scheduler has had no workers for 2 s; check workers and network"):
            next(results)


def test_what_is_not_wanted_any_more_is_cancelled(client, tmp_path: Path) -> None:
    items = [tmp_path / name for name in ("first", *map(str, range(200)))]
    with dask_workers(client.scheduler.address) as mapper:
        next(iter(mapper(held, items)))
    wait_until(lambda: client.run_on_scheduler(lambda dask_scheduler: not dask_scheduler.tasks))
    (tmp_path / "go").touch()
    with dask_workers(client.scheduler.address) as mapper:
        assert dict(mapper(refusing, [1, 2])) == {0: 1, 1: 4}
    begun = [item for item in items if item.exists()]
    assert len(begun) <= 1 + len(client.scheduler_info()["workers"])  # each worker had begun one more


@pytest.mark.slow
def test_a_scheduler_that_stops() -> None:
    with local_cluster(1) as cluster, dask_workers(cluster.scheduler_address) as mapper:
        results = iter(mapper(time.sleep, [0.01, 60]))
        next(results)
        cluster.close()
        with pytest.raises(GtauError, match="the Dask scheduler stopped or cancelled the work; start it"):
            next(results)


def test_a_local_cluster_on_a_machine_with_another_one() -> None:
    with socket.socket() as other, warnings.catch_warnings():
        with suppress(OSError):  # somebody else has it
            other.bind(("", 8787))  # the port of Dask's dashboard
            other.listen()
        warnings.simplefilter("error")
        with dask_workers("local") as mapper:
            assert dict(mapper(refusing, [1])) == {0: 1}


# What a cluster may lack


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nonsense", "foo://127.0.0.1:1", ""])
def test_a_scheduler_that_is_not_there(address: str) -> None:
    says = f"the Dask scheduler '{address}' cannot be reached"
    with pytest.raises(GtauError, match=says), dask_workers(address, patience=0.5):
        pass


def test_without_workers() -> None:
    with (
        local_cluster(0) as cluster,
        pytest.raises(GtauError, match=f"'{cluster.scheduler_address}' has no workers; start some"),
        dask_workers(cluster.scheduler_address, patience=1.0),
    ):
        pass


def test_another_version_of_gtau_on_the_workers(client, monkeypatch: pytest.MonkeyPatch) -> None:
    address = client.scheduler.address
    with dask_workers(address) as mapper:
        assert dict(mapper(refusing, [1])) == {0: 1}
    monkeypatch.setattr("gtau.fleets.workers.installed", lambda: "9.9.9")
    with pytest.raises(GtauError, match=r"has gtau .* and this machine 9.9.9; install the same"), dask_workers(address):
        pass
    monkeypatch.setattr("gtau.fleets.workers.check_workers", lambda *_: None)  # a worker that came later
    with dask_workers(address) as mapper:
        assert "this machine 9.9.9; install the same version everywhere" in str(dict(mapper(refusing, [1]))[0])


def test_workers_without_gtau() -> None:
    from importlib.metadata import PackageNotFoundError

    cluster = SimpleNamespace(
        wait_for_workers=lambda n, timeout: None,
        run=lambda function, name, on_error: {"tcp://far:1": PackageNotFoundError("gtau")},
    )
    with pytest.raises(GtauError, match="the Dask worker tcp://far:1 has no gtau; install gtau"):
        check_workers(cluster, "tcp://far:2", patience=1.0)


def test_without_dask(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(GtauError, match=r"pip install 'gtau\[dask\]'"), dask_workers("local"):
        pass
