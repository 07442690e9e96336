"""Factors from Dask workers: real processes, one of them killed, and everything that a cluster may lack."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from five_bar_logs import EXPERIMENT, STEEL, Plant, write_log
from spread_work import away, fragile, refusing

from gtau.errors import GtauError
from gtau.estimation.identify import identify
from gtau.estimation.regression import dataset as data
from gtau.estimation.regression.dataset import reduce_shard
from gtau.parallel import dask_executor as workers
from gtau.parallel.dask_executor import connected, on_workers
from gtau.parallel.executor import in_turn
from gtau.parallel.process_executor import LIMITS, ignore_sigint
from gtau.signals.run import read_run

distributed = pytest.importorskip("distributed")


def slow_reduce_part(part: data.Shard) -> data.Factors:
    """Slow enough that a worker is killed in the middle; in the worker's own process."""
    time.sleep(0.1)
    return reduce_shard(part)


@pytest.fixture(scope="module")
def client() -> Iterator:
    """A client of two worker processes."""
    import dask

    with ignore_sigint(), dask.config.set({"distributed.scheduler.allowed-failures": 1}):  # worker starts take time
        cluster = distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None, env=LIMITS, silence_logs="CRITICAL"
        )
    with cluster, distributed.Client(cluster) as client:
        yield client


@pytest.fixture(scope="module")
def experiment(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("experiment")
    plant = Plant(delays=(1e-3, 1e-3), noise=0.01)
    write_log(folder / "free.csv", plant.run("free", seconds=6.0, seed=1))
    write_log(folder / "loaded.csv", plant.run("loaded", seconds=6.0, payload=STEEL, seed=2))
    (folder / "experiment.yaml").write_text(EXPERIMENT.split("validation")[0])
    return folder / "experiment.yaml"


def numbers(result) -> np.ndarray:
    estimates = (*result.drive_gains.values(), *result.delays.values(), *result.parameters.values())
    return np.array([[each.value or 0.0, each.std or 0.0] for each in estimates])


def test_a_worker_killed_in_the_middle_changes_nothing(client, experiment: Path, monkeypatch) -> None:
    monkeypatch.setattr(data, "PART", 200)  # many parts
    expected = numbers(identify(experiment))
    before, killed = client.run(os.getpid), []

    def kill_one(function, parts):
        assert len(parts) > 20
        for k, result in on_workers(slow_reduce_part, parts, client):
            if not killed:
                killed.append(min(before.values()))
                os.kill(killed[0], signal.SIGKILL)
            yield k, result

    found = numbers(identify(experiment, mapper=in_turn(kill_one)))
    assert killed
    assert killed[0] not in client.run(os.getpid).values()
    assert found == pytest.approx(expected, rel=1e-10, abs=1e-12)


def test_refusals_and_lost_items_are_told_and_the_others_are_done(client) -> None:
    for function, says in ((refusing, "no three."), (fragile, "workers died at it")):
        found = dict(on_workers(function, range(5), client))
        assert says in str(found.pop(3))
        assert found == {k: k * k for k in (0, 1, 2, 4)}


def test_an_error_that_goes_away_is_tried_again(client, tmp_path: Path) -> None:
    assert dict(on_workers(away, [tmp_path], client)) == {0: "read"}


def test_a_worker_that_does_not_see_the_log_is_named(client, tmp_path: Path) -> None:
    signals = {"time": "t", "position": {"left": "q1"}, "current": {"left": "v1"}}
    path = write_log(tmp_path / "log.csv", Plant(noise=0.01).run("log", seconds=3.0))
    run = read_run(path, signals)
    path.rename(tmp_path / "elsewhere.csv")
    (refused,) = dict(on_workers(refusing, [run], client)).values()
    says = (
        rf"on the Dask worker tcp://\S+, there is no log {path}; share its folder with all workers under that path, or"
    )
    assert re.match(says, str(refused))


def test_an_error_that_stays_is_told(client, tmp_path: Path) -> None:
    (refused,) = dict(on_workers(away, [tmp_path / "missing"], client)).values()
    assert re.match(r"the Dask worker tcp://\S+ failed \(.*No such file.*\); see to its disks", str(refused))


def test_workers_that_do_not_come_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "LONELY", 2.0)
    with ignore_sigint():
        cluster = distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, dashboard_address=None, env=LIMITS, silence_logs="CRITICAL"
        )
    with cluster, distributed.Client(cluster) as client:
        made = on_workers(time.sleep, [0.01, 60], client)
        next(made)
        cluster.scale(0)
        with pytest.raises(GtauError, match="the Dask scheduler has had no workers for 2 s; see whether they"):
            next(made)


def test_what_is_not_wanted_any_more_is_cancelled(client) -> None:
    made = on_workers(time.sleep, [0.01] + 200 * [0.5], client)
    next(made)
    made.close()
    deadline = time.monotonic() + 20
    while any(client.processing().values()):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    begun = time.monotonic()
    assert dict(on_workers(refusing, [1, 2], client)) == {0: 1, 1: 4}
    assert time.monotonic() - begun < 20  # two hundred sleeps would be 50 s


def test_a_scheduler_that_stops(experiment: Path) -> None:
    with ignore_sigint():
        cluster = distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, dashboard_address=None, env=LIMITS, silence_logs="CRITICAL"
        )
    with distributed.Client(cluster) as client:
        made = on_workers(time.sleep, [0.01, 60], client)
        next(made)
        cluster.close()
        with pytest.raises(GtauError, match="the Dask scheduler went away"):
            next(made)


# What a cluster may lack


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nonsense", "foo://127.0.0.1:1", ""])
def test_a_scheduler_that_is_not_there(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "PATIENCE", 0.5)
    says = f"the Dask scheduler '{address}' cannot be reached"
    with pytest.raises(GtauError, match=says), connected(address):
        pass


def test_a_worker_is_no_scheduler(client) -> None:
    (address, *_) = client.scheduler_info()["workers"]
    with pytest.raises(GtauError, match="this is a worker"), connected(address):
        pass


def test_without_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "PATIENCE", 1.0)
    with (
        distributed.LocalCluster(n_workers=0, dashboard_address=None, silence_logs="CRITICAL") as cluster,
        pytest.raises(GtauError, match=f"'{cluster.scheduler_address}' has no workers; start some"),
        connected(cluster.scheduler_address),
    ):
        pass


def test_another_version_of_gtau_on_the_workers(client, monkeypatch: pytest.MonkeyPatch) -> None:
    address = client.scheduler.address
    with connected(address) as connection:
        assert dict(on_workers(refusing, [1], connection)) == {0: 1}
    monkeypatch.setattr(workers, "installed", lambda: "9.9.9")
    with pytest.raises(GtauError, match=r"has gtau .* and this machine 9.9.9; install the same"), connected(address):
        pass
    late = dict(on_workers(refusing, [1], client))[0]  # what a worker says that came later
    assert "this machine 9.9.9; install the same version everywhere" in str(late)


def test_workers_without_gtau(monkeypatch: pytest.MonkeyPatch) -> None:
    from importlib.metadata import PackageNotFoundError

    cluster = SimpleNamespace(
        wait_for_workers=lambda n, timeout: None,
        run=lambda function, name, on_error: {"tcp://far:1": PackageNotFoundError("gtau")},
    )
    with pytest.raises(GtauError, match="the Dask worker tcp://far:1 has no gtau; install gtau"):
        workers._check_workers(cluster, "tcp://far:2")


def test_without_dask(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(GtauError, match=r"pip install 'gtau\[dask\]'"), connected("local"):
        pass


# The command line


def program(folder: Path, *arguments: str) -> subprocess.CompletedProcess:
    command = [sys.executable, "-c", "from gtau.cli import main; main()", *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120)


def test_identify_on_a_scheduler(client, experiment: Path, tmp_path: Path) -> None:
    made = program(tmp_path, "identify", str(experiment), "--out", "out", "--dask", client.scheduler.address)
    assert (made.returncode, made.stderr) == (0, "")
    from gtau.estimation.results.result import Result

    found = numbers(Result.load(tmp_path / "out" / "model.json"))
    assert found == pytest.approx(numbers(identify(experiment)), rel=1e-10, abs=1e-12)
