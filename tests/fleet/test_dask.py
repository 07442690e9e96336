"""Work on Dask workers: real processes, one of them killed, and everything that a cluster may lack."""

from __future__ import annotations

import os
import re
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from process_functions import away, fragile, refusing, slow_square

from gtau.errors import GtauError
from gtau.fleet import dask_workers
from gtau.fleet.dask_workers import connected, dask_map
from gtau.fleet.processes import LIMITS, shielded_from_terminal

distributed = pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def client() -> Iterator:
    """A client of two worker processes."""
    import dask

    with (
        shielded_from_terminal(),
        dask.config.set({"distributed.scheduler.allowed-failures": 1}),
    ):  # worker starts take time
        cluster = distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None, env=LIMITS, silence_logs="CRITICAL"
        )
    with cluster, distributed.Client(cluster) as client:
        yield client


def test_a_worker_killed_in_the_middle_changes_nothing(client) -> None:
    before, killed, found = client.run(os.getpid), [], {}
    for k, result in dask_map(slow_square, range(40), client):
        if not killed:
            killed.append(min(before.values()))
            os.kill(killed[0], signal.SIGKILL)
        found[k] = result
    assert killed[0] not in client.run(os.getpid).values()
    assert found == {k: k * k for k in range(40)}


def test_refused_and_lost_items_are_reported_and_the_others_are_done(client) -> None:
    for function, says in ((refusing, "no three."), (fragile, "it killed one Dask worker after the other")):
        found = dict(dask_map(function, range(5), client))
        assert says in str(found.pop(3))
        assert found == {k: k * k for k in (0, 1, 2, 4)}


def test_an_error_that_goes_away_is_tried_again(client, tmp_path: Path) -> None:
    assert dict(dask_map(away, [tmp_path], client)) == {0: "read"}


def test_an_error_that_stays_is_reported(client, tmp_path: Path) -> None:
    (refused,) = dict(dask_map(away, [tmp_path / "missing"], client)).values()
    assert re.match(r"the Dask worker tcp://\S+ failed \(.*No such file.*\); check its disks", str(refused))


def test_workers_that_do_not_come_back() -> None:
    with shielded_from_terminal():
        cluster = distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, dashboard_address=None, env=LIMITS, silence_logs="CRITICAL"
        )
    with cluster, distributed.Client(cluster) as client:
        made = dask_map(time.sleep, [0.01, 60], client, without_workers=2.0)
        next(made)
        cluster.scale(0)
        with pytest.raises(GtauError, match="the Dask scheduler has had no workers for 2 s; check workers and network"):
            next(made)


def test_what_is_not_wanted_any_more_is_cancelled(client) -> None:
    made = dask_map(time.sleep, [0.01] + 200 * [0.5], client)
    next(made)
    made.close()
    deadline = time.monotonic() + 20
    while any(client.processing().values()):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    begun = time.monotonic()
    assert dict(dask_map(refusing, [1, 2], client)) == {0: 1, 1: 4}
    assert time.monotonic() - begun < 20  # two hundred sleeps would be 50 s


def test_a_scheduler_that_stops() -> None:
    with shielded_from_terminal():
        cluster = distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, dashboard_address=None, env=LIMITS, silence_logs="CRITICAL"
        )
    with distributed.Client(cluster) as client:
        made = dask_map(time.sleep, [0.01, 60], client)
        next(made)
        cluster.close()
        with pytest.raises(GtauError, match="the Dask scheduler stopped or cancelled the work; start it"):
            next(made)


# What a cluster may lack


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nonsense", "foo://127.0.0.1:1", ""])
def test_a_scheduler_that_is_not_there(address: str) -> None:
    says = f"the Dask scheduler '{address}' cannot be reached"
    with pytest.raises(GtauError, match=says), connected(address, patience=0.5):
        pass


def test_a_worker_is_no_scheduler(client) -> None:
    (address, *_) = client.scheduler_info()["workers"]
    with pytest.raises(GtauError, match="this is a worker"), connected(address):
        pass


def test_without_workers() -> None:
    with (
        distributed.LocalCluster(n_workers=0, dashboard_address=None, silence_logs="CRITICAL") as cluster,
        pytest.raises(GtauError, match=f"'{cluster.scheduler_address}' has no workers; start some"),
        connected(cluster.scheduler_address, patience=1.0),
    ):
        pass


def test_another_version_of_gtau_on_the_workers(client, monkeypatch: pytest.MonkeyPatch) -> None:
    address = client.scheduler.address
    with connected(address) as connection:
        assert dict(dask_map(refusing, [1], connection)) == {0: 1}
    monkeypatch.setattr(dask_workers, "installed", lambda: "9.9.9")
    with pytest.raises(GtauError, match=r"has gtau .* and this machine 9.9.9; install the same"), connected(address):
        pass
    late = dict(dask_map(refusing, [1], client))[0]  # what a worker says that came later
    assert "this machine 9.9.9; install the same version everywhere" in str(late)


def test_workers_without_gtau() -> None:
    from importlib.metadata import PackageNotFoundError

    cluster = SimpleNamespace(
        wait_for_workers=lambda n, timeout: None,
        run=lambda function, name, on_error: {"tcp://far:1": PackageNotFoundError("gtau")},
    )
    with pytest.raises(GtauError, match="the Dask worker tcp://far:1 has no gtau; install gtau"):
        dask_workers._check_workers(cluster, "tcp://far:2", patience=1.0, ours="1.0")


def test_without_dask(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(GtauError, match=r"pip install 'gtau\[dask\]'"), connected("local"):
        pass
