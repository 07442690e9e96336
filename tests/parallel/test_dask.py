"""Work on Dask workers: real processes, one of them killed, and everything that a cluster may lack."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from five_bar_logs import EXPERIMENT, STEEL, Plant, write_log
from shard_functions import away, fragile, refusing, slow_reduce_shard

from gtau.errors import GtauError
from gtau.estimation.experiment_runs import read_runs
from gtau.estimation.identify import identify
from gtau.estimation.regression.dataset import reduce_runs, reduce_shard
from gtau.estimation.regression.factors import STRETCHES
from gtau.model.home import load_robot
from gtau.parallel import dask_executor
from gtau.parallel.dask_executor import connected, dask_map
from gtau.parallel.process_executor import LIMITS, ignore_sigint
from gtau.signals.experiment import read_experiment
from gtau.signals.run import read_run

distributed = pytest.importorskip("distributed")


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


def test_a_worker_killed_in_the_middle_changes_nothing(client, experiment: Path) -> None:
    described = read_experiment(experiment)
    dataset = reduce_runs(load_robot("five-bar"), read_runs(described, described.runs))
    shards = [
        replace(whole, stretches=range(k, k + 1)) for run in dataset.parts() for whole in run for k in range(STRETCHES)
    ]
    before, killed, found = client.run(os.getpid), [], {}
    for k, result in dask_map(slow_reduce_shard, shards, client):
        if not killed:
            killed.append(min(before.values()))
            os.kill(killed[0], signal.SIGKILL)
        found[k] = result
    assert killed[0] not in client.run(os.getpid).values()
    assert sorted(found) == list(range(2 * STRETCHES))
    for k, shard in enumerate(shards):
        expected = reduce_shard(shard)
        assert np.array_equal(found[k].R, expected.R)  # to the last bit
        assert np.array_equal(found[k].distances, expected.distances)


def test_refused_and_lost_shards_are_reported_and_the_others_are_done(client) -> None:
    for function, says in ((refusing, "no three."), (fragile, "it killed one Dask worker after the other")):
        found = dict(dask_map(function, range(5), client))
        assert says in str(found.pop(3))
        assert found == {k: k * k for k in (0, 1, 2, 4)}


def test_an_error_that_goes_away_is_tried_again(client, tmp_path: Path) -> None:
    assert dict(dask_map(away, [tmp_path], client)) == {0: "read"}


def test_a_worker_that_does_not_see_the_log_is_named(client, tmp_path: Path) -> None:
    signals = {"time": "t", "position": {"left": "q1"}, "current": {"left": "v1"}}
    path = write_log(tmp_path / "log.csv", Plant(noise=0.01).run("log", seconds=3.0))
    run = read_run(path, signals)
    path.rename(tmp_path / "elsewhere.csv")
    (refused,) = dict(dask_map(refusing, [run], client)).values()
    says = (
        rf"on the Dask worker tcp://\S+, there is no log {path}; share its folder with all workers under that path, or"
    )
    assert re.match(says, str(refused))


def test_an_error_that_stays_is_reported(client, tmp_path: Path) -> None:
    (refused,) = dict(dask_map(away, [tmp_path / "missing"], client)).values()
    assert re.match(r"the Dask worker tcp://\S+ failed \(.*No such file.*\); check its disks", str(refused))


def test_workers_that_do_not_come_back() -> None:
    with ignore_sigint():
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


def test_a_scheduler_that_stops(experiment: Path) -> None:
    with ignore_sigint():
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
    monkeypatch.setattr(dask_executor, "installed", lambda: "9.9.9")
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
        dask_executor._check_workers(cluster, "tcp://far:2", patience=1.0, ours="1.0")


def test_without_dask(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(GtauError, match=r"pip install 'gtau\[dask\]'"), connected("local"):
        pass


# The command line


def program(folder: Path, *arguments: str) -> subprocess.CompletedProcess:
    command = [sys.executable, "-c", "from gtau.cli import main; main()", *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120)


@pytest.mark.slow
def test_identify_on_a_scheduler(client, experiment: Path, tmp_path: Path) -> None:
    made = program(tmp_path, "identify", str(experiment), "--out", "out", "--dask", client.scheduler.address)
    assert (made.returncode, made.stderr) == (0, "")
    from gtau.estimation.results.result import Result

    found = numbers(Result.load(tmp_path / "out" / "model.json"))
    assert found == pytest.approx(numbers(identify(experiment)), rel=1e-10, abs=1e-12)
