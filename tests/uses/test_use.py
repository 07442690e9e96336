"""Torques along a log: what the model predicts, and what comes from outside."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from five_bar_logs import EXPERIMENT, GAINS, STEEL, Plant, write_log
from typer.testing import CliRunner

import gtau
from gtau.cli.commands import app
from gtau.estimation.diagnostics.verdict import GOOD
from gtau.findings import Grade
from gtau.model.home import load_robot
from gtau.robots.readers.read import frame_on
from gtau.signals.reading.statements import Payload
from gtau.signals.reading.units import Units
from gtau.uses.external_torques import torques_along_log, write_table
from gtau.uses.identify import carrying

PLANT = Plant(noise=0.005)


@pytest.fixture(scope="module")
def result() -> gtau.Result:
    loaded = replace(PLANT.run("loaded", payload=STEEL, seed=2), payload=Payload(name="steel", mass=STEEL["m"]))
    return gtau.identify(load_robot("five-bar"), [PLANT.run("free", seed=1), loaded])


def pushed(start: float, stop: float, torque: float) -> gtau.Run:
    """A run in which the environment exerts a torque on the left joint for a while."""
    run = PLANT.run("pushed", seed=5)
    command = np.array(run.command)
    command[(run.time > start) & (run.time < stop), 0] -= torque / GAINS[0]
    return replace(run, command=command)


def test_a_push_is_the_external_torque(result: gtau.Result) -> None:
    found = torques_along_log(result, pushed(3.0, 4.0, 2.0))
    table = found.table
    while_pushed = table.filter(pl.col("t").is_between(3.2, 3.8) & pl.col("usable_left"))
    assert while_pushed.height > 10
    assert while_pushed["external_left"].mean() == pytest.approx(2.0, rel=0.02)
    assert abs(while_pushed["external_right"].mean()) < 0.05
    before = table.filter((pl.col("t") < 2.8) & pl.col("usable_left"))
    assert abs(before["external_left"].mean()) < 0.05
    np.testing.assert_allclose(table["external_left"], table["model_left"] - table["motor_left"])
    left, right = found.joints
    assert 2.9 < left.time < 4.1
    assert left.largest > 1.8
    assert left.share > 0.02 > right.share
    free = torques_along_log(result, PLANT.run("check", seed=7)).joints[0]
    assert free.share < 0.01
    assert free.unit == "N m"


def test_a_payload_of_the_model_is_no_external_torque(result: gtau.Result) -> None:
    run = PLANT.run("loaded", payload=STEEL, seed=9)
    without, carried = (torques_along_log(result, each).joints[0] for each in (run, carrying(result, run, "steel")))
    assert without.share > 0.5
    assert carried.share < 0.01
    with pytest.raises(gtau.GtauError, match="knows no payload 'lead'; choose from steel"):
        carrying(result, run, "lead")


def test_a_log_in_degrees_is_refused_as_by_identification(result: gtau.Result) -> None:
    run = PLANT.run("degrees", seed=5)
    with pytest.raises(gtau.GtauError, match="too far for robot 'five-bar', so its positions look like deg"):
        torques_along_log(result, replace(run, position=60 * run.position))


def test_a_robot_may_hardly_move_where_its_model_is_used(result: gtau.Result) -> None:
    run = PLANT.run("still", seed=5)
    still = run.position[:1] + 0.02 * (run.position - run.position[:1])
    in_degrees = replace(run.log, units=Units.model_validate({"position": "deg"}))
    with pytest.raises(gtau.GtauError, match="too little for robot 'five-bar'"):
        gtau.identify(result.robot, [replace(run, position=still, log=in_degrees)])
    assert torques_along_log(result, replace(run, position=still, log=in_degrees)).joints


def test_the_force_of_an_identified_model_is_zero_within_intervals_of_its_size(result: gtau.Result) -> None:
    """Parameters are known together far better than each: their covariance counts, not their standard deviations."""
    at = frame_on(result.robot.tool, "0.3 0 0 0 0 0", None)
    found = torques_along_log(result, PLANT.run("check", seed=7), at, force_only=True).wrench
    for k in (3, 4):
        force, interval = found.wrench[found.usable, k], found.interval[found.usable, k]
        assert (np.abs(force) < interval).mean() > 0.9
        assert np.median(interval) < 6 * np.sqrt(np.mean(force**2))


def test_the_command_writes_tables(result: gtau.Result, tmp_path: Path) -> None:
    result.save(tmp_path / "model.json")
    log = write_log(tmp_path / "check.csv", pushed(3.0, 4.0, 2.0))
    for name in ("free.csv", "loaded.csv"):
        write_log(tmp_path / name, PLANT.run("free", seconds=3.0))
    (tmp_path / "experiment.yaml").write_text(EXPERIMENT)
    command = ["use", str(tmp_path / "model.json"), str(log), "--experiment", str(tmp_path / "experiment.yaml")]
    tables = []
    for ending, read in (("csv", pl.read_csv), ("parquet", pl.read_parquet)):
        done = CliRunner().invoke(app, [*command, "--out", str(tmp_path / f"torques.{ending}")])
        assert not done.exit_code, done.output
        assert "External torque" in done.output
        tables.append(read(tmp_path / f"torques.{ending}"))
    assert tables[0].columns[:5] == ["t", "motor_left", "model_left", "external_left", "usable_left"]
    np.testing.assert_allclose(tables[0]["external_left"], tables[1]["external_left"])
    document = json.loads(CliRunner().invoke(app, [*command, "--json"]).stdout)
    assert document["joints"][0]["joint"] == "left"
    assert document["joints"][0]["largest"] > 1.8
    assert not document["notes"]
    named = str(write_log(tmp_path / "check_1200g.csv", pushed(3.0, 4.0, 2.0)))
    done = CliRunner().invoke(app, [*command[:2], named, *command[3:], "--observer", "5"])
    shown = " ".join(done.output.split())
    assert "largest torques by the observer, N m or N: left 2" in shown
    assert "the name of the log says 1.2 kg, but nothing is carried: --carries steel?" in shown
    verdict = replace(GOOD, grade=Grade.CONTRADICTORY, text="the gain reverses its sign")
    gains = {joint: replace(gain, verdict=verdict) for joint, gain in result.drive_gains.items()}
    result.replaced(drive_gains=gains).save(tmp_path / "model.json")
    shown = " ".join(CliRunner().invoke(app, [*command[:2], named, *command[3:]]).output.split())
    assert "- All joints contradict the description: the gain reverses its sign." in shown


def test_what_cannot_be_used_is_refused(result: gtau.Result, tmp_path: Path) -> None:
    result.save(tmp_path / "model.json")
    log = write_log(tmp_path / "check.csv", PLANT.run("check", seconds=3.0))
    done = CliRunner().invoke(app, ["use", str(tmp_path / "model.json"), str(log)])
    assert done.exit_code == 2
    assert "or name its columns by --experiment EXPERIMENT.yaml." in done.stderr
    before = log.read_bytes()
    done = CliRunner().invoke(
        app, ["use", str(tmp_path / "model.json"), str(log), "--out", str(tmp_path / "check.csv")]
    )
    assert f"--out would replace the log {log}; give the table another name." in done.stderr
    assert log.read_bytes() == before
    with pytest.raises(gtau.GtauError, match=r"ends in neither .csv nor .parquet"):
        write_table(torques_along_log(result, PLANT.run("check", seconds=3.0)), tmp_path / "torques.txt")


def test_logs_of_gtau_s_own_columns_need_no_experiment_file(result: gtau.Result, tmp_path: Path) -> None:
    result.save(tmp_path / "model.json")
    text = write_log(tmp_path / "check.csv", PLANT.run("check", seconds=3.0)).read_text()
    log = tmp_path / "named.csv"
    log.write_text(text.replace("t,q1,q2,v1,v2", "t,qleft,qright,vleft,vright"))
    done = CliRunner().invoke(app, ["use", str(tmp_path / "model.json"), str(log)])
    assert not done.exit_code, done.output
