"""Logs that cannot be of the robot."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from five_bar_logs import Plant, write_experiment

from gtau.errors import GtauError
from gtau.estimation.regression.plausibility import prepare_runs
from gtau.findings import Grade
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.result import identify
from gtau.robots.robot import Limits, Robot
from gtau.signals.preparation.bandwidth import choose_preparation
from gtau.signals.preparation.prepared_run import PreparedRun
from gtau.signals.run import Run, read_run
from gtau.uses.identify import experiment_of


def limited(limits: Limits) -> Robot:
    """A five-bar, the first motor of which has these limits."""
    robot = load_robot("five-bar")
    joints = tuple(
        replace(joint, limits=limits if joint.name == robot.actuated[0] else Limits()) for joint in robot.joints
    )
    return replace(robot, joints=joints)


@pytest.fixture(scope="module")
def run() -> Run:
    return Plant().run("free", seconds=8.0, seed=1)


def prepared(robot: Robot, run: Run) -> PreparedRun:
    model = InverseDynamics(robot)
    (found,) = prepare_runs(model, [run], choose_preparation([run]))
    return found


def test_within_limits_nothing_is_said(run: Run) -> None:
    low, high = run.position[:, 0].min(), run.position[:, 0].max()
    speed = float(np.sqrt(prepared(limited(Limits()), run).speeds[0, 0]))
    assert prepared(limited(Limits(position=(low, high), velocity=speed)), run).notes == ()


def test_a_little_outside_is_a_note(run: Run) -> None:
    low, high = run.position[:, 0].min(), run.position[:, 0].max()
    (note,) = prepared(limited(Limits(position=(low + 0.1 * (high - low), high))), run).notes
    assert str(note).startswith(f"joint '{run.joints[0]}' goes from {low:.4g} to {high:.4g} rad, outside its limits")


def test_another_unit_is_refused(run: Run) -> None:
    with pytest.raises(GtauError, match=r"far outside its limits 0 to 0.01 rad; if the log is in deg, write"):
        prepared(limited(Limits(position=(0.0, 0.01))), run)


def test_angles_of_another_turn_are_within_limits(run: Run) -> None:
    """Encoders that count from 0 to 360 deg, and limits that count from -180."""
    low, high = run.position[:, 0].min(), run.position[:, 0].max()
    for turn in (-2 * np.pi, 2 * np.pi):
        assert prepared(limited(Limits(position=(low - 0.1 + turn, high + 0.1 + turn))), run).notes == ()


def test_a_placeholder_for_the_limit_of_speed_is_a_note_and_another_clock_refused(run: Run) -> None:
    slow = limited(Limits(velocity=0.01))
    (note,) = prepared(slow, run).notes
    assert "times its limit of 0.01 rad/s" in note.what
    assert note.advice.startswith(
        "check columns and units; if the limit is a placeholder, state the real one under 'robot'"
    )
    assert note.advice.endswith("({file: ..., limits: {left: ...}})")
    with pytest.raises(GtauError, match=r"which no robot has; correct the unit of the time"):
        prepared(slow, replace(run, time=run.time / 1000))


def test_limits_are_corrected_in_the_experiment_file() -> None:
    given = {"left": {"velocity": 3.1, "effort": 150, "position": ["deg(30)", 3]}}
    limits = load_robot("five-bar", limits=given).joint("left").limits
    assert (limits.velocity, limits.effort) == (3.1, 150.0)
    assert limits.position == pytest.approx((np.deg2rad(30), 3.0))
    assert limits.acceleration == load_robot("five-bar").joint("left").limits.acceleration
    for wrong, sentence in (
        ({"middle": {"effort": 1}}, "no joint 'middle'"),
        ({"left": {"effort": 0}}, "limits.left.effort: 0 is out of range"),
        ({"left": {"speed": 1}}, "unknown key 'speed'"),
        ({"left": {"position": [1, 0]}}, "not in order"),
    ):
        with pytest.raises(GtauError, match=sentence):
            load_robot("five-bar", limits=wrong)


def test_other_limits_are_no_other_robot(tmp_path: Path) -> None:
    file = write_experiment(tmp_path, Plant(noise=0.01))
    limits = "robot: {file: five-bar, limits: {left: {effort: 0.1}}}"
    file.write_text(file.read_text().replace("robot: five-bar", limits))
    low = identify(file)
    assert [note.joint for note in low.notes if note.kind == "doubtful effort limit"] == ["left"]
    assert low.drive_gains["left"].verdict.outcome == Grade.GOOD
    file.write_text(file.read_text().replace("effort: 0.1", "effort: 0.2"))
    assert experiment_of(low, file).robot.limits["left"].effort == 0.2


def test_motors_may_turn_many_times_where_their_unit_is_stated(tmp_path: Path) -> None:
    """3,000 rad at 300 rad/s, as before a gear."""
    robot = load_robot("test-bench")
    robot = replace(robot, joints=tuple(replace(joint, limits=Limits()) for joint in robot.joints))
    (name,) = robot.actuated
    time = np.arange(8000) / 200
    table = np.column_stack([time, 1500 * np.sin(0.3 * time), np.cos(0.3 * time) + np.sign(np.cos(0.3 * time))])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header="t,q,i", comments="")
    signals = {"time": "t", "position": {name: "q"}, "current": {name: "i"}}
    with pytest.raises(GtauError, match=r"write deg under units.position, or rad if it does turn so often"):
        prepared(robot, read_run(tmp_path / "log.csv", signals))
    assert prepared(robot, read_run(tmp_path / "log.csv", signals, units={"position": "rad"})).run.joints == (name,)
