"""Columns with another sign, zero, order or link of reference, and faults of a single run, are named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import stated_arm
from five_bar_logs import JOINTS, Plant, pair
from gravity_logs import logged

from gtau.estimation.diagnostics.columns import _with_parallelogram
from gtau.findings import Grade, listed
from gtau.model.home import load_robot
from gtau.result import Result, identify
from gtau.robots.robot import Robot
from gtau.signals.run import Run, read_run

UR10E = load_robot("ur10e")


def causes(result: Result) -> dict[str, tuple[str, ...]]:
    """Causes of the verdicts, with the joints that they are of."""
    kinds = {kind for gain in result.drive_gains.values() for kind in gain.verdict.causes}
    return {effect.subject: effect.cause.joints for effect in result.effects if effect.cause.kind in kinds}


def parallelogram(robot: Robot) -> tuple[str, Robot]:
    joint, _, other = next(iter(_with_parallelogram(robot)))
    return joint, other


REVERSED = [("j2",), ("wrist_1_joint",), ("shoulder_lift_joint", "wrist_1_joint")]


@pytest.mark.parametrize(
    "turned", [pytest.param(joints, marks=[pytest.mark.slow] * (k > 0)) for k, joints in enumerate(REVERSED)]
)
def test_reversed_torques_are_named(tmp_path: Path, turned: tuple[str, ...]) -> None:
    robot = UR10E if turned[0] in UR10E.actuated else stated_arm.robot(tmp_path, inertias=False)
    signs = np.where(np.isin(robot.actuated, turned), -1.0, 1.0)
    runs = [replace(run, command=np.asarray(run.command) * signs) for run in logged(robot, robot.gravity, False)]
    result = identify(robot, runs)
    ((what, joints),) = causes(result).items()
    assert (what, joints) == (f"reversed torques of {listed(turned)}", turned)
    assert not result.accepted


@pytest.mark.parametrize("factor", [10.0, 0.001])
def test_torques_of_one_joint_in_another_unit_are_named(tmp_path: Path, factor: float) -> None:
    robot = stated_arm.robot(tmp_path, inertias=False)
    factors = np.where(np.array(robot.actuated) == "j2", factor, 1.0)
    runs = [replace(run, command=np.asarray(run.command) * factors) for run in logged(robot, robot.gravity, False)]
    result = identify(robot, runs)
    expected = f"torques of 'j2' that are {factor:g} times as large as the other torques say"
    assert causes(result) == {expected: ("j2",)}
    assert not result.accepted


WHOLE = (
    "torques of run 'first' that are 1.4 times or of run 'second' that are 0.7 times as large as the other torques say"
)
ARM = ("j1", "j2", "j3", "j4")


@pytest.mark.parametrize(
    ("factors", "what", "joints"),
    [(0.7, WHOLE, ARM), ([1, 1, -1, 1], "reversed torques of 'j3' in run 'second'", ("j3",)), (1.0, "", ())],
)
def test_torques_of_one_run_that_are_otherwise_are_named(
    factors: Any, what: str, joints: tuple[str, ...], tmp_path: Path
) -> None:
    arm = stated_arm.robot(tmp_path, inertias=False)
    (run,) = logged(arm, arm.gravity, False, seconds=16.0)
    half = len(run.time) // 2
    first, second = (
        Run(name, run.joints, run.time[part], run.position[part], run.command[part], kind="torque")
        for name, part in (("first", slice(half)), ("second", slice(half, None)))
    )
    result = identify(arm, [first, replace(second, command=second.command * factors)])
    assert causes(result) == ({what: joints} if what else {})
    assert result.accepted == (not what)


def test_torques_as_they_are_reverse_nothing() -> None:
    assert identify(UR10E, logged(UR10E, UR10E.gravity, False)).accepted


FAULTS = {
    "are about -1 times": lambda v: v * [-1.0, 1.0],
    "are about 1000 times": lambda v: v * [1.0, 1000.0],
    "the other runs do not predict": lambda v: v[:, ::-1],
}


@pytest.mark.parametrize(
    "words", [pytest.param(word, marks=pytest.mark.slow) if "1000" in word else word for word in (*FAULTS, "")]
)
def test_a_fault_of_one_run_is_told_with_the_run(words: str) -> None:
    plant = Plant(noise=0.01)
    runs = [*pair(plant), plant.run("again", 8.0, seed=3), plant.run("odd", 8.0, seed=4)]
    if words:
        runs[-1] = replace(runs[-1], command=FAULTS[words](runs[-1].command))
    result = identify(load_robot("five-bar"), runs)
    first = result.drive_gains[JOINTS[0]].verdict
    assert result.accepted == (not words)
    assert (first.kind == "odd run" and words in str(first) and "in run 'odd' alone" in str(first)) == bool(words)


def test_an_angle_of_a_parallelogram_is_named() -> None:
    joint, other = parallelogram(UR10E)
    result = identify(UR10E, logged(other, other.gravity, False))
    ((what, joints),) = causes(result).items()
    assert "as with a parallelogram" in what
    assert joints == (joint,)


READINGS = {
    "the other sign of the position of 'j3'": lambda q: q * [1.0, 1.0, -1.0, 1.0],
    "the other sign of position and current of 'j3'": lambda q: q * [1.0, 1.0, -1.0, 1.0],
    "an error of -90 deg in the zero of encoder 'j3'": lambda q: q + np.pi / 2 * np.eye(4)[2],
    "exchanged positions and currents of 'j3' and 'j4'": lambda q: q[:, [0, 1, 3, 2]],
}


@pytest.mark.parametrize(
    "what", [pytest.param(what, marks=[pytest.mark.slow] * (k > 0)) for k, what in enumerate(READINGS)]
)
def test_other_signs_zeros_and_orders_of_columns_are_named(tmp_path: Path, what: str) -> None:
    def read(run: Run) -> Run:
        command = READINGS[what](run.command) if "current" in what else run.command
        return replace(run, position=READINGS[what](run.position), command=command)

    arm = stated_arm.robot(tmp_path, inertias=False)
    runs = [read(run) for run in logged(arm, arm.gravity, True)]
    result = identify(arm, runs)
    assert what in causes(result)
    assert not result.accepted


def test_joints_that_another_description_explains_are_judged_by_it() -> None:
    """The other sign of one position, beside torques: the model leaves other joints unexplained as well."""
    signs = np.where(np.array(UR10E.actuated) == "elbow_joint", -1.0, 1.0)
    runs = [replace(run, position=run.position * signs) for run in logged(UR10E, UR10E.gravity, False)]
    gains = identify(UR10E, runs).drive_gains
    wrong = [gain.verdict for gain in gains.values() if gain.verdict.outcome == Grade.CONTRADICTORY]
    assert len(wrong) > 1
    assert all(verdict.text.startswith("the other sign of the position of 'elbow_joint'") for verdict in wrong)


@pytest.mark.slow
def test_a_zero_that_explains_more_than_another_unit_is_named(shared: Path) -> None:
    """Of a Med 7, whose last joints are noisy: torques of A5 8 times as large leave more of the residuals."""
    folder, joints = shared / "kuka_med7", [f"A{k}" for k in range(1, 8)]
    kinds = {"position": "q", "torque": "tau"}
    signals = {kind: {joint: f"{name}_{k}" for k, joint in enumerate(joints)} for kind, name in kinds.items()}
    run = read_run(folder / "measurements.csv", {"time": {"rate": 100}, **signals})
    turned = replace(run, position=run.position + np.where(np.array(joints) == "A4", np.pi / 2, 0.0))
    result = identify(load_robot(str(folder / "med7dock.urdf")), [turned])
    assert causes(result)["an error of -90 deg in the zero of encoder 'A4'"] == ("A4",)
