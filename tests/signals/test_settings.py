"""What is set of the preparation by hand, and which parts of logs are used."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from five_bar_logs import EXPERIMENT, Plant, write_log

from gtau.errors import GtauError
from gtau.estimation.experiment_runs import read_runs
from gtau.signals.preparation.bandwidth import choose_preparation
from gtau.signals.preparation.filters import Preparation
from gtau.signals.preparation.prepared_run import prepare
from gtau.signals.reading.experiment import read_experiment

HEAD = EXPERIMENT.split("runs:")[0]


def experiment(folder: Path, runs: str, preparation: str = "") -> Path:
    write_log(folder / "a.csv", Plant(noise=0.01).run("a", 20.0))
    path = folder / "experiment.yaml"
    path.write_text(HEAD + (f"preparation: {preparation}\n" if preparation else "") + f"runs:\n{runs}")
    return path


def prepared(path: Path) -> Preparation:
    read = read_experiment(path)
    return choose_preparation(read_runs(read, read.runs))


def test_what_is_given_is_taken(tmp_path: Path) -> None:
    given = "{bandwidth: 3, position_filter: 20, decimation: 7, least_speed: 0.1, clock: stamps}"
    preparation = prepared(experiment(tmp_path, "  - {log: a.csv}\n", given))
    assert (preparation.bandwidth, preparation.cutoff) == (3, 20)
    assert (preparation.decimator.factor, preparation.speed_fraction) == (7, 0.1)
    assert preparation.given == ("bandwidth", "position_filter", "decimation", "least_speed", "clock")
    assert prepared(experiment(tmp_path, "  - {log: a.csv}\n", "{position_filter: none}")).cutoff is None


@pytest.mark.parametrize(
    ("preparation", "message"),
    [
        ("{position_filter: 300}", "position_filter is 300 Hz, .* 500 Hz"),
        ("{bandwidth: 5000}", "bandwidth is 5000 Hz, .* 500 Hz"),
        ("{bandwidth: 0.01}", "bandwidth is 0.01 Hz, .* 20 s"),
        ("{decimation: 2.5}", "decimation: '2.5' is not a whole number"),
        ("{clock: late}", "clock"),
        ("{cutoff: 3}", "cutoff"),
        ("{decimation: 0}", "decimation"),
    ],
)
def test_what_cannot_be_is_refused(preparation: str, message: str, tmp_path: Path) -> None:
    path = experiment(tmp_path, "  - {log: a.csv}\n", preparation)
    with pytest.raises(GtauError, match=message):
        prepared(path)


@pytest.mark.filterwarnings("error")
def test_a_filter_longer_than_the_logs_is_refused(tmp_path: Path) -> None:
    path = experiment(tmp_path, "  - {log: a.csv}\n", "{position_filter: 0.1}")
    (run,) = read_runs(read := read_experiment(path), read.runs)
    with pytest.raises(GtauError, match=r"margins.*position_filter"):
        prepare(run, choose_preparation([run]))


def test_parts_of_a_log(tmp_path: Path) -> None:
    runs = "  - {log: a.csv, to: 8}\n  - {log: a.csv, skip: 50, from: 8.5, to: 12.5}\n"
    read = read_experiment(experiment(tmp_path, runs))
    whole = Plant(noise=0.01).run("a", 20.0)
    first, second = read_runs(read, read.runs)
    assert (first.name, second.name) == ("a from 0 s to 8 s", "a from 8.5 s to 12.5 s")
    assert len(first.time) == 4001
    assert second.time[0] == pytest.approx(8.6, abs=1e-3)  # 50 rows of 2 ms are skipped before time counts
    np.testing.assert_allclose(second.position, whole.position[4300:6301], atol=1e-6)


@pytest.mark.parametrize(
    ("runs", "message"),
    [
        ("  - {log: a.csv, to: 8}\n  - {log: a.csv, from: 7}\n", "parts .from, to. that do not overlap"),
        ("  - {log: a.csv, from: 7, to: 3}\n", "write the earlier one as 'from'"),
        ("  - {log: a.csv, from: 70}\n", "has no rows in the selected part"),
    ],
)
def test_parts_that_cannot_be(runs: str, message: str, tmp_path: Path) -> None:
    path = experiment(tmp_path, runs)
    with pytest.raises(GtauError, match=message):
        prepared(path)
