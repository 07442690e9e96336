"""Wrong units, wrong clocks and currents that never felt the payload are named, not what follows from them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from five_bar_logs import EXPERIMENT, STEEL, Plant, write_log

from gtau.errors import GtauError
from gtau.estimation.effects.known.gravity import clock_words
from gtau.estimation.regression.plausibility import within_limits
from gtau.findings import Grade
from gtau.model.home import load_robot
from gtau.result import check, identify
from gtau.robots.readers.read import CATALOG
from gtau.signals.preparation.bandwidth import choose_preparation
from gtau.signals.preparation.prepared_run import prepare
from gtau.signals.run import Run

PLANT = Plant(noise=0.01)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("plausibility")
    write_log(folder / "free.csv", PLANT.run("free", seed=1))
    write_log(folder / "loaded.csv", PLANT.run("loaded", payload=STEEL, seed=2))
    write_log(folder / "check.csv", PLANT.run("check", payload=STEEL, seed=3))
    write_log(folder / "unfelt.csv", PLANT.run("unfelt", seed=2))
    (folder / "experiment.yaml").write_text(EXPERIMENT)
    return folder


def test_the_right_rate_raises_no_doubt(folder: Path) -> None:
    path = _with(folder, "right", "time: t", f"time: {{rate: {_rate(folder)}}}")
    assert {each.verdict.outcome.value for each in identify(path).drive_gains.values()} == {"good"}


@pytest.mark.slow
@pytest.mark.parametrize(("factor", "high"), [(2.0, True), (1.4, True), (0.6, False)])
def test_a_wrong_rate_is_named(folder: Path, factor: float, high: bool) -> None:
    path = _with(folder, "wrong", "time: t", f"time: {{rate: {factor * _rate(folder):g}}}")
    for gain in identify(path).drive_gains.values():
        assert gain.verdict.outcome.value == "contradictory"
        assert gain.verdict.finding.kind == "description refuted"
        assert f"a sampling rate that is too {'high' if high else 'low'}" in gain.verdict.why
        assert f"'rate: {factor * _rate(folder):g}' is wrong (rather" in gain.verdict.advice
        true = float(gain.verdict.advice.partition("(rather ")[2].partition(")")[0])
        assert true == pytest.approx(_rate(folder), rel=0.03)


def test_of_time_stamps_lengths_are_doubted_first() -> None:
    """No unit of time is 5 % off; lengths that are 10 % too large look the same."""
    _, run = _one_joint("revolute")
    what, advice = clock_words(SimpleNamespace(dataset=SimpleNamespace(runs=[run])), 1.1**0.5)  # type: ignore[arg-type]
    assert what.startswith("lengths throughout the robot that are too large by 10 %, or a sampling rate that is too")
    assert advice.startswith("check the lengths")


@pytest.mark.slow
@pytest.mark.parametrize("gravity", ["[0, 0, 9.81]", "[6.9, 0, -6.9]"])
def test_gravity_of_another_direction_is_no_clock(folder: Path, gravity: str) -> None:
    robot = (CATALOG / "five-bar.yaml").read_text()
    (folder / "tilted.yaml").write_text(f"{robot}\ngravity: {gravity}\n")
    for gain in identify(_with(folder, "tilt", "robot: five-bar", "robot: tilted.yaml")).drive_gains.values():
        assert gain.verdict.outcome.value == "contradictory"
        finding = gain.verdict.finding
        assert finding.kind == "all gains negative" or finding.causes == ("gravity",)


def test_currents_that_never_felt_the_payload(folder: Path) -> None:
    with pytest.raises(GtauError, match="the currents are explained as well without payload 'steel'"):
        identify(_with(folder, "unfelt", "log: loaded.csv", "log: unfelt.csv"))


def _one_joint(kind: str) -> tuple[object, Run]:
    robot = load_robot("orthoglide" if kind == "prismatic" else "five-bar")
    time = np.arange(4000) / 500
    joints = robot.actuated
    home = np.array([robot.joint(joint).home for joint in joints])
    q = home + 0.05 * np.sin(2 * np.pi * np.outer(time, 0.5 + 0.1 * np.arange(len(joints))))
    return robot, Run("moves", joints, time, q, np.zeros_like(q))


@pytest.mark.parametrize("kind", ["prismatic", "revolute"])
def test_positions_in_another_unit(kind: str) -> None:
    robot, run = _one_joint(kind)
    unlimited = replace(
        robot,
        joints=tuple(replace(each, limits=type(each.limits)()) for each in robot.joints),  # type: ignore[attr-defined]
    )

    def checked(factor: float, time: float = 1.0) -> None:
        scaled = replace(run, position=run.position * factor, time=run.time * time)
        within_limits(unlimited, prepare(scaled, choose_preparation([scaled])))

    checked(1.0)
    other = "mm" if kind == "prismatic" else "deg"
    with pytest.raises(GtauError, match=rf"look like {other} taken for .*; write {other} under units\.position"):
        checked(1000.0)
    with pytest.raises(GtauError, match=r"which no robot has; correct the unit of the time"):
        checked(5.0, 1e-3)


@pytest.mark.parametrize("unit", ["deg", "degree"])
def test_metres_and_radians_declared_as_mm_and_deg(folder: Path, unit: str) -> None:
    text = EXPERIMENT.replace("runs:", f"units: {{position: {unit}}}\nruns:", 1)
    (folder / "deg.yaml").write_text(text)
    with pytest.raises(GtauError, match=r"look like rad declared as deg; write rad under units\.position") as refused:
        identify(folder / "deg.yaml")
    checked = check(folder / "deg.yaml")
    assert checked.worst == Grade.ERROR
    assert f"{checked.notes[0]}." == str(refused.value)  # the same finding in the same words


def _rate(folder: Path) -> float:
    time = np.loadtxt(folder / "free.csv", delimiter=",", skiprows=1, usecols=0)
    return round(1 / float(np.median(np.diff(time))))


def _with(folder: Path, name: str, old: str, new: str) -> Path:
    assert old in EXPERIMENT
    path = folder / f"{name}.yaml"
    path.write_text(EXPERIMENT.replace(old, new))
    return path
