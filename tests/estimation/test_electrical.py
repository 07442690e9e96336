"""Drive gains from voltages: of the motor's equation alone, beside a payload, and against it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from five_bar_logs import CHI, GAINS, JOINTS, STEEL, Plant
from motor_logs import Motors

from gtau import identify, load_robot, read_run
from gtau.errors import GtauError
from gtau.estimation.electrical import with_voltages
from gtau.estimation.experiment_runs import Options, Subject
from gtau.estimation.identify import identify_subject
from gtau.estimation.regression.dataset import reduce_runs
from gtau.estimation.regression.problem import MotorEquation
from gtau.estimation.results.conclusions import headline
from gtau.estimation.results.result import IdentifiedModel
from gtau.findings import Grade
from gtau.result import load
from gtau.robots.robot import Robot
from gtau.signals.reading.columns import Signals
from gtau.signals.reading.statements import Drive, Payload
from gtau.signals.run import Run

MOTORS = Motors(GAINS, noise=0.005)


def run(seed: int, motors: Motors = MOTORS, mass: float | None = None, seconds: float = 16.0) -> Run:
    """A run with voltages, with the payload of 1.2 kg where a mass is stated."""
    plain = Plant(noise=0.01).run(f"run {seed}", seconds, STEEL if mass else None, seed)
    return replace(motors.logged(plain, "duty"), payload=Payload(name="steel", mass=mass) if mass else None)


def equations(runs: Sequence[Run], drives: Mapping[str, Drive] | None = None) -> tuple[MotorEquation, ...]:
    return with_voltages(reduce_runs(load_robot("five-bar"), runs), drives or {}).motors


@pytest.mark.parametrize(
    ("motors", "error"),
    [
        (MOTORS, 0.001),
        (replace(MOTORS, dead=0.02), 0.01),
        (replace(MOTORS, warming=0.15), 0.002),
        (replace(MOTORS, bits=12, sag=0.3), 0.002),
        (replace(MOTORS, bits=12, dead=0.02, warming=0.15, sag=0.3, rate=50.0), 0.012),
    ],
)
def test_back_emf_constants_follow_from_motion_alone(motors: Motors, error: float) -> None:
    """Whatever bridge, winding and recorder add, with intervals that hold it."""
    found = [equations([run(seed, motors)]) for seed in (1, 2, 3)]
    apart = [
        (motor.ke - gain) / np.sqrt(motor.covariance[0, 0])
        for motors in found
        for motor, gain in zip(motors, GAINS, strict=True)
    ]
    assert np.max(np.abs(apart)) < 3.5
    assert max(abs(motor.ke / gain - 1) for motors in found for motor, gain in zip(motors, GAINS, strict=True)) < error
    assert all(motor.explained > 0.99 for motors in found for motor in motors)


def test_conventions_and_signs_of_voltages() -> None:
    """An amplitude-invariant q axis has 3/2; a voltage that counts the other way has no negative resistance."""
    amplitude = {joint: Drive(convention="amplitude", commutation=0.005) for joint in JOINTS}
    motors = equations([run(1, replace(MOTORS, convention=1.5))], amplitude)
    assert [motor.ke for motor in motors] == pytest.approx(GAINS, rel=2e-3)
    assert motors[0].std / motors[0].ke == pytest.approx(0.005, rel=0.1)
    turned = run(1)
    duty = turned.side["duty"]
    reverse = replace(duty, by_joint={joint: -values for joint, values in duty.by_joint.items()})
    motors = equations([replace(turned, side={**turned.side, "duty": reverse})])
    assert [motor.ke for motor in motors] == pytest.approx(GAINS, rel=2e-3)
    assert motors[0].resistance == pytest.approx(2.0, rel=0.01)


def test_gains_without_a_payload(tmp_path: Path) -> None:
    """They have the efficiency of commutation in their intervals, and so have all parameters; R is there too."""
    result = identify(load_robot("five-bar"), [run(1)])
    for joint, gain in zip(JOINTS, GAINS, strict=True):
        low, high = result.drive_gains[joint].interval()
        assert low < gain < high
        assert 1.0 < 100 * (high - low) / gain / 2 < 3
    assert "scale: from the voltages of 2 motors (efficiency of commutation 1.5 %, assumed)" in result.summary(False)
    low, high = result.motors["R_left"].interval()
    assert low < 2.0 < high
    assert result.motors["R_left"].unit == "ohm"
    assert result.motors["ke_right"].value == pytest.approx(4.0, rel=0.01)
    assert result.to_frame().filter(group="motor").height == 4
    result.save(tmp_path / "model.json")
    assert load(tmp_path / "model.json").motors["R_left"].value == result.motors["R_left"].value


def stated(runs: Sequence[Run], std: float, robot: Robot | None = None) -> IdentifiedModel:
    """Identify with motors of a stated efficiency of commutation."""
    drives = {joint: Drive(commutation=std) for joint in JOINTS}
    return identify_subject(Subject(robot or load_robot("five-bar"), runs, Options(drives=drives)))


def test_voltage_and_payload_together_are_better_than_either() -> None:
    weighed = [run(1), run(2, mass=1.2)]
    bare = [replace(one, side={}) for one in weighed]
    both, payload, voltage = (stated(runs, 0.002) for runs in (weighed, bare, weighed[:1]))
    for joint in JOINTS:
        widths = [result.drive_gains[joint].half_width for result in (both, payload, voltage)]
        assert widths[0] < min(widths[1:])
    assert "voltages of 2 motors (efficiency of commutation 0.2 %, stated)" in str(both.scale["left"])
    assert sum(both.scale["left"].values()) == pytest.approx(1)
    assert len(both.scale["left"]) == 2


def test_an_assumed_efficiency_of_commutation_makes_no_good_gain_just_within_the_accuracy() -> None:
    """Good where the efficiency is known to 1.5 %, but not where it is assumed."""
    assumed, known = (
        identify_subject(
            Subject(load_robot("five-bar"), [run(1)], Options(accuracy=0.025, drives=dict.fromkeys(JOINTS, drive)))
        ).drive_gains["left"]
        for drive in (Drive(convention="dc"), Drive(commutation=0.015))
    )
    assert assumed.half_width == known.half_width < 2.5
    assert assumed.verdict.outcome == Grade.WEAK
    assert "rests on an assumed efficiency of commutation" in assumed.verdict.finding.what
    assert known.verdict.outcome == Grade.GOOD


@pytest.mark.parametrize("mass", [pytest.param(1.14, marks=pytest.mark.slow), 1.2, 1.26])
def test_a_payload_stated_wrong_by_five_per_cent_is_found(mass: float) -> None:
    result = identify(load_robot("five-bar"), [run(1), run(2, mass=mass)])
    if mass == 1.2:
        assert result.accepted
        return
    assert not result.believable
    assert "payload 'steel', which contradicts the data" in headline(result)
    assert "the voltages say 4 N m/A at 'right'" in headline(result)
    assert f"the payload {4 * mass / 1.2:.3g}" in headline(result)


def test_iron_that_saturates_makes_no_payload_wrong() -> None:
    """Currents of a payload grow with those beside it, as if it were heavier than the voltages say."""
    runs = []
    for seed, mass in ((1, None), (2, 1.2)):
        plain = Plant(noise=0.01).run(f"run {seed}", 16.0, STEEL if mass else None, seed)
        saturated = replace(plain, command=plain.command * (1 + 0.02 * np.abs(plain.command)))
        payload = Payload(name="steel", mass=mass) if mass else None
        runs.append(replace(MOTORS.logged(saturated, "duty"), payload=payload))
    assert stated(runs, 0.002).believable


def test_one_voltage_that_contradicts_all_else_is_named() -> None:
    """The voltages of one motor count between two lines: its gain would be 1.7 times as large."""
    runs = [run(1), run(2, mass=1.2)]
    runs = [
        replace(one, side=one.side | {"duty": replace(duty := one.side["duty"], by_joint=duty.by_joint | {
            "left": 1.7 * duty.by_joint["left"]
        })}) for one in runs
    ]  # fmt: skip
    result = identify(load_robot("five-bar"), runs)
    (note,) = [note for note in result.notes if note.kind == "contradictory voltage"]
    assert "the voltage of 'left' says 4.2" in note.what
    assert "all other data 2.5" in note.what
    assert "'convention' of drives.left" in note.advice
    assert result.accepted


def table(one: Run) -> dict[str, np.ndarray]:
    """The columns of a log."""
    columns = {"t": one.time}
    for j, joint in enumerate(JOINTS):
        columns |= {f"q {joint}": one.position[:, j], f"current {joint}": one.command[:, j]}
        columns |= {f"{key} {joint}": values.by_joint[joint] for key, values in one.side.items()}
    return columns


def signals(*keys: str, **more: object) -> dict[str, object]:
    columns = {key: {joint: f"{key} {joint}" for joint in JOINTS} for key in keys}
    return {"time": "t", "position": {joint: f"q {joint}" for joint in JOINTS}} | columns | more


HARD = replace(MOTORS, bits=12, dead=0.02, warming=0.1, sag=0.3)
GAIN = 3.0  # 1/rad, of a servo that moves in proportion to goal less position


@pytest.mark.parametrize("rate", [None, 50.0])
@pytest.mark.parametrize("kind", ["voltage", "duty", "magnitude", "supply", "supply magnitude", "goal"])
def test_what_recorders_log(kind: str, rate: float | None) -> None:
    """Currents of motor or supply, signed or magnitudes, with voltages, duties or goals."""
    made = replace(HARD, rate=rate)
    columns = table(made.logged(Plant(noise=0.01).run("log", 16.0, seed=3), "supply"))
    for joint in JOINTS:
        columns[f"goal {joint}"] = columns[f"q {joint}"] + columns[f"duty {joint}"] / GAIN
        columns[f"voltage {joint}"] = 1000 * columns[f"duty {joint}"] * columns[f"supply_voltage {joint}"]
        for current in ("current", "supply_current"):
            if "magnitude" in kind or kind == "goal":
                columns[f"{current} {joint}"] = np.abs(columns[f"{current} {joint}"])
        columns[f"supply_current {joint}"] /= 0.0065
    units: dict[str, object] = {"voltage": "mV"} if kind == "voltage" else {}
    if kind == "voltage":
        described = signals("current", "voltage")
    elif kind == "goal":
        described = signals("supply_current", "goal", "supply_voltage", proportional_gain=dict.fromkeys(JOINTS, GAIN))
    else:
        described = signals("supply_current" if "supply" in kind else "current", "duty", "supply_voltage")
    if "supply_current" in described:
        units = {"supply_current": "0.0065 A"}
    log = read_run(columns, described, units=units)
    motors = equations([log])
    assert len(motors) == 2
    for motor, gain in zip(motors, GAINS, strict=True):
        assert motor.ke == pytest.approx(gain, abs=max(3.5 * np.sqrt(motor.covariance[0, 0]), 0.004 * gain))
        assert np.sqrt(motor.covariance[0, 0]) < 0.01 * gain


@pytest.mark.parametrize("key", ["current", "supply_current"])
def test_currents_of_motors_given_as_currents_of_their_supply_are_named(key: str) -> None:
    columns = table(HARD.logged(Plant(noise=0.01).run("log", 16.0, seed=3), "supply"))
    columns |= {f"supply_current {joint}": columns[f"{key} {joint}"] for joint in JOINTS}
    kinds = [note.kind for note in read_run(columns, signals("supply_current", "duty", "supply_voltage")).notes]
    assert ("motors' currents" in kinds) == (key == "current")


@pytest.mark.parametrize("sign", [1, -1])
def test_signed_currents_that_never_fall_below_zero_stay_as_they_are(sign: int) -> None:
    """As of motors that hold a weight while they move both ways, whichever way the voltage counts."""
    plant = Plant(noise=0.01, chi=CHI | {f"off_{joint}": 6.0 for joint in JOINTS})
    columns = table(replace(MOTORS, resistance=0.05, bits=10).logged(plant.run("log", 16.0, seed=3)))
    columns |= {f"voltage {joint}": sign * columns[f"voltage {joint}"] for joint in JOINTS}
    currents = np.column_stack([columns[f"current {joint}"] for joint in JOINTS])
    assert currents.min() > 0
    np.testing.assert_array_equal(read_run(columns, signals("current", "voltage")).command, currents)


@pytest.mark.parametrize("late", [2, 4, 8])
def test_voltages_that_are_late_do_not_change_the_sign_of_a_gain(late: int) -> None:
    """A lag adds acceleration to the voltage, as if R were less, or below zero; 2 ms a sample."""
    columns = table(replace(MOTORS, resistance=0.1).logged(Plant(noise=0.01).run("log", 16.0, seed=3)))
    for joint in JOINTS:
        columns[f"voltage {joint}"] = np.roll(columns[f"voltage {joint}"], late)
    motors = equations([read_run(columns, signals("current", "voltage"))])
    assert min(motor.ke for motor in motors) > 0


def test_goals_of_servos_with_a_stated_resistance() -> None:
    """Without a supply voltage: g is as uncertain as R."""
    columns = table(replace(HARD, rate=50.0).logged(Plant(noise=0.01).run("log", 16.0, seed=3), "supply"))
    for joint in JOINTS:
        columns[f"goal {joint}"] = np.degrees(columns[f"q {joint}"] + columns[f"duty {joint}"] / GAIN)
        columns[f"supply_current {joint}"] = np.abs(columns[f"supply_current {joint}"])
    described = signals("supply_current", "goal", proportional_gain=dict.fromkeys(JOINTS, GAIN))
    log = read_run(columns, described, units={"goal": "deg"})
    for motor, gain in zip(equations([log], dict.fromkeys(JOINTS, Drive(resistance=2.1))), GAINS, strict=True):
        assert motor.ke == pytest.approx(gain, abs=2 * motor.std)
        assert motor.std > 0.09 * gain
    with pytest.raises(GtauError, match="neither its supply voltage nor its resistance is known"):
        identify(load_robot("five-bar"), [log])


def test_supply_currents_need_a_duty_and_proportional_gains_a_goal() -> None:
    with pytest.raises(ValueError, match="'supply_current' needs a 'duty'"):
        Signals(**signals("supply_current"))
    with pytest.raises(ValueError, match="'proportional_gain' is given without 'goal'"):
        Signals(**signals("current", proportional_gain=dict.fromkeys(JOINTS, 1.0)))


def test_what_is_stated_and_not_used_is_said() -> None:
    """Goals without a proportional gain, and currents of the supply beside those of the motors."""
    columns = table(HARD.logged(Plant(noise=0.01).run("log", 16.0, seed=3), "supply"))
    columns |= {f"goal {joint}": columns[f"q {joint}"] + columns[f"duty {joint}"] / GAIN for joint in JOINTS}
    log = read_run(columns, signals("current", "goal", "supply_current"))
    log = replace(log, log=replace(log.log, signals=Signals(**signals("current", "goal", "supply_current"))))
    notes = [str(note) for note in with_voltages(reduce_runs(load_robot("five-bar"), [log]), {}).remarks]
    assert notes == [
        "the supply current of 'left' and 'right' is not used beside the current; remove one of them from the signals",
        "the goal of 'left' and 'right' gives no gain, as the proportional gain is not stated; add 'proportional_gain' "
        "to the signals",
    ]


@pytest.mark.parametrize(("key", "kind"), [("voltage", "current"), ("duty", "current"), ("goal", "position")])
def test_one_column_is_not_two_signals(key: str, kind: str) -> None:
    given = signals("current")
    with pytest.raises(ValueError, match=f"is given both as a {kind} and as a {key}; give the column of the {key}"):
        Signals(**given, **{key: given[kind]})


def test_a_constant_supply_is_a_number() -> None:
    columns = table(replace(HARD, sag=0.0).logged(Plant(noise=0.01).run("log", 16.0, seed=3), "duty"))
    for supply in (24, "24.0"):
        log = read_run(columns, signals("current", "duty", supply_voltage=supply))
        assert [motor.ke for motor in equations([log])] == pytest.approx(GAINS, rel=0.01)
        (note,) = [note.what for note in log.notes if note.kind == "side signals"]
        assert note.endswith(f"are read duty (1) duty left, duty right; supply_voltage (V) {supply}")


@pytest.mark.parametrize(("key", "factor", "most", "unit"), [("duty", 100, "1", "%"), ("voltage", 1000, "24", "mV")])
def test_duties_and_voltages_beyond_their_supply_have_another_unit(
    key: str, factor: float, most: str, unit: str
) -> None:
    made = MOTORS.logged(Plant().run("log", 16.0, seed=3), "supply")
    columns = table(made) | {f"voltage {joint}": 24 * made.side["duty"].by_joint[joint] for joint in JOINTS}
    columns |= {f"{key} {joint}": factor * columns[f"{key} {joint}"] for joint in JOINTS}
    with pytest.raises(GtauError, match=rf"the {key} of 'left' reaches .*, where {most} is the most.*{key}: '{unit}'"):
        read_run(columns, signals("current", key, "supply_voltage"))


def test_voltages_that_say_nothing_of_a_motor_are_not_used() -> None:
    """A column that is no voltage of the motor; the reason is in the refusal, and in a note beside a payload."""
    bad = [run(1), run(2, mass=1.2)]
    rng = np.random.default_rng(1)
    noise = {joint: rng.standard_normal(len(bad[0].time)) for joint in JOINTS}
    bad = [replace(one, side=one.side | {"duty": replace(one.side["duty"], by_joint=noise)}) for one in bad]
    with pytest.raises(
        GtauError, match=r"voltage of 'left' \(\d* % explained\) and 'right' \(.*\), which gives no gain"
    ):
        identify(load_robot("five-bar"), bad[:1])
    result = identify(load_robot("five-bar"), bad)
    assert result.accepted
    assert [note.joints for note in result.notes if note.kind == "voltage"] == [JOINTS]
    assert not result.motors


def test_a_duty_in_place_of_the_current_gives_no_gain(tmp_path: Path) -> None:
    """With a payload its gain is g U / R, and the viscous friction contains the back-EMF; a note says so."""
    runs = []
    for seed, mass in ((1, None), (2, 1.2)):
        one = replace(MOTORS, noise=0.0).logged(Plant().run("log", 16.0, STEEL if mass else None, seed), "duty")
        pl.DataFrame(table(one)).write_csv(log := tmp_path / f"{seed}.csv")
        described = signals(current={joint: f"duty {joint}" for joint in JOINTS})
        runs.append(read_run(log, described, {"name": "steel", "mass": mass} if mass else None))
    result = identify(load_robot("five-bar"), runs)
    for joint, gain in zip(JOINTS, GAINS, strict=True):
        low, high = result.drive_gains[joint].interval()
        assert low < gain * MOTORS.supply / MOTORS.resistance < high
        assert result.drive_gains[joint].half_width < 1.0  # %
    back_emf = GAINS[0] ** 2 / MOTORS.resistance
    assert result.parameters["fv_left"].value == pytest.approx(CHI["fv_left"] + back_emf, rel=0.05)
    (note,) = [note.what for note in result.notes if note.kind == "voltage"]
    assert "'left' and 'right' is a voltage or duty: its gain is the torque constant over the resistance" in note
    assert "viscous friction contains the back-EMF" in note


def test_consistent_parameters_rest_on_voltages_too() -> None:
    result = identify(load_robot("five-bar"), [run(1)], consistent=True)
    assert result.consistency is not None
    for joint, gain in zip(JOINTS, GAINS, strict=True):
        assert result.consistency.gains[joint][0] == pytest.approx(gain, rel=0.02)
