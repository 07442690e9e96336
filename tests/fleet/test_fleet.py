"""Fleets: fourteen robots, two of which are off; names, fleet files, failures, and going on."""

from __future__ import annotations

import json
import re
from pathlib import Path
from platform import node
from unittest.mock import Mock

import numpy as np
import polars as pl
import pytest
from five_bar_logs import EXPERIMENT, GAINS, JOINTS, STEEL, Plant, write_log
from typer.testing import CliRunner

import gtau
from gtau.cli.commands import app
from gtau.errors import GtauError
from gtau.fleets import fleet
from gtau.fleets.fleet import Member, identify_fleet, read_fleet
from gtau.fleets.table import Report, fleet_page, fleet_table
from gtau.fleets.workers import serial_map
from gtau.report.terminal import plain
from gtau.result import identify, load
from gtau.signals.reading.experiment import read_experiment

ONE = EXPERIMENT.split("validation")[0]
ROBOTS, SECONDS = 14, 4.0
OFF = {7: 0, 11: 1}  # robot to its joint that is 5 % off


@pytest.fixture(scope="module")
def cells(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Logs of fourteen robots whose gains differ by 0.2 %, but for two."""
    folder, rng = tmp_path_factory.mktemp("cells"), np.random.default_rng(5)
    for k in range(ROBOTS):
        gains = np.array(GAINS) * (1 + 0.002 * rng.standard_normal(2))
        if k in OFF:
            gains[OFF[k]] *= 1.05
        plant = Plant(gains=tuple(gains), noise=0.003)
        cell = folder / f"robot_{k}"
        cell.mkdir()
        write_log(cell / "free.csv", plant.run("free", SECONDS, seed=2 * k))
        write_log(cell / "loaded.csv", plant.run("loaded", SECONDS, payload=STEEL, seed=2 * k + 1))
        (cell / "experiment.yaml").write_text(ONE)
    return folder


def run(*arguments: str):
    result = CliRunner().invoke(app, ["fleet", *arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def test_a_member_is_found_from_another_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    member = Member("one", Path("e.yaml"), Path("logs")).anywhere
    assert (member.name, member.experiment, member.logs) == ("one", tmp_path / "e.yaml", tmp_path / "logs")


@pytest.mark.slow
def test_the_two_that_are_off_are_found(cells: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gtau.cli.console.EVERY", 1e6)  # s: a busy machine takes minutes
    out = tmp_path / "out"
    arguments = (str(cells / "*" / "experiment.yaml"), "--out", str(out))
    result = run(*arguments, "--jobs", "1")
    assert (result.exit_code, result.stderr) == (0, "")
    assert re.search(rf"identified +{ROBOTS}\nrefused +0\n", result.stdout)
    table = pl.read_parquet(out / "gains.parquet")
    assert table.drop("why").equals(pl.read_csv(out / "gains.csv", schema=table.schema).drop("why"))
    assert table["robot"].unique(maintain_order=True).to_list() == [f"robot_{k}" for k in range(ROBOTS)]
    outliers = table.filter("outlier")
    assert set(zip(outliers["robot"], outliers["joint"], strict=True)) == {
        (f"robot_{k}", JOINTS[joint]) for k, joint in OFF.items()
    }
    assert outliers["difference_percent"].to_list() == pytest.approx([5, 5], abs=1)
    # the models are those of 'gtau identify'
    model = load(out / "models" / "robot_3.json")
    alone = identify(cells / "robot_3" / "experiment.yaml")
    assert [g.value for g in model.drive_gains.values()] == pytest.approx([g.value for g in alone.drive_gains.values()])

    # once more: nothing is computed again, and the document says the same
    monkeypatch.setattr(fleet, "model_text", None)
    found = json.loads(run(*arguments, "--jobs", "1", "--json").stdout)
    assert [g["gain"] for g in found["gains"]] == table["gain"].to_list()
    assert [each["robots"] for each in found["joints"]] == [ROBOTS, ROBOTS]
    for joint, gain in zip(found["joints"], GAINS, strict=True):
        assert joint["median"] == pytest.approx(gain, abs=5 * joint["median_std"])


def some(cells: Path, *robots: int) -> tuple[Member, ...]:
    return read_fleet([cells / f"robot_{k}" / "experiment.yaml" for k in robots])


def test_a_robot_that_fails_does_not_stop_the_others(cells: Path, tmp_path: Path) -> None:
    bad = tmp_path / "bad" / "experiment.yaml"
    bad.parent.mkdir()
    bad.write_text(ONE)
    members = (*some(cells, 1, 2), Member("bad", bad))
    reports = identify_fleet(members, tmp_path, serial_map)
    assert [report.model is None for report in reports] == [False, False, True]
    assert "there is no file" in reports[2].sentence
    page = plain(fleet_page(fleet_table(reports)))
    assert re.search(r"identified +2\nrefused +1\n", page)
    assert f"bad: {bad}, line 5, runs.1.log: there is no file" in " ".join(page.split())
    assert "too few to detect outliers" in " ".join(page.split())


@pytest.mark.parametrize(
    ("error", "says"),
    [
        (ZeroDivisionError("oops"), "internal error (ZeroDivisionError: oops); report it with the output of"),
        (OSError("disk full"), f"the machine {node()} failed (disk full); check its disks and network."),
    ],
)
def test_what_fails_in_the_middle_is_reported(
    cells: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception, says: str
) -> None:
    monkeypatch.setattr("gtau.uses.identify.identify", Mock(side_effect=error))
    (report,) = identify_fleet(some(cells, 3), tmp_path, serial_map)
    assert says in report.sentence
    assert fleet_table([report]).refused[0][0] == report.robot


def test_lost_robots_are_reported(cells: Path, tmp_path: Path) -> None:
    def losing(function, items):
        yield 1, GtauError("its worker died.")
        yield 0, function(items[0])

    reports = identify_fleet(some(cells, 1, 2), tmp_path, losing)
    assert [report.sentence for report in reports] == ["", "its worker died."]


def test_going_on_after_an_interruption(cells: Path, tmp_path: Path) -> None:
    def interrupted(function, items):
        yield 0, function(items[0])
        raise KeyboardInterrupt

    members = some(cells, 1, 2)
    with pytest.raises(KeyboardInterrupt):
        identify_fleet(members, tmp_path, interrupted)
    name = members[0].name
    assert {path.name for path in (tmp_path / "models").iterdir()} == {f"{name}.json", f"{name}.key"}
    finished = (tmp_path / "models" / f"{name}.json").stat().st_mtime_ns
    reports = identify_fleet(members, tmp_path, serial_map)
    assert all(report.model is not None for report in reports)
    assert (tmp_path / "models" / f"{name}.json").stat().st_mtime_ns == finished


@pytest.mark.slow
@pytest.mark.parametrize("change", ["log", "experiment", "method", "robot"])
def test_what_has_changed_is_computed_again(cells: Path, tmp_path: Path, change: str) -> None:
    for name in ("free.csv", "loaded.csv"):
        (tmp_path / name).write_bytes((cells / "robot_1" / name).read_bytes())
    (tmp_path / "e.yaml").write_text(ONE)
    member = Member("one", tmp_path / "e.yaml")
    (first,) = identify_fleet([member], tmp_path, serial_map)
    finished = (tmp_path / "models" / "one.json").stat().st_mtime_ns
    (again,) = identify_fleet([member], tmp_path, serial_map)
    assert again.model == first.model
    assert (tmp_path / "models" / "one.json").stat().st_mtime_ns == finished
    method = "ml"
    if change == "log":
        lines = (tmp_path / "free.csv").read_text().splitlines()
        (tmp_path / "free.csv").write_text("\n".join(lines[:-200]) + "\n")
    elif change == "experiment":
        (tmp_path / "e.yaml").write_text(ONE.replace("mass: 1.2", "mass: 1.3"))
    elif change == "method":
        method = "2sls"
    else:
        from gtau.model.home import load_robot
        from gtau.robots.readers.native import native_text

        (tmp_path / "five-bar").write_text(native_text(load_robot("five-bar")).replace("0.35", "0.36"))
        (tmp_path / "five-bar").rename(tmp_path / "other.yaml")
        (tmp_path / "e.yaml").write_text(ONE.replace("robot: five-bar", "robot: other.yaml"))
    (other,) = identify_fleet([member], tmp_path, serial_map, method)
    assert other.model != first.model


def test_a_log_of_folders_within_a_folder_has_a_key(tmp_path: Path) -> None:
    (tmp_path / "e.yaml").write_text(re.sub("runs:.*", "runs: [{log: set}]", ONE, flags=re.DOTALL))
    for name in ("meta/info.json", "data/chunk-000/episode.parquet"):
        (tmp_path / "set" / name).parent.mkdir(parents=True)
        (tmp_path / "set" / name).write_bytes(b"{}")
    experiment = read_experiment(tmp_path / "e.yaml")
    before = fleet.inputs_key(experiment, "ml")
    (tmp_path / "set" / name).write_bytes(b"other")
    assert fleet.inputs_key(experiment, "ml") != before


# Which robots


def test_names_are_the_parts_in_which_paths_differ(tmp_path: Path) -> None:
    def names(*paths: str) -> list[str]:
        for path in paths:
            (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / path).write_text(ONE)
        return [member.name for member in read_fleet([tmp_path / path for path in paths])]

    assert names("a/e.yaml", "b/e.yaml", "b/e.yaml") == ["a", "b"]
    assert names("c/x_10.yaml", "c/x_9.yaml") == ["x_9", "x_10"]
    assert names("d/e.yaml", "d/f/e.yaml") == ["e", "f/e"]
    assert names("g/h/1/i/e.yaml", "g/h/2/j/e.yaml") == ["1/i", "2/j"]
    assert names("k/only.yaml") == ["only"]
    assert names("l/e.yaml", "l/e.yml") == ["e.yaml", "e.yml"]


def test_a_fleet_file(cells: Path, tmp_path: Path) -> None:
    (tmp_path / "fleet.yaml").write_text(f"experiments: [{cells}/robot_1*/experiment.yaml, {cells}/robot_2/*.yaml]\n")
    names = [member.name for member in read_fleet([tmp_path / "fleet.yaml"])]
    assert names == ["robot_1", "robot_2", *(f"robot_1{k}" for k in range(4))]
    (tmp_path / "one.yaml").write_text(ONE)
    (tmp_path / "fleet.yaml").write_text(f"experiment: one.yaml\nfolders: {cells}/robot_[12]\n")
    members = read_fleet([tmp_path / "fleet.yaml"])
    assert [(m.name, m.logs) for m in members] == [(f"robot_{k}", cells / f"robot_{k}") for k in (1, 2)]
    (report,) = identify_fleet(members[1:], tmp_path, serial_map)
    alone = identify(cells / "robot_2" / "experiment.yaml")
    assert report.model is not None
    assert report.model["drive_gains"][0]["value"] == alone.drive_gains["left"].value


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("experiments: nowhere/*.yaml", "no file matches"),
        ("experiment: one.yaml", "give 'experiments', one file for each robot; or 'experiment' and 'folders'"),
        ("experiment: one.yaml\nfolders: fleet.yaml", "'folders' matches no folder"),
        ("experiments: a.yaml\nexperimens: b.yaml", "unknown key 'experimens'; did you mean"),
        ("robts: a.yaml", "unknown key 'robts'; choose from experiment"),
        ("experiments: []", "0 values are written; write at least 1"),
    ],
)
def test_wrong_fleet_files(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "fleet.yaml").write_text(text + "\n")
    result = run(str(tmp_path / "fleet.yaml"), "--out", str(tmp_path / "out"))
    assert result.exit_code == 2
    assert says in result.stderr
    assert result.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_python_does_what_the_command_does(cells: Path, tmp_path: Path) -> None:
    table = gtau.fleet([cells / "robot_1" / "experiment.yaml"], tmp_path, jobs=1)
    assert table.robots == ("experiment",)
    assert table.summary() == plain(fleet_page(table))
    assert "they are too few to detect outliers" in table.summary()
    frame = table.to_frame()
    assert frame.select("robot", "joint").rows() == [("experiment", joint) for joint in JOINTS]
    assert frame["gain"].to_list() == pytest.approx([gain.gain for gain in table.gains])
    assert fleet_table([Report("broken", None, "no logs")]).to_frame()["why"].to_list() == ["no logs"]
    assert gtau.load(tmp_path / "models" / "experiment.json").gains == pytest.approx([g.gain for g in table.gains])


def test_options_that_do_not_go_together(cells: Path, tmp_path: Path) -> None:
    one = str(cells / "robot_1" / "experiment.yaml")
    wrong = {("--method", "wls"): "uses given drive gains", ("--jobs", "2", "--dask", "local"): "give one of"}
    for options, says in wrong.items():
        result = run(one, "--out", str(tmp_path), *options)
        assert result.exit_code == 2
        assert says in result.stderr


# The table


def report(name: str, gains: tuple[float, ...], std: float = 0.01) -> Report:
    estimates = [
        {"joint": joint, "value": g, "std": std, "unit": "N m/A", "freedom": 39, "outcome": "good", "why": ""}
        for joint, g in zip("ab", gains, strict=True)
    ]
    return Report(name, {"robot": "arm", "drive_gains": estimates})


def test_gains_that_are_all_off_alike_point_to_the_payload() -> None:
    reports = [report(f"r{k}", (2 + 0.001 * k, 3 + 0.001 * k)) for k in range(10)]
    page = " ".join(plain(fleet_page(fleet_table([*reports, report("heavy", (2.2, 3.3))]))).split())
    assert "robot 'heavy': all its gains are too large; check the payload's mass" in page
    page = " ".join(plain(fleet_page(fleet_table([*reports, report("motor", (2.2, 3.0))]))).split())
    assert "check the payload" not in page


def test_gains_that_are_not_known_are_compared_with_nothing() -> None:
    unknown = report("unknown", (2.0, 3.0))
    assert unknown.model is not None
    unknown.model["drive_gains"][0] |= {"value": None, "std": None, "outcome": "not identifiable", "why": "no motion"}
    table = fleet_table([*(report(f"r{k}", (2 + 0.001 * k, 3.0)) for k in range(10)), unknown])
    (gain,) = [g for g in table.gains if g.robot == "unknown" and g.joint == "a"]
    assert (gain.z, gain.outlier, gain.why) == (None, False, "no motion")
    assert [joint.robots for joint in table.joints] == [10, 11]


def test_nothing_identified_is_still_a_table(tmp_path: Path) -> None:
    (tmp_path / "e.yaml").write_text(ONE)
    result = run(str(tmp_path / "e.yaml"), "--out", str(tmp_path / "out"))
    assert result.exit_code == 3
    assert "No robot could be identified." in result.stdout
    assert pl.read_parquet(tmp_path / "out" / "gains.parquet")["outcome"].to_list() == ["refused"]
