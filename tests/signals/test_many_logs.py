"""Many logs in one line of an experiment file: patterns, pairs of them, and folders of Parquet files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest
from five_bar_logs import EXPERIMENT, Plant, write_log

from gtau.documents.files import in_order
from gtau.errors import GtauError
from gtau.estimation.experiment_runs import read_runs
from gtau.signals.reading.experiment import Experiment, read_experiment

HEAD = EXPERIMENT.split("runs:")[0] + "runs:\n"


def read(folder: Path, runs: str) -> Experiment:
    (folder / "experiment.yaml").write_text(HEAD + runs)
    return read_experiment(folder / "experiment.yaml")


@pytest.fixture(params=["plain", "with [brackets] and *"])
def folder(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A folder, whose own name may look like a pattern."""
    made = tmp_path / request.param
    (made / "logs").mkdir(parents=True)
    for name in ("free_1", "free_2", "free_10", "loaded_1", "loaded_2"):
        (made / "logs" / f"{name}.csv").touch()
    return made


def names(experiment: Experiment) -> list[str]:
    return ["+".join(log.stem for log in run.log) for run in experiment.runs]


def test_a_pattern_is_many_runs_with_one_payload(folder: Path) -> None:
    listed = read(folder, "  - log: logs/free_*.csv\n  - {log: 'logs/loaded_?.csv', payload: {name: a, mass: 1}}\n")
    assert names(listed) == ["free_1", "free_2", "free_10", "loaded_1", "loaded_2"]
    assert [run.payload is not None for run in listed.runs] == [False] * 3 + [True] * 2
    assert all(log.is_file() for run in listed.runs for log in run.log)
    assert names(read(folder, "  - log: '**/free_[12].csv'\n")) == ["free_1", "free_2"]


def test_a_pattern_leaves_out_the_file_that_it_stands_in(folder: Path) -> None:
    for path in (folder / "logs").iterdir():
        path.rename(folder / path.name)
    (folder / "logs").rmdir()
    (folder / "robot.yml").touch()
    assert names(read(folder, "  - log: '*'\n")) == ["free_1", "free_2", "free_10", "loaded_1", "loaded_2"]


def test_of_two_patterns_the_matches_are_pairs(folder: Path) -> None:
    listed = read(folder, "  - log: [logs/free_?.csv, logs/loaded_*.csv]\n")
    assert names(listed) == ["free_1+loaded_1", "free_2+loaded_2"]


def test_a_file_whose_name_looks_like_a_pattern(folder: Path) -> None:
    (folder / "logs" / "free_[1].csv").touch()
    assert names(read(folder, "  - log: logs/free_[1].csv\n")) == ["free_[1]"]


@pytest.mark.parametrize(
    ("runs", "says"),
    [
        ("  - log: logs/fred_*.csv\n", "logs/fred_*.csv'; paths are relative to the experiment file"),
        ("  - log: logs/fred_1.csv\n", "did you mean 'free_1.csv'?"),
        ("  - log: [logs/free_*.csv, logs/loaded_*.csv]\n", "'logs/free_*.csv' matches 3 files and 'logs/loaded_"),
        ("  - log: logs\n", "holds no .parquet files"),
        ("  - log: '*'\n", "holds no .parquet files"),
        ("  - log: logs/free_1.csv\n  - log: logs/free_*.csv\n", "is listed twice"),
    ],
)  # fmt: skip
def test_what_does_not_match(folder: Path, runs: str, says: str) -> None:
    with pytest.raises(GtauError) as refused:
        read(folder, runs)
    assert says in str(refused.value)


def test_a_folder_of_parquet_files_is_one_log(tmp_path: Path) -> None:
    run = Plant(noise=0.01).run("whole", seconds=6.0)
    table = pl.read_csv(write_log(tmp_path / "whole.csv", run))
    (tmp_path / "parts.parquet").mkdir()
    for k, part in enumerate(table.iter_slices(-(-len(table) // 12))):
        part.write_parquet(tmp_path / "parts.parquet" / f"part.{k}.parquet")
    (tmp_path / "parts.parquet" / "_SUCCESS").touch()
    assert len(list((tmp_path / "parts.parquet").glob("*.parquet"))) == 12  # part.10 stands after part.2
    experiment = read(tmp_path, "  - log: whole.csv\n  - log: parts.parquet\n")
    whole, parts = read_runs(experiment, experiment.runs)
    for name in ("time", "position", "command", "valid"):
        assert np.array_equal(getattr(whole, name), getattr(parts, name))


def test_numbers_in_names_are_numbers() -> None:
    paths = [Path(name) for name in ("b", "a10", "a9", "a", "a9b", "10", "9")]
    assert [str(path) for path in in_order(paths)] == ["9", "10", "a", "a9", "a9b", "a10", "b"]
