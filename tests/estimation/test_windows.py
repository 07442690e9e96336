"""Windows of the runs for the tests of the model: of rows that count, also where the robot rests."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from five_bar_logs import STEEL, Plant

from gtau.estimation.diagnostics.diagnose import FEW_ROWS, FEWEST_FOR_TESTS, examine
from gtau.estimation.estimators.maximum_likelihood import ML
from gtau.estimation.regression.dataset import Dataset, reduce_runs
from gtau.estimation.regression.run_blocks import BLOCKS, PreparedRuns, block_edges, block_of, usable_rows
from gtau.findings import Grade
from gtau.model.home import load_robot
from gtau.result import identify
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run

ROBOT = load_robot("five-bar")


def resting(run: Run, seconds: float) -> Run:
    """Let the robot stand still in the middle of a run."""
    half, more = len(run.time) // 2, round(seconds * run.rate)

    def held(values: np.ndarray) -> np.ndarray:
        return np.concatenate([values[:half], np.repeat(values[half : half + 1], more, axis=0), values[half:]])

    valid = held(run.valid)
    valid[half - 20 : half + 20] = valid[half + more - 20 : half + more + 20] = False  # it stops at once
    time = run.time[0] + np.arange(len(run.time) + more) / run.rate
    return replace(run, time=time, position=held(run.position), command=held(run.command), valid=valid)


def dataset(rest: float) -> Dataset:
    plant = Plant(noise=0.01)
    free, loaded = plant.run("free", 10.0, seed=1), plant.run("loaded", 10.0, STEEL, seed=2)
    runs = [free, replace(loaded, payload=Payload(name="steel", mass=STEEL["m"]))]
    preparation = reduce_runs(ROBOT, runs).preparation
    return reduce_runs(ROBOT, [resting(run, rest) if rest else run for run in runs], preparation)


@pytest.mark.parametrize("pieces", [1, 10])
def test_windows_hold_as_many_rows_where_the_robot_rests(pieces: int) -> None:
    moving, at_rest = dataset(0.0), dataset(30.0)
    windows = at_rest.windows(pieces)
    assert len(windows) == len(moving.windows(pieces))
    assert usable_rows(windows, at_rest.prepared) > 0.9 * usable_rows(moving.windows(pieces), moving.prepared)
    assert all(usable_rows([each], at_rest.prepared) for each in windows)


def test_tests_of_runs_that_hardly_move_are_skipped_and_say_so() -> None:
    data = dataset(0.0)
    few = PreparedRuns(replace(each, speeds=each.speeds * 1e6) for each in data.prepared)
    fit = ML.fit(data.system())
    examined = examine(replace(fit, system=replace(fit.system, dataset=replace(data, prepared=few))))
    ((said,), rows) = examined.findings, usable_rows(data.windows(10), data.prepared)
    assert (said.kind, "(0 rows " in said.what, examined.effects) == (FEW_ROWS, True, ())
    assert rows > FEWEST_FOR_TESTS * len(fit.solution.values)


@pytest.mark.parametrize("robot", ["arm_idle", pytest.param("five_bar_idle", marks=pytest.mark.slow)])
def test_gains_of_robots_that_rest_are_good_and_right(shared: Path, robot: str) -> None:
    folder = shared / "idle_and_bursts" / robot
    result, truth = identify(folder / "experiment.yaml"), json.loads((folder / "truth.json").read_text())["gains"]
    for joint, gain in result.drive_gains.items():
        assert gain.verdict.outcome == Grade.GOOD
        assert gain.interval(0.999)[0] < truth[joint] < gain.interval(0.999)[1]


def test_a_long_rest_widens_no_interval() -> None:
    """The jackknife leaves out blocks of as many rows each, however long the robot stood still."""
    moving, at_rest = dataset(0.0), dataset(150.0)
    for factors in at_rest.factors:
        rows = factors.rows.sum(axis=1)
        assert rows.min() > 0.4 * rows.mean()  # the two at the rest lose those next to it
    before, after = (ML.fit(each.system()).solution for each in (moving, at_rest))
    ratio = np.sqrt(np.diag(after.jackknife) / np.diag(before.jackknife))
    assert 0.7 < np.median(ratio) < 1.4


def test_stretches_are_equal_where_the_robot_does_not_rest() -> None:
    for each in dataset(0.0).prepared:
        assert block_edges(each) == pytest.approx(np.linspace(0, 1, BLOCKS + 1), abs=1e-12)
        outputs = 997
        assert block_of(block_edges(each), outputs).tolist() == (np.arange(outputs) * BLOCKS // outputs).tolist()
