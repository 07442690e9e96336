"""Wrong units and signs, which fit the data as well as right ones: said first, and not accepted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import stated_arm
from five_bar_logs import GAINS, STEEL, Plant, five_bar
from gravity_logs import logged, scara

from gtau.estimation.diagnostics.effort import SWAPPED_CHANNELS
from gtau.estimation.diagnostics.inertia_audit import AuditedParameter, InertiaAudit
from gtau.estimation.diagnostics.units import _unlike_file
from gtau.estimation.regression.rows import stop
from gtau.estimation.results.conclusions import headline, torque_scales
from gtau.findings import Grade
from gtau.result import Result, identify
from gtau.robots.parameter import Parameter
from gtau.robots.robot import Limits
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run

DOWN = (0.0, 0.0, -9.81)
FIVE_BAR, SCARA = five_bar().robot, scara()


@pytest.fixture(scope="module")
def parallel() -> list[Run]:
    plant = Plant(noise=0.02)
    loaded = plant.run("loaded", 8.0, STEEL, seed=2)
    return [plant.run("free", 8.0, seed=1), replace(loaded, payload=Payload(name="steel", mass=STEEL["m"]))]


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_an_absurd_mass_is_no_warning_of_numpy(parallel: list[Run]) -> None:
    heavy = replace(parallel[1], payload=Payload(name="steel", mass=1e9))
    assert set(kinds(identify(FIVE_BAR, [parallel[0], heavy]))) == {*FIVE_BAR.actuated}


@pytest.fixture(scope="module")
def serial() -> list[Run]:
    return logged(SCARA, DOWN, currents=True)


def scaled(runs: list[Run], factors: list[float]) -> list[Run]:
    return [replace(run, command=run.command * factors) for run in runs]


def in_grams(runs: list[Run]) -> list[Run]:
    return [
        replace(run, payload=Payload(name=run.payload.name, mass=1000 * run.payload.mass))
        if run.payload and run.payload.mass
        else run
        for run in runs
    ]


def kinds(result: Result) -> dict[str, str | None]:
    """Kind of the finding on each joint that contradicts."""
    of_gains = {joint: gain.verdict for joint, gain in result.drive_gains.items()}
    return {
        joint: verdict.finding.kind
        for joint, verdict in of_gains.items()
        if verdict.finding and verdict.outcome == Grade.CONTRADICTORY
    }


def first_line(result: Result) -> str:
    assert not result.accepted
    return headline(result).split(". ")[0]


def test_right_units_are_accepted(parallel: list[Run], serial: list[Run]) -> None:
    for robot, runs in ((FIVE_BAR, parallel), (SCARA, serial)):
        result = identify(robot, runs)
        assert result.accepted
        assert kinds(result) == {}


@pytest.mark.parametrize(
    ("spoil", "kind", "cause"),
    [
        (in_grams, "payload too heavy", "payload 'disc' weighs 2000 kg"),
        (lambda runs: scaled(runs, [1e3] * 3), "current too large", "A rms, more than drives of robots take"),
        (lambda runs: scaled(runs, [1e-3] * 3), "current too small", "more than drives of robots supply"),
    ],
)
def test_a_unit_of_all_joints_is_the_first_that_is_said(
    spoil: Callable[[list[Run]], list[Run]], kind: str, cause: str, serial: list[Run]
) -> None:
    result = identify(SCARA, spoil(serial))
    assert kinds(result) == dict.fromkeys("123", kind)
    assert first_line(result).startswith("All joints contradict the description")
    assert cause in first_line(result)
    priors = {joint: gain.value for joint, gain in result.drive_gains.items()}
    assert identify(SCARA, spoil(serial), prior_gains=priors).accepted  # large drives do exist: priors settle it


def test_a_payload_in_grams_exceeds_the_limits_of_a_robot_that_has_no_reach(parallel: list[Run]) -> None:
    result = identify(FIVE_BAR, in_grams(parallel))
    assert set(kinds(result).values()) == {"effort limit"}
    assert "times its limit of 30 N m, so the payload's mass" in first_line(result)


def test_limits_that_are_the_same_for_all_joints_of_an_arm_are_rather_placeholders(
    serial: list[Run], tmp_path: Path
) -> None:
    limits = {"1": 0.5, "2": 0.5, "3": 0.5}
    for efforts, accepted in ((limits, True), (limits | {"3": 0.4}, False)):
        joints = [replace(each, limits=replace(each.limits, effort=efforts[each.name])) for each in SCARA.joints]
        result = identify(replace(SCARA, joints=tuple(joints)), serial)
        assert result.accepted == accepted
        assert ("doubtful effort limit" in {each.kind for each in result.notes}) == accepted


def test_the_current_of_one_joint_in_another_unit_contradicts_alone(tmp_path: Path) -> None:
    arm = stated_arm.robot(tmp_path)
    result = identify(arm, scaled(logged(arm, DOWN, currents=True), [1.0, 1.0, 1e3, 1.0]))
    assert kinds(result) == {"j3": "gains far apart"}
    assert first_line(result).startswith("Joint 'j3' contradicts the description")
    # the gains of the others do not move
    assert {result.drive_gains[joint].verdict.outcome for joint in ("j1", "j2", "j4")} == {Grade.GOOD}


def test_two_joints_in_different_units_are_one_finding(parallel: list[Run]) -> None:
    assert first_line(identify(FIVE_BAR, scaled(parallel, [1.0, 1e2]))).count("differ by a factor of") == 1


def test_a_reversed_current_contradicts_unless_its_prior_gain_is_negative(parallel: list[Run]) -> None:
    turned = scaled(parallel, [1.0, -1.0])
    result = identify(FIVE_BAR, turned)
    assert kinds(result) == {"right": "negative gain"}
    assert "negative gain: positive current drives 'right' backwards" in first_line(result)
    assert "('-COLUMN')" in result.drive_gains["right"].verdict.advice
    assert result.drive_gains["left"].verdict.outcome == Grade.GOOD
    intended = {"left": GAINS[0], "right": -GAINS[1]}
    assert identify(FIVE_BAR, turned, prior_gains=intended).accepted


def test_a_reversed_torque_column_contradicts_and_no_scale_is_asserted() -> None:
    plant = Plant(gains=(1 / 0.78, -1.0), noise=0.02)
    runs = [
        plant.run("free", seed=1, kind="torque"),
        replace(plant.run("loaded", payload=STEEL, seed=2, kind="torque"), payload=Payload(name="steel", mass=1.2)),
    ]
    result = identify(FIVE_BAR, runs)
    assert kinds(result) == {"right": "negative gain"}
    assert [*torque_scales(result).values()] == ["in doubt", "contradictory"]
    assert "The arm reports" not in headline(result)
    assert "The torque scale of 'left' is in doubt." in headline(result)


@pytest.mark.parametrize("factor", [1e3, 1e-3, 3.3, 0.33])
def test_torques_in_another_unit_give_inertias_out_of_scale_with_the_file(factor: float, tmp_path: Path) -> None:
    arm = stated_arm.robot(tmp_path)
    run = stated_arm.torque_run(stated_arm.plant(arm), 1)
    result = identify(arm, scaled([run], [factor] * 4))
    assert kinds(result) == dict.fromkeys(arm.actuated, "inertias out of scale")
    assert "times the first moments in the robot's file" in first_line(result)
    finding = result.drive_gains["j1"].verdict.finding
    assert finding is not None
    assert float(finding.what.partition("are ")[2].split()[0]) == pytest.approx(factor, rel=0.05)


def test_torques_that_are_all_reversed_contradict_the_inertias_of_the_file(tmp_path: Path) -> None:
    """They fit as well with negative masses: the file alone knows their sign."""
    arm = stated_arm.robot(tmp_path)
    run = stated_arm.torque_run(stated_arm.plant(arm), 1)
    assert kinds(identify(arm, scaled([run], [-1.0] * 4))) == dict.fromkeys(arm.actuated, "reversed channels")


def test_effects_that_explain_part_of_reversed_torques_leave_them_contradicted(tmp_path: Path) -> None:
    """Friction that resists a reversal over 30 % of the travel: effects move all moments by a third."""
    arm = stated_arm.robot(tmp_path)
    run = stated_arm.torque_run(stated_arm.plant(arm), 1)
    states = [stop(q, np.array([0.3 * np.ptp(q)]), np.zeros(1))[0] for q in run.position.T]
    friction = 0.3 * np.std(run.command, axis=0) * np.stack(states, axis=1)
    reversed_run = replace(run, command=-(run.command + friction))
    assert kinds(identify(arm, [reversed_run])) == dict.fromkeys(arm.actuated, "reversed channels")


@pytest.mark.parametrize(("other", "out_of_scale"), [("r4", False), ("s2", True)])
def test_one_link_that_carries_what_the_file_does_not_know_is_no_scale(other: str, out_of_scale: bool) -> None:
    moments = [
        AuditedParameter(Parameter(kind, link), link, "kg m", "contradicted", 0.001, 0.05, 0.001)
        for kind, link in (("mx", "r4"), ("my", other))
    ]
    assert bool(list(_unlike_file(InertiaAudit({}, {}, tuple(moments), ())))) == out_of_scale


@pytest.mark.parametrize("factor", [1e3, 1e-3, 1.0])
def test_torques_in_another_unit_give_an_arm_of_no_weight_that_arms_have(factor: float, tmp_path: Path) -> None:
    """Where the robot's file states neither inertias nor limits."""
    arm = stated_arm.robot(tmp_path)
    run = stated_arm.torque_run(stated_arm.plant(arm), 1)
    bare = replace(
        arm, file=replace(arm.file, inertias=()), joints=tuple(replace(j, limits=Limits()) for j in arm.joints)
    )
    result = identify(bare, scaled([run], [factor] * 4))
    assert kinds(result) == (dict.fromkeys(arm.actuated, "inertias out of scale") if factor != 1.0 else {})
    assert ("kg per metre of its reach" in headline(result)) == (factor != 1.0)


def test_swapped_currents_are_named_before_the_signs_that_they_reverse(parallel: list[Run]) -> None:
    swapped = [replace(run, command=run.command[:, ::-1]) for run in parallel]
    result = identify(FIVE_BAR, swapped)
    assert set(kinds(result).values()) == {SWAPPED_CHANNELS}
    assert "look swapped" in first_line(result)


def test_friction_that_drives_a_joint_contradicts_its_gain(tmp_path: Path) -> None:
    """Torques that are given: twice the viscous friction is missing."""
    arm = stated_arm.robot(tmp_path)
    run = stated_arm.torque_run(stated_arm.plant(arm), 1)
    speed = np.gradient(run.position, run.time, axis=0)
    result = identify(arm, [replace(run, command=run.command - 2 * stated_arm.FRICTION["fv"] * speed * [0, 0, 1, 0])])
    assert kinds(result)["j3"] == "impossible parameters"
    assert "physically impossible parameters: fv_j3 = -1.49 N m s/rad" in headline(result)


@pytest.mark.parametrize(("mass", "kind"), [(1.2, None), (1.2e-3, "prior gain")])
def test_a_torque_scale_of_no_gear_contradicts(mass: float, kind: str | None) -> None:
    """The payload's mass in t, of torques in N m."""
    plant = Plant(gains=(1.0, 1.0), noise=0.02)
    runs = [
        plant.run("free", seed=1, kind="torque"),
        replace(plant.run("loaded", payload=STEEL, seed=2, kind="torque"), payload=Payload(name="steel", mass=mass)),
    ]
    assert kinds(identify(FIVE_BAR, runs)) == (dict.fromkeys(FIVE_BAR.actuated, kind) if kind else {})


def test_a_file_that_is_somewhat_off_contradicts_no_gain(tmp_path: Path) -> None:
    arm = stated_arm.robot(tmp_path)
    run = stated_arm.torque_run(stated_arm.plant(arm), 1)
    assert kinds(identify(arm, scaled([run], [1.35] * 4))) == {}
    heavy = stated_arm.robot(tmp_path, {"j4": 12.0})  # ten times the last link, which is no factor of all
    assert "inertias out of scale" not in kinds(identify(heavy, [run])).values()
