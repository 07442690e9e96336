"""Gravity along another axis than the robot file says is named; where gravity is not seen, nothing is said."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from floating_logs import AT_HOOK, FIXED, POSE, experiment, simulated
from gravity_logs import Gravity, logged, scara

from gtau.estimation.diagnostics.gravity import (
    OTHER_GRAVITY,
    _or_as_likely,
    gravity_advice,
    likeliest_gravity,
)
from gtau.estimation.effects.effect import EstimatedEffect
from gtau.estimation.estimators.least_squares import fit_by
from gtau.estimation.estimators.maximum_likelihood import ml_or_wls
from gtau.estimation.experiment_runs import read_runs
from gtau.estimation.regression.dataset import reduce_runs
from gtau.findings import Grade
from gtau.model.home import load_robot
from gtau.result import identify
from gtau.robots.geometry import float_base
from gtau.robots.readers.native import write_native
from gtau.robots.robot import STANDARD_GRAVITY as G, Robot
from gtau.signals.reading.experiment import read_experiment
from gtau.signals.run import Run


def found(robot: Robot, runs: list[Run], missing: bool = False) -> EstimatedEffect | None:
    dataset = reduce_runs(robot, runs)
    gains = np.ones(len(robot.actuated)) if runs[0].kind == "torque" else None
    system = dataset.system(per_run=len(runs) > 1)
    return likeliest_gravity(fit_by(ml_or_wls(gains), system, gains is None), missing, turned=not missing)


def axis(gravity: Gravity) -> np.ndarray:
    return np.array(gravity) / G


def test_an_arm_on_a_wall_is_named() -> None:
    """From torques, where nothing else would say a word, as gains are given."""
    robot, true = load_robot("ur10e"), (G, 0.0, 0.0)
    result = identify(robot, logged(robot, true, currents=False))
    wrong = [each.verdict for each in result.drive_gains.values() if each.verdict.outcome == Grade.CONTRADICTORY]
    assert wrong
    assert (wrong[0].kind, wrong[0].causes) == ("description refuted", (OTHER_GRAVITY,))
    cause = result.effects[0].cause
    np.testing.assert_allclose(cause.values["gravity"], true, atol=1e-9)
    before, after = np.array(list(cause.values["left"].values())).T
    assert (after < 0.003).all()
    assert before.max() > 0.1
    assert set(cause.joints) == set(cause.values["left"])
    assert len(result.effects) == 1  # the tilts that would explain a part of it are not counted again
    good = identify(replace(robot, gravity=true), logged(robot, true, currents=False))
    assert {each.verdict.outcome for each in good.drive_gains.values()} == {Grade.GIVEN}


@pytest.mark.slow
def test_another_gravity_that_turns_all_gains_is_named_before_their_signs(shared: Path) -> None:
    """A planar arm that is declared on its side."""
    folder = shared / "idle_and_bursts" / "arm_idle"
    experiment = read_experiment(folder / "experiment.yaml")
    robot = replace(load_robot(folder / "arm.yaml"), gravity=(G, 0.0, 0.0))
    result = identify(robot, read_runs(experiment, experiment.runs))
    for gain in result.drive_gains.values():
        assert (gain.value or 0.0) < 0
        assert gain.verdict.causes == (OTHER_GRAVITY,)
        np.testing.assert_allclose(result.effects[0].cause.values["gravity"], (0.0, 0.0, -G), atol=1e-9)


def test_what_to_write_is_what_helps(tmp_path: Path) -> None:
    """Both ways of the advice give the gravity that was found."""
    robot, true = load_robot("ur10e"), np.array([0.3, -0.5, 0.8]) * G / np.linalg.norm([0.3, -0.5, 0.8])
    said = gravity_advice(true.tolist(), floating=False)
    x, y, z = (float(each) for each in said.split("gravity: [")[1].split("]")[0].split(","))
    np.testing.assert_allclose([x, y, z], true, atol=0.01)
    write_native(robot, tmp_path / "arm.yaml")
    rpy = said.split("rpy: [")[1].split("]")[0]
    turned = load_robot(tmp_path / "arm.yaml", base={"rpy": [float(each) for each in rpy.split(",")]})
    np.testing.assert_allclose(turned.gravity, true, atol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "true", "currents", "also"),
    [
        (load_robot("ur10e"), (0.0, 0.0, G), False, 0),
        (scara(), (0.0, G, 0.0), False, 0),
        (load_robot("five-bar"), (G, 0.0, 0.0), True, 0),
        (load_robot("five-bar"), (0.0, G, 0.0), True, 1),  # lies flat: either normal is the same
    ],
    ids=["arm on a ceiling", "scara on a wall", "five-bar on its side", "five-bar lying flat"],
)
def test_other_robots(robot: Robot, true: Gravity, currents: bool, also: int) -> None:
    other = found(robot, logged(robot, true, currents))
    assert other is not None
    assert len(other.cause.values["also"]) == also
    gravities = [other.cause.values["gravity"], *other.cause.values["also"]]
    assert max(axis(each) @ axis(true) for each in gravities) > 0.999


@pytest.mark.slow
def test_gravity_is_not_missing_where_the_logs_contradict_it() -> None:
    """Whatever the ranking of efforts says: it asks each joint alone, some of whose columns may stand for its gravity.

    Of an Orthoglide in MuJoCo, played well, all intervals once were +-180 % and more for this.
    """
    robot = load_robot("orthoglide")
    assert found(robot, logged(robot, robot.gravity, currents=True), missing=True) is None
    without = found(robot, logged(robot, (0.0, 0.0, 0.0), currents=True), missing=True)
    assert without is not None
    assert without.cause.values["remains"] < 0.1


@pytest.mark.parametrize("degrees", [*(pytest.param(angle, marks=pytest.mark.slow) for angle in (10.0, 17.0)), 30.0])
def test_a_zero_of_the_first_joint_is_told_beside_the_tilt_that_it_equals(degrees: float) -> None:
    """Within the range of linear columns and beyond it, no gain is good."""
    robot = replace(scara(), gravity=(0.0, -G, 0.0))  # its first two axes are level
    offset = np.radians(degrees) * np.array([1.0, 0.0, 0.0])
    runs = [replace(run, position=run.position + offset) for run in logged(robot, robot.gravity, currents=True)]
    result = identify(robot, runs)
    assert not result.accepted
    zeros = re.findall(r"(-?[\d.]+) deg", str(result.drive_gains["2"].verdict))
    assert "in the zero of encoder '1'" in str(result.drive_gains["2"].verdict)
    assert min(abs(float(zero) + degrees) for zero in zeros) < 0.05 * degrees


def test_no_zero_of_a_five_bar_equals_a_tilt() -> None:
    """Two of its joints stand on the ground."""
    robot = load_robot("five-bar")
    assert _or_as_likely(robot, np.array([G, 0.0, 0.0])) == ""
    assert "the axes of all joints reversed" in _or_as_likely(robot, -np.array(robot.gravity))
    level = replace(scara(), gravity=(0.0, -G, 0.0))
    assert "an error of 90 deg" in _or_as_likely(level, np.array([-G, 0.0, 0.0]))
    assert "an error of 180 deg" in _or_as_likely(level, np.array([0.0, G, 0.0]))
    assert _or_as_likely(level, np.array([0.0, 0.0, -G])) == ""
    assert "the axes of all joints reversed" in _or_as_likely(scara(), -np.array(scara().gravity))


def test_a_direction_between_the_axes() -> None:
    robot, true = scara(), (0.4 * G, -0.6 * G, -np.sqrt(1 - 0.52) * G)
    other = found(robot, logged(robot, true, currents=True))
    assert other is not None
    assert axis(other.cause.values["gravity"]) @ axis(true) > np.cos(np.radians(2))


@pytest.mark.parametrize(
    ("robot", "currents"),
    [
        (scara(), False),
        (load_robot("five-bar"), True),
        (replace(load_robot("five-bar"), name="flat", gravity=(0.0, G, 0.0)), True),
        (load_robot("ur10e"), False),
        pytest.param(load_robot("ur10e"), True, marks=pytest.mark.slow),
        pytest.param(load_robot("orthoglide"), True, marks=pytest.mark.slow),
    ],
    ids=lambda value: {True: "currents", False: "torques"}[value] if isinstance(value, bool) else value.name,
)
def test_healthy_robots_keep_their_gravity(robot: Robot, currents: bool) -> None:
    """Also where gravity is not seen, or is no more than an offset of a joint."""
    assert found(robot, logged(robot, robot.gravity, currents, seconds=5.0)) is None


@pytest.mark.slow
def test_a_tracker_whose_vertical_is_another(tmp_path: Path) -> None:
    """Of a base that floats gravity is in the axes of the logged poses."""
    path = experiment(tmp_path, f"{{body: trunk, {POSE}, wrenches: [{AT_HOOK}]}}", simulated(3))
    write_native(replace(float_base(FIXED, "trunk"), gravity=(0.0, -G, 0.0)), tmp_path / "arm.yaml")
    result = identify(path)
    (cause,) = (effect.cause for effect in result.effects if effect.cause.kind == OTHER_GRAVITY)
    np.testing.assert_allclose(axis(cause.values["gravity"]), (0.0, 0.0, -1.0), atol=0.02)
    assert "of the world" in cause.what
