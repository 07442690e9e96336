"""Logs with gaps are cut into runs; rows out of order or twice are put right; logs for validation stop nothing."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from five_bar_logs import GAINS, Plant, write_experiment
from typer.testing import CliRunner

from gtau.cli.commands import app
from gtau.errors import GtauError
from gtau.estimation.experiment_runs import read_runs, read_validation
from gtau.result import check, identify
from gtau.signals.reading.experiment import read_experiment
from gtau.signals.run import Run

How = Callable[[np.ndarray], np.ndarray]
Change = Callable[[str, How], Path]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two logs of 5000 rows at 500 Hz, and one for validation."""
    return write_experiment(tmp_path_factory.mktemp("gaps"), Plant(noise=0.01)).parent


@pytest.fixture
def change(folder: Path, tmp_path: Path) -> Change:
    """Copy the experiment with one log changed."""

    def changed(log: str, how: How) -> Path:
        for file in folder.iterdir():
            (tmp_path / file.name).write_bytes(file.read_bytes())
        table = how(np.loadtxt(folder / log, delimiter=",", skiprows=1))
        np.savetxt(tmp_path / log, table, delimiter=",", header="t,q1,q2,v1,v2", comments="", fmt="%.9g")
        return tmp_path / "experiment.yaml"

    return changed


def runs_of(path: Path) -> tuple[Run, ...]:
    experiment = read_experiment(path)
    return read_runs(experiment, experiment.runs)


def without(*ranges: tuple[int, int]) -> How:
    return lambda table: np.delete(table, np.r_[tuple(slice(*ends) for ends in ranges)], axis=0)


def held(begin: int, end: int) -> How:
    """Rows that repeat the last one, but for their time."""

    def repeated(table: np.ndarray) -> np.ndarray:
        table = table.copy()
        table[begin:end, 1:] = table[begin - 1, 1:]
        return table

    return repeated


@pytest.mark.parametrize("fault", [without((1666, 1791)), held(1666, 1791)], ids=["missing", "repeated"])
def test_a_dropout_cuts_the_log_into_two_runs(fault: How, change: Change) -> None:
    path = change("free.csv", fault)
    first, second, loaded = runs_of(path)
    assert (first.name, second.name, loaded.name) == ("free from 0 s to 3.33 s", "free from 3.58 s", "loaded")
    assert (len(first.time), len(second.time)) == (1666, 3209)
    note = " ".join(map(str, first.notes))
    assert "cut the log at 1 gap or dropout, the first after 3.33 s (line 1667), the longest of 0.252 s, into 2" in note
    assert second.notes == ()
    result = identify(path)
    for gain, truth in zip(result.drive_gains.values(), GAINS, strict=True):
        low, high = gain.interval(0.999) or (0.0, 0.0)
        assert low < truth < high


def test_parts_that_are_short_or_rest_are_left_out_and_said(change: Change) -> None:
    def still(table: np.ndarray) -> np.ndarray:
        table = table.copy()
        table[4000:, 1:3] = table[4000, 1:3]
        return without((1000, 1100), (1400, 1500), (3900, 4000))(table)

    path = change("free.csv", still)
    first, second, _ = runs_of(path)
    assert (len(first.time), len(second.time)) == (1000, 2400)
    (note,) = (note for note in first.notes if note.kind == "log cut at gaps")
    assert "; 1300 rows that repeat the last one, or are in parts without motion or too short" in note.what
    checked = check(path)
    assert [log.run.name for log in checked.logs][:2] == [first.name, second.name]
    assert note.from_source(first.name) in checked.notes


def test_rows_twice_and_rows_that_changed_places_are_put_right(change: Change) -> None:
    def shuffled(table: np.ndarray) -> np.ndarray:
        order = np.arange(len(table))
        order[[900, 901]] = 901, 900
        return table[np.r_[order[:500], order[480:]]]

    first, _ = runs_of(change("free.csv", shuffled))
    said = " ".join(map(str, first.notes))
    assert "put 1 row in the order of their times (line 923)" in said
    assert "dropped 20 repeated rows" in said
    assert len(first.time) == 5000


def test_a_stamp_that_goes_back_leaves_the_rows_in_order(change: Change, folder: Path) -> None:
    def stamped(table: np.ndarray) -> np.ndarray:
        table = table.copy()
        table[700, 0] = table[698, 0] - 0.0006
        return table

    (first, _), (true, _) = runs_of(change("free.csv", stamped)), runs_of(folder / "experiment.yaml")
    assert abs(first.rate - 500) < 0.5
    same = min(len(first.time), len(true.time))
    assert np.abs(first.position[:same] - true.position[:same]).max() < 0.02


def test_time_that_goes_far_back_is_refused(change: Change) -> None:
    with pytest.raises(GtauError, match="time goes back from"):
        runs_of(change("free.csv", lambda table: table[np.r_[0:3000, 1000:5000]]))


def test_rows_that_lack_in_a_log_with_a_stated_rate_are_no_slipped_coupling(change: Change) -> None:
    path = change("free.csv", without((1666, 1791)))
    path.write_text(path.read_text().replace("time: t", "time: {rate: 500}"))
    with pytest.raises(GtauError, match=r"'left' and 'right' jump together at 3.332 s, so rows are missing"):
        runs_of(path)


def test_a_log_for_validation_that_cannot_be_used_stops_nothing(change: Change, tmp_path: Path) -> None:
    path = change("check.csv", lambda table: np.c_[table[:, :3], np.clip(table[:, 3:], -0.3, 0.3)])
    runs, (note,) = read_validation(read_experiment(path))
    assert runs == []
    assert "is clipped at" in note.what
    path.write_text(path.read_text() + "require: {torque_error: 5 %}\n")
    result = identify(path)
    assert [requirement.found is None for requirement in result.requirements] == [False, True]
    done = CliRunner().invoke(app, ["identify", str(path), "--out", str(tmp_path / "out")])
    assert "is clipped at" in " ".join(done.output.split())


def test_a_part_too_short_for_the_tests_of_other_preparations_stops_nothing(folder: Path, tmp_path: Path) -> None:
    """Ten times as slow, so that the usual filters leave no row in the middle of its 6 s, and others some."""
    for file in folder.glob("*.csv"):
        table = np.loadtxt(file, delimiter=",", skiprows=1) * [10, 1, 1, 1, 1]
        np.savetxt(tmp_path / file.name, table, delimiter=",", header="t,q1,q2,v1,v2", comments="", fmt="%.9g")
    text = (folder / "experiment.yaml").read_text()
    text = text.replace("{log: free.csv}", "{log: free.csv, to: 93.58}\n  - {log: free.csv, from: 94}")
    (tmp_path / "experiment.yaml").write_text(text)
    assert set(identify(tmp_path / "experiment.yaml").runs) >= {"free from 94 s"}
