"""Torques that an arm reports by a factor too large or too small: found, said, written down and used."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from five_bar_logs import CHI, STEEL, Plant, five_bar, path
from gravity_logs import logged, scara

from gtau.errors import GtauError
from gtau.estimation.effects.known.torque_scale import EFFECT as TORQUE_SCALE
from gtau.estimation.results.conclusions import headline, torque_scale_text, torque_scales
from gtau.findings import Grade
from gtau.model.home import load_robot
from gtau.result import Result, identify, load
from gtau.robots.robot import STANDARD_GRAVITY
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run, read_run
from gtau.uses.identified import identified
from gtau.uses.weigh import weigh

ROBOT = five_bar().robot
KNOWN = Payload(name="steel", mass=STEEL["m"])
UNTESTED = (
    "The logged torques are assumed to be correct: their scale was not tested. To test it, log one run with a payload "
    "of known mass and one without."
)


def torques(scale: Sequence[float], known: Payload | None = KNOWN, mass: float = 1.0) -> list[Run]:
    """Runs without and with steel whose reported torques are the true ones over ``scale``."""
    plant = Plant(gains=scale, noise=0.02)
    load = {kind: mass * value for kind, value in STEEL.items()}
    return [
        plant.run("free", seed=1, kind="torque"),
        replace(plant.run("loaded", payload=load, seed=2, kind="torque"), payload=known),
    ]


@pytest.fixture(scope="module")
def wrong() -> Result:
    """The left motor reports 0.78 of its torque."""
    return identify(ROBOT, torques((1 / 0.78, 1.0)))


def test_a_wrong_scale_is_found_and_said_first(wrong: Result) -> None:
    left, right = wrong.drive_gains.values()
    assert (wrong.method, wrong.kind, left.unit) == ("ml", "torque", "1")
    for gain, true in ((left, 1 / 0.78), (right, 1.0)):
        low, high = gain.interval()
        assert low < true < high
    found = torque_scales(wrong)
    assert found == {"left": "wrong", "right": "consistent with 1"}
    low, high = sorted(1 / end for end in left.interval())
    assert low < 0.78 < high
    assert headline(wrong).startswith(f"The arm reports 0.78 ({low:.2f} to {high:.2f}) of the torque at 'left'")
    assert "The torque scale of 'right' is consistent with 1" in headline(wrong)
    assert wrong.accepted


def test_a_scale_whose_interval_excludes_1_is_not_consistent_with_1(wrong: Result) -> None:
    left, right = wrong.drive_gains.values()
    near = replace(right, value=1 + 1.2 * (right.half_interval() or 0.0))
    states = torque_scales(wrong.replaced(drive_gains={"left": left, "right": near}))
    assert states["right"] == "undecided"


def test_the_correction_is_written_with_intervals(wrong: Result) -> None:
    left = yaml.safe_load(torque_scale_text(wrong))["torque_scale"]["left"]
    assert left["state"] == "wrong"
    assert left["factor"] == pytest.approx(wrong.drive_gains["left"].value, rel=1e-3)
    assert left["interval"][0] < 1 / 0.78 < left["interval"][1]


def test_true_torques_are_said_to_be_consistent_with_1() -> None:
    found = identify(ROBOT, torques((1.0, 1.0)))
    assert [*torque_scales(found).values()] == ["consistent with 1"] * 2
    assert headline(found).startswith("The torque scales of all joints are consistent with 1, known to within")


def test_without_a_scale_torques_are_taken_as_true_and_said_to_be_untested() -> None:
    for runs in (torques((1.2, 1.0))[:1], torques((1.2, 1.0), Payload(name="steel"))):
        found = identify(ROBOT, runs)
        assert (found.method, headline(found), torque_scales(found)) == ("wls", UNTESTED, {})
        assert {(gain.value, gain.std) for gain in found.drive_gains.values()} == {(1.0, None)}


def test_known_parameters_alone_test_it_only_where_asked() -> None:
    runs, priors = torques((1.25, 1.0))[:1], {"ia_left": {"value": CHI["ia_left"], "std": 0.001}}
    assert identify(ROBOT, runs, priors=priors).method == "wls"
    with pytest.raises(GtauError, match="'ml' needs a scale"):
        identify(ROBOT, runs, method="ml")


@pytest.mark.parametrize("way", [{"method": "wls"}, pytest.param({"as_paper": True}, marks=pytest.mark.slow)])
def test_least_squares_and_the_way_of_the_paper_take_torques_as_they_are(way: dict[str, Any]) -> None:
    found = identify(ROBOT, torques((1 / 0.78, 1.0)), **way)
    assert (found.method, {gain.value for gain in found.drive_gains.values()}) == ("wls", {1.0})
    assert found.payloads[0].verdict.outcome == Grade.CONTRADICTORY  # weighed by torques that are wrong


def test_a_payload_that_shows_nowhere_leaves_the_torques_as_they_are() -> None:
    """A declared load that was never carried: gain 1 as without it, with the reason."""
    runs = torques((1.0, 1.0), mass=0.0)
    found = identify(ROBOT, runs)
    assert found.method == "wls"
    assert "torque scale not tested" in [each.kind for each in found.notes]


def test_a_mass_that_is_wrong_is_asked_about_before_all_torques_are(wrong: Result) -> None:
    found = identify(ROBOT, torques((1.0, 1.0), mass=0.8))
    (said,) = (each for each in found.notes if each.kind == "common torque scale")
    assert f"a mass of {0.8 * STEEL['m']:.2g}" in said.what
    assert not [each for each in wrong.notes if each.kind == "common torque scale"]


def test_prior_gains_scale_torques_of_which_nothing_tests_the_scale() -> None:
    found = identify(ROBOT, torques((1.25, 1.0))[:1], prior_gains={"left": 1.25, "right": 1.0})
    assert headline(found) == "The torque scales were given, not identified."
    truth = {name: CHI[name] for name in ("fs_left", "fv_left")}
    for name, value in truth.items():
        assert found.parameters[name].value == pytest.approx(value, abs=0.05)


def test_a_model_with_scales_weighs_predicts_and_exports_true_torques(wrong: Result, tmp_path: Path) -> None:
    """The torques of the model are true ones, and its 'currents' what the arm reports, through a file too."""
    wrong.save(tmp_path / "model.json")
    model = load(tmp_path / "model.json")
    assert headline(model) == headline(wrong)
    time = np.arange(0.0, 4.0, 0.002)
    motion = path(time, 7)
    true = five_bar().torques(*motion, CHI)
    moving = (np.abs(motion[1]) > 0.3).all(axis=1)
    for j in range(2):
        error = (model.torques(*motion) - true)[moving, j]
        assert np.sqrt(np.mean(error**2)) < 0.02 * np.sqrt(np.mean(true[moving, j] ** 2))
    assert model.currents(*motion)[:, 0] == pytest.approx(model.torques(*motion)[:, 0] / model.gains[0])
    assert identified(model).gains == pytest.approx(model.gains)
    run = torques((1 / 0.78, 1.0))[1]
    prediction = model.predict(run)
    true = run.command[:, 0] * 1.282
    assert np.linalg.norm(prediction.measured[:, 0] - true) < 0.05 * np.linalg.norm(true)
    assert max(each.relative for each in model.validate(run)) < 3.0
    (weighed,) = weigh(model, ROBOT, torques((1 / 0.78, 1.0), Payload(name="unknown")))
    mass = weighed.parameters["m"]
    assert abs(mass.value - STEEL["m"]) < 2 * mass.half_interval()
    assert mass.half_interval() < 0.1


@pytest.mark.slow
def test_the_airbot_reports_too_little_at_joints_2_and_3(shared: Path) -> None:
    folder, joints = shared / "airbot_play", [f"joint{k}" for k in range(1, 7)]
    signals = {
        "time": "t",
        "position": {joint: f"q{k}" for k, joint in enumerate(joints, start=1)},
        "torque": {joint: f"tau{k}" for k, joint in enumerate(joints, start=1)},
    }
    free, loaded = (read_run(folder / f"chirp_{name}.csv", signals) for name in ("unloaded", "loaded_480g"))
    robot = load_robot(str(folder / "airbot_play_v3_0_gripper.urdf"))
    found = identify(robot, [free, replace(loaded, payload=Payload(name="load", mass=0.48))])
    page = (Path(__file__).parents[2] / "docs" / "do" / "torque-scale.md").read_text(encoding="utf-8")
    written = yaml.safe_load(torque_scale_text(found))["torque_scale"]
    for joint, shown in yaml.safe_load(page.split("```yaml\n")[1].split("```")[0])["torque_scale"].items():
        assert shown["state"] == written[joint]["state"]
        assert (shown["factor"] or 0.0) == pytest.approx(written[joint]["factor"] or 0.0, rel=0.02)
    above = {joint for joint, scale in written.items() if scale["interval"] and scale["interval"][0] > 1}
    assert above == {"joint2", "joint3"}
    for joint in above:  # what the two logs differ by is 1.2 to 1.4 times less than the weight of the load
        assert written[joint]["interval"][0] < 1.4


@pytest.mark.parametrize("joint", ["1", "2"])
def test_one_joint_in_another_scale_is_named_without_any_payload(joint: str) -> None:
    """Two joints of a SCARA feel the same links: each is in another scale than the other."""
    robot, gravity = scara(), (0.0, 0.0, -STANDARD_GRAVITY)
    runs = logged(robot, gravity, currents=False)
    assert identify(robot, runs).accepted
    at = robot.actuated.index(joint)
    factors = np.where(np.arange(len(robot.actuated)) == at, 0.7, 1.0)
    result = identify(robot, [replace(run, command=np.asarray(run.command) * factors) for run in runs])
    named = {name: gain.verdict.finding for name, gain in result.drive_gains.items() if gain.verdict.finding}
    (finding,) = named.values()
    assert set(named) < {"1", "2"}
    assert finding.causes == (TORQUE_SCALE.name,)
