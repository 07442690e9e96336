"""The scale of drive gains without a payload: torque sensors, known parameters, and all of it together."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import stated_arm
from engines import closed_torques
from five_bar_logs import CHI, GAINS, TOOL, Plant, five_bar, write_experiment
from sensed_logs import SensedPlant
from typer.testing import CliRunner

from gtau import read_run
from gtau.cli.commands import app
from gtau.errors import GtauError
from gtau.estimation.diagnostics.scale import scale_shares, scale_uncertainty, sensor_scales, weigh_known
from gtau.estimation.estimators import estimator_of, estimators
from gtau.estimation.estimators.essential import select_friction
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.maximum_likelihood import ML, ml
from gtau.estimation.preconditions import refuse_other_unit, refuse_repeated
from gtau.estimation.regression.dataset import reduce_runs
from gtau.estimation.regression.problem import Problem
from gtau.findings import Grade, silent
from gtau.model.base_parameters import base_parameters, seen_by_sensor
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.result import check, identify, load
from gtau.robots.robot import DRIVE, Joint, Mdh, Robot
from gtau.signals.reading.statements import Payload, Prior, as_payload
from gtau.signals.run import Log, Run

ARM = Robot(
    "arm",
    (
        Joint("1", "ground", "revolute", Mdh()),
        Joint("2", "1", "revolute", Mdh(d=0.4, alpha=np.pi / 2)),
        Joint("3", "2", "revolute", Mdh(d=0.3)),
    ),
    gravity=(0.0, -9.80665, 0.0),
)
ARM_GAINS = (8.0, 5.0, 3.0)
STEEL = {"m": 1.5, "mx": 0.3, "zz": 0.08}


def arm() -> SensedPlant:
    model = InverseDynamics(ARM)
    chi = dict.fromkeys(model.parameter_names, 0.0)
    for joint, mass in zip("123", (5.0, 3.0, 1.5), strict=True):
        chi |= {f"m_{joint}": mass, f"mx_{joint}": 0.2 * mass, f"my_{joint}": 0.03 * mass}
        chi |= {f"{kind}_{joint}": 0.07 * mass for kind in ("xx", "yy", "zz")}
        chi |= {f"ia_{joint}": 0.2, f"fv_{joint}": 1.0, f"fs_{joint}": 1.2, f"off_{joint}": 0.1}
    return SensedPlant(model, chi, ARM_GAINS, (0.2, 0.5, -0.3), (0.5, 0.6, 0.7), tool="3")


def linkage() -> SensedPlant:
    return SensedPlant(five_bar(), CHI, GAINS, np.radians([120.0, 60.0]), (0.5, 0.5), sensor_noise=0.02, tool=TOOL)


PLANTS = {"serial": arm(), "parallel": linkage()}


def fit_of(robot: Robot, runs: Sequence[Run], priors: dict[str, Prior] | None = None) -> Fit:
    dataset = replace(reduce_runs(robot, runs), priors=priors or {})
    return ML.fit(dataset.system(per_run=len(runs) > 1))


def deviations(fit: Fit) -> np.ndarray:
    """Relative standard deviations of the gains, (n,)."""
    return np.sqrt(np.diag(fit.solution.jackknife)[fit.system.problem.gain_rows]) / np.abs(fit.gains)


def scores(fits: Sequence[Fit], truth: Sequence[float]) -> np.ndarray:
    """Errors of the gains in standard deviations, (fits, n)."""
    return np.array([(fit.gains / truth - 1) / deviations(fit) for fit in fits])


# The rows of a sensor


@pytest.mark.parametrize("name", PLANTS)
def test_a_sensor_feels_all_but_its_drive(name: str, rng: np.random.Generator) -> None:
    """Its torque is that of an outside engine for a robot whose drive has neither inertia nor friction nor offset."""
    model = PLANTS[name].model
    chi = {each: rng.uniform(0.5, 1.0) for each in model.parameter_names}
    q = np.array(PLANTS[name].home) + rng.uniform(-0.2, 0.2, (4, len(model.actuated)))
    qd, qdd = rng.normal(size=(2, *q.shape))
    for j, joint in enumerate(model.actuated):
        bare = chi | {f"{kind}_{joint}": 0.0 for kind in DRIVE}
        theirs = closed_torques(model.robot, bare, q, qd, qdd)[:, j]
        felt = np.array(list(chi.values())) * seen_by_sensor(model.parameter_names, joint)
        assert model.regressor(q, qd, qdd)[:, j] @ felt == pytest.approx(theirs, rel=1e-8, abs=1e-8)


def test_a_sensor_separates_the_rotor_from_the_link() -> None:
    plain, sensed = (base_parameters(five_bar(), sensors=sensors) for sensors in ((), ("left",)))
    assert "ia_left" in plain.regroupings["zz_leftR"]
    assert "ia_left" not in sensed.regroupings["zz_leftR"]
    assert set(sensed.names) == {*plain.names, "ia_left"}
    assert "ia_right" in sensed.regroupings["zz_rightR"]


# Gains without a payload


@pytest.mark.parametrize(("name", "sensor", "truth"), [("serial", "2", ARM_GAINS), ("parallel", "left", GAINS)])
def test_one_sensor_scales_all_gains(name: str, sensor: str, truth: Sequence[float]) -> None:
    plant = PLANTS[name].with_sensors(sensor)
    fits = [fit_of(plant.model.robot, [plant.run(2 * k), plant.run(2 * k + 1)]) for k in range(6)]
    found = scores(fits, truth)
    assert np.abs(found).max() < 4
    assert 0.5 < np.sqrt(np.mean(found**2)) < 1.6
    assert np.all(deviations(fits[0]) < 0.03)


@pytest.mark.parametrize(("name", "truth"), [("serial", ARM_GAINS), ("parallel", GAINS)])
def test_known_parameters_scale_all_gains_with_their_deviations(name: str, truth: Sequence[float]) -> None:
    """Values drawn about the truth: a standard deviation of 3 % of the masses' moments is one of the gains."""
    plant, rng = PLANTS[name], np.random.default_rng(1)
    kinds = ("m", "mx", "my", "mz")
    fits = []
    for k in range(6):
        priors = {}
        for each in plant.model.parameter_names:
            if each.split("_")[0] in kinds:
                value, std = plant.chi.get(each, 0.0), 0.03 * abs(plant.chi.get(each, 0.0)) + 1e-3
                priors[each] = Prior(value=value + std * rng.standard_normal(), std=std)
        fits.append(fit_of(plant.model.robot, [plant.run(2 * k), plant.run(2 * k + 1)], priors))
    found = scores(fits, truth)
    assert np.abs(found).max() < 4
    assert 0.4 < np.sqrt(np.mean(found**2)) < 1.6
    assert np.all(deviations(fits[0]) > 0.008)  # the known values' own, which no length of the logs takes away


def known_columns(problem: Problem) -> np.ndarray:
    return np.flatnonzero(problem.known[:, :-1].any(axis=0))


@pytest.mark.parametrize(("name", "sensor", "truth"), [("serial", "2", ARM_GAINS), ("parallel", "left", GAINS)])
def test_payload_and_sensor_together_are_better_than_each(name: str, sensor: str, truth: Sequence[float]) -> None:
    bare, plant = PLANTS[name], PLANTS[name].with_sensors(sensor)
    known, robot = Payload(name="steel", mass=STEEL["m"]), plant.model.robot
    both = fit_of(robot, [plant.run(1), plant.run(2, STEEL, known)])
    alone = fit_of(robot, [bare.run(1), bare.run(2, STEEL, known)])
    unknown = fit_of(robot, [plant.run(1), plant.run(2, STEEL, Payload(name="steel"))])
    better = np.minimum(deviations(alone), deviations(unknown))
    assert np.all(deviations(both) < 1.05 * better)
    assert np.mean(deviations(both)) < 0.95 * min(np.mean(deviations(alone)), np.mean(deviations(unknown)))
    assert np.abs(scores([both], truth)).max() < 4


def test_sensor_and_current_have_lags_of_their_own() -> None:
    plant = replace(arm(), sensors=("2",), lag=0.006)
    fit = fit_of(ARM, [plant.run(1), plant.run(2)])
    assert fit.solution.delays == pytest.approx([0, 0, 0, -0.006], abs=6e-4)
    assert np.abs(scores([fit], ARM_GAINS)).max() < 4


def test_friction_of_a_bearing_is_found_where_there_is_some() -> None:
    for bearing in (0.0, 0.4):
        plant = replace(arm(), sensors=("2",), bearing=bearing)
        system = select_friction(reduce_runs(ARM, [plant.run(1), plant.run(2)]), ml, silent)
        fit = ML.fit(system)
        values = dict(zip(system.problem.parameters, fit.solution.theta, strict=True))
        assert ("fs_2_sensor" in values) == bool(bearing)
        if bearing:
            assert values["fs_2_sensor"] == pytest.approx(bearing, rel=0.1)
        assert values["off_2_sensor"] == pytest.approx(0.3, abs=0.1)
        assert np.abs(scores([fit], ARM_GAINS)).max() < 4


def test_friction_of_a_bearing_is_that_of_the_sensor_alone(tmp_path: Path) -> None:
    """The step of friction over all samples is that of motors; measured logs of a Rokae with sensors were refused."""
    plant = replace(arm(), sensors=("2",), bearing=0.4)
    result = identify(ARM, [plant.run(1), plant.run(2)])
    assert result.curves
    assert not any("sensor" in name for name in result.equation_friction)
    (sensor,) = result.sensors
    assert sensor.parameters["fs_2_sensor"].value == pytest.approx(0.4, rel=0.1)
    result.save(tmp_path / "model.json")
    assert "fs_2_sensor" in load(tmp_path / "model.json").sensors[0].parameters


# What the scale rests on


def test_shares_are_what_a_gain_gains() -> None:
    """A sensor that reads a per cent more, or a mass a per cent larger, moves the gains by their shares of it."""
    plant = arm().with_sensors("2")
    runs = [plant.run(1), plant.run(2, STEEL, Payload(name="steel", mass=STEEL["m"]))]
    shares = scale_shares(before := fit_of(ARM, runs))
    assert np.sum(list(shares.values()), axis=0) == pytest.approx(1.0)
    more = [replace(run, command=run.command * np.array([1, 1, 1, 1.01])) for run in runs]
    by_sensor = fit_of(ARM, more).gains / before.gains - 1
    assert 100 * by_sensor == pytest.approx(shares["torque sensor of '2'"], abs=0.03)
    heavier = [runs[0], replace(runs[1], payload=Payload(name="steel", mass=1.01 * STEEL["m"]))]
    by_mass = fit_of(ARM, heavier).gains / before.gains - 1
    assert 100 * by_mass == pytest.approx(shares["payload 'steel'"], abs=0.03)


@pytest.mark.parametrize("method", ["ml", "2sls", "wls"])
def test_derivatives_by_the_constants_are_those_of_the_full_solve(method: str) -> None:
    """Two payloads, whose masses count by their weights: a small change of each mass, solved again, is the judge."""
    masses, heavy = (STEEL["m"], 2 * STEEL["m"]), {kind: 2 * value for kind, value in STEEL.items()}
    steel, lead = (Payload(name=name, mass=m, mass_std=0.01) for name, m in zip(("steel", "lead"), masses, strict=True))
    dataset = reduce_runs(ARM, [arm().run(1), arm().run(2, STEEL, steel), arm().run(3, heavy, lead)])
    known = np.array(ARM_GAINS) if method == "wls" else None
    fit = estimators()[method].fit(dataset.system(per_run=True), known)

    def solved(of_steel: float, of_lead: float) -> np.ndarray:
        pair = steel.model_copy(update={"mass": of_steel}), lead.model_copy(update={"mass": of_lead})
        return fit.solve(dataset.system(per_run=True, payloads=[None, *pair]).problem).values

    steps = 1e-3 * np.eye(2)
    slopes = np.stack([(solved(*(masses + step)) - solved(*(masses - step))) / 2e-3 for step in steps], axis=1)
    std = np.sqrt(np.diag(fit.solution.jackknife))[: len(fit.solution.theta)]
    gains, thetas = fit.system.problem.gain_rows, slice(len(std))
    found = np.sqrt(np.diag(scale_uncertainty(fit.system, fit.solve)))
    expected = 0.01 * np.linalg.norm(slopes, axis=1)
    assert found[gains] == pytest.approx(expected[gains], rel=0.02)
    assert np.all(np.abs(found - expected)[thetas] < 0.05 * std)


def test_a_payload_is_weighed_against_another_with_the_deviations_of_both() -> None:
    """A mass 4 % too small, stated to 4 %, must not contradict a payload whose mass is exact."""
    heavy = {kind: 2 * value for kind, value in STEEL.items()}
    steel, lead = Payload(name="steel", mass=STEEL["m"]), Payload(name="lead", mass=1.92 * STEEL["m"], mass_std=0.08)
    runs = [arm().run(1), arm().run(2, STEEL, steel), arm().run(3, heavy, lead)]
    verdicts = weigh_known(fit_of(ARM, runs), "ml", 0.01, ())
    assert {name: verdict.outcome for name, verdict in verdicts.items()} == dict.fromkeys(verdicts, Grade.GOOD)
    sure = replace(runs[2], payload=lead.model_copy(update={"mass_std": 0.0}))
    verdicts = weigh_known(fit_of(ARM, [*runs[:2], sure]), "ml", 0.01, ())
    assert set(verdicts) == {"steel", "lead"}
    assert all(verdict.outcome == Grade.CONTRADICTORY for verdict in verdicts.values())


def test_a_sensor_out_of_scale_contradicts_the_others() -> None:
    plant = arm().with_sensors("1", "2", "3")
    runs = [plant.run(1), plant.run(2)]
    true = sensor_scales(fit_of(ARM, runs))
    assert all(abs(each.value - 1) < 4 * each.std for each in true)
    faulty = [replace(run, command=run.command * np.array([1, 1, 1, 1, 0.9, 1])) for run in runs]
    found = {each.channel.joint: each for each in sensor_scales(fit_of(ARM, faulty))}
    assert found["2"].value == pytest.approx(1 / 0.9, rel=0.03)
    result = identify(ARM, faulty)
    assert [sensor.joint for sensor in result.sensors if sensor.verdict.outcome == Grade.CONTRADICTORY] == ["2"]
    assert next(each.ratio.verdict.finding.kind for each in result.sensors if each.joint == "2") == "sensor scale"
    # its residuals show that it does not fit, so it hardly counts
    assert [gain.value for gain in result.drive_gains.values()] == pytest.approx(ARM_GAINS, rel=5e-3)


def test_a_sensor_beside_known_parameters_is_held_against_them_with_their_deviations() -> None:
    plant = arm().with_sensors("2")
    priors = {"mx_3": Prior(value=1.05 * plant.chi["mx_3"], std=0.05 * plant.chi["mx_3"])}
    (each,) = sensor_scales(fit_of(ARM, [plant.run(1), plant.run(2)], priors))
    assert each.std == pytest.approx(0.05, rel=0.2)
    assert each.value == pytest.approx(1.05, abs=0.02)


@pytest.mark.slow
def test_a_wrong_mass_beside_a_sensor_is_named() -> None:
    plant = arm().with_sensors("1", "2", "3")
    result = identify(ARM, [plant.run(1), plant.run(2, STEEL, Payload(name="steel", mass=1.2 * STEEL["m"]))])
    assert result.payloads[0].verdict.outcome == Grade.CONTRADICTORY
    found = result.payloads[0].verdict.why.partition("a mass of ")[2].split()[0]
    assert float(found) == pytest.approx(STEEL["m"], rel=0.05)


# The way through


def test_a_result_keeps_its_sensors(tmp_path: Path) -> None:
    plant = arm().with_sensors("2", "3")
    runs = [plant.run(1), plant.run(2)]
    result = identify(ARM, runs)
    assert {gain.verdict.outcome for gain in result.drive_gains.values()} == {Grade.GOOD}
    assert "torque sensor" in result.summary(verbose=False)
    assert "off_2_sensor" in result.summary()
    last_first = {"torque sensor of '3'": 0.7, "torque sensor of '2'": 0.3}
    shared = result.replaced(scale=dict.fromkeys(result.drive_gains, last_first))
    assert "scale: from the torque sensors of '2', '3'" in shared.summary(verbose=False)
    result.save(tmp_path / "model.json")
    again = load(tmp_path / "model.json")
    assert again.sensors == result.sensors
    text = (tmp_path / "model.json").read_text()
    assert text.count('"kind": "torque sensor"') == 2
    (tmp_path / "other.json").write_text(text.replace('"kind": "torque sensor"', '"kind": "spring"', 1))
    with pytest.raises(GtauError, match="'spring' is not a kind of sensor; write torque sensor"):
        load(tmp_path / "other.json")
    assert again.scale == result.scale
    bare = arm().run(3)
    assert [each.rms for each in again.validate(bare)] == [each.rms for each in result.validate(bare)]
    assert max(each.relative for each in again.validate(bare)) < 1.0


def test_a_sensor_column_is_read_like_a_current(tmp_path: Path) -> None:
    run, log = arm().with_sensors("3", "2").run(1), tmp_path / "log.csv"
    table = np.column_stack([run.time, run.position, run.command[:, :3], 1e3 * run.command[:, 3:]])
    np.savetxt(log, table, delimiter=",", header="t,q1,q2,q3,i1,i2,i3,s3,s2", comments="", fmt="%.9g")
    signals = {
        "time": "t",
        "position": {"1": "q1", "2": "q2", "3": "q3"},
        "current": {"1": "i1", "2": "i2", "3": "i3"},
        "joint_torque": {"3": "s3", "2": "s2"},
    }
    read = read_run(log, signals, units={"joint_torque": {"2": "mN m", "3": "0.001 N m"}})
    assert read.sensors == ("2", "3")  # in the order of the joints
    assert read.command == pytest.approx(run.command[:, [0, 1, 2, 4, 3]], abs=1e-6)
    # a sample that is missing in the sensor alone is missing
    text = log.read_text().splitlines()
    cells = text[500].split(",")
    text[500] = ",".join([*cells[:-1], ""])
    log.write_text("\n".join(text))
    assert any("missing" in note for note in map(str, read_run(log, signals).notes))


def test_every_command_takes_a_sensor_column(tmp_path: Path) -> None:
    plant = linkage().with_sensors("left")
    for k, name in enumerate(("a", "check")):
        run = plant.run(k + 1)
        table = np.column_stack([run.time, run.position, run.command])
        header = "t,q1,q2,i1,i2,s1"
        np.savetxt(tmp_path / f"{name}.csv", table, delimiter=",", header=header, comments="", fmt="%.8g")
    (tmp_path / "experiment.yaml").write_text(
        "robot: five-bar\n"
        "signals: {time: t, position: {left: q1, right: q2}, current: {left: i1, right: i2}, "
        "joint_torque: {left: s1}}\n"
        "runs: [{log: a.csv}]\nvalidation: [{log: check.csv}]\n"
    )
    file, out = str(tmp_path / "experiment.yaml"), str(tmp_path / "out")
    model = f"{out}/model.json"
    for command in (("check", file), ("identify", file, "--out", out), ("validate", model, file)):
        result = CliRunner().invoke(app, command)
        assert result.exit_code == 0, result.output
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "The scale of all joints comes from the torque sensor of" in page


@pytest.mark.slow
def test_other_estimators_with_a_sensor() -> None:
    plant = arm().with_sensors("2")
    runs = [plant.run(1), plant.run(2)]
    for method in ("huber", "2sls", "didim"):
        for gain, truth in zip(identify(ARM, runs, method=method).drive_gains.values(), ARM_GAINS, strict=True):
            low, high = gain.interval(0.999) or (0.0, 0.0)
            assert low < truth < high, method
    for method in ("tls", "iv"):
        with pytest.raises(GtauError, match=rf"method '{method}' takes no torque sensors.*choose from ml"):
            identify(ARM, runs, method=method)
        with pytest.raises(GtauError, match=rf"method '{method}' takes no known parameters.*choose from ml"):
            identify(ARM, [arm().run(1)], method=method, priors={"m_3": Prior(value=1.5, std=0.1)})


def test_outliers_of_a_sensor_count_less_with_huber() -> None:
    plant = arm().with_sensors("2")
    runs = []
    for run in (plant.run(1), plant.run(2)):
        command = run.command.copy()
        command[400:1600:100, 3] += 60.0
        runs.append(replace(run, command=command))
    system = reduce_runs(ARM, runs).system(per_run=True)
    off = [np.abs(estimator_of(method).fit(system).gains / ARM_GAINS - 1) for method in ("ml", "huber")]
    assert off[1].max() < 0.5 * off[0].max()


# Refusals


def test_what_is_refused() -> None:
    runs = [arm().run(1), arm().run(2)]
    with pytest.raises(GtauError, match=r"needs a scale.*torque sensors \('joint_torque'.*known parameters"):
        identify(ARM, runs)
    with pytest.raises(GtauError, match=r"priors' \(m_1\) cannot give the scale.*give priors for all parameters"):
        identify(ARM, runs, priors={"m_1": Prior(value=5.0, std=0.1)})
    with pytest.raises(GtauError, match=r"'m_4', which is no parameter of the robot; did you mean 'm_"):
        identify(ARM, runs, priors={"m_4": Prior(value=5.0, std=0.1)})
    with pytest.raises(GtauError, match=r"torque sensors at other joints \(2; none\); give 'joint_torque'"):
        identify(ARM, [arm().with_sensors("2").run(1), runs[1]])


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"joint_torque": {"4": "s"}}, "'joint_torque' names the joint '4', which has no position"),
        ({"temperature": {"4": "T4"}}, "'temperature' names the joint '4', which has no position"),
        ({"joint_torque": {"1": "i1"}}, "the column 'i1' is given both as a current and as a joint_torque"),
    ],
)
def test_columns_that_are_refused(more: dict, said: str, tmp_path: Path) -> None:
    signals = {"time": "t", "position": {"1": "q1"}, "current": {"1": "i1"}, **more}
    with pytest.raises(GtauError, match=said):
        read_run(tmp_path / "log.csv", signals)


def test_the_calibration_of_a_sensor_counts_by_its_share_in_the_scale() -> None:
    plant = arm().with_sensors("2")
    runs = [plant.run(1), plant.run(2, STEEL, Payload(name="steel", mass=STEEL["m"]))]
    known = [
        replace(run, channels=tuple(replace(c, std=0.05 * c.kind.link_side) for c in run.channels)) for run in runs
    ]
    fit = fit_of(ARM, known)
    extra = scale_uncertainty(fit.system, fit.solve)
    shares = scale_shares(fit)["torque sensor of '2'"]
    found = np.sqrt(np.diag(extra)[fit.system.problem.gain_rows]) / fit.gains
    assert found == pytest.approx(0.05 * shares, abs=0.005)
    exact = fit_of(ARM, runs)
    assert not scale_uncertainty(exact.system, exact.solve).any()
    (alone,), (tolerant,) = sensor_scales(exact), sensor_scales(fit)
    assert tolerant.std == pytest.approx(np.hypot(alone.std, 0.05))


@pytest.mark.parametrize(
    ("off", "others", "method", "wrong"),
    [
        (1.0, {}, None, set()),
        (1.1, {}, "wls", {"mz_j4"}),  # the torques are given
        (1.1, {"ia_j4": 0.01}, None, {"mz_j4", "ia_j4"}),  # the two contradict each other
        (1.1, {}, None, set()),  # it sets the scale alone
    ],
)
def test_known_parameters_test_torques_and_are_compared_with_all_else(
    off: float, others: dict[str, float], method: str | None, wrong: set[str], tmp_path: Path
) -> None:
    arm = stated_arm.robot(tmp_path)
    run, true = stated_arm.torque_run(stated_arm.plant(arm), 1), stated_arm.chi(arm)
    priors = {name: {"value": true[name], "std": std * true[name]} for name, std in others.items()}
    priors |= {"mz_j4": {"value": off * true["mz_j4"], "std": 0.01 * true["mz_j4"]}, "my_j1": {"value": 0, "std": 0.2}}
    result = identify(arm, [run], priors=priors, method=method)
    assert {note.subject for note in result.notes if note.kind == "contradictory prior"} == wrong
    assert result.method == (method or "ml")
    if method is None and not others:
        for gain in result.drive_gains.values():
            low, high = gain.interval()
            assert low < off < high
    (said,) = [note for note in result.notes if note.subject == "mz_j4"] or [None]
    if said is not None:  # what all else says, not a mean of it and the prior
        assert float(said.what.partition(" is ")[2].split()[0]) == pytest.approx(true["mz_j4"], rel=0.05)


@pytest.mark.slow
def test_a_first_moment_in_metres_is_recognised(tmp_path: Path) -> None:
    arm = stated_arm.robot(tmp_path)
    plant = replace(stated_arm.plant(arm), tool="j4")
    carried = {"m": 5.0, "mx": 0.25, "mz": 0.5, "xx": 0.06, "yy": 0.07, "zz": 0.02}
    known = Payload(name="block", mass=5.0, parameters={"mx": 0.05})
    (payload,) = identify(arm, [plant.run(1), plant.run(2, payload=carried, known=known)]).payloads
    assert payload.verdict.outcome == Grade.CONTRADICTORY
    assert "if 0.05 is in m, write 'mx: 0.25'" in payload.verdict.advice


def test_moments_that_the_data_know_together_alone_are_both_named() -> None:
    """Two axes that intersect feel no mass, so that the scale rests on first moments, of which they know the ratio."""
    second = Joint("2", "1", "revolute", Mdh(alpha=np.pi / 2))
    model = InverseDynamics(replace(ARM, joints=(ARM.joints[0], second), gravity=(0.0, 0.0, -9.80665)))
    chi = {name: value for name, value in arm().chi.items() if not name.endswith("_3")}
    wrist = SensedPlant(model, chi, ARM_GAINS[:2], (0.2, 0.5), (0.5, 0.6), tool="2")
    carried = {"m": 1.5, "mx": 0.2, "my": 0.15, "xx": 0.02, "yy": 0.03, "zz": 0.05}
    known = Payload(name="block", mass=1.5, parameters={"mx": 0.24, "my": 0.15})
    (payload,) = identify(model.robot, [wrist.run(1), wrist.run(2, payload=carried, known=known)]).payloads
    assert payload.verdict.outcome == Grade.CONTRADICTORY
    assert re.search(
        r"its mx is 0\.20.*not 0\.24 kg m; or as likely, .*its my is 0\.1.*not 0\.15 kg m; check", str(payload.verdict)
    )


@pytest.mark.parametrize(
    ("parameters", "problem"),
    [
        ({"xx": -0.5}, "xx is -0.5 kg m2"),
        ({"mx": 0.4, "yy": 0.01}, "yy is 0.01 kg m2, and 0.08 by mass and centre alone"),
        ({"xx": 0.5, "yy": 0.1, "zz": 0.1}, "xx is 0.5 kg m2, and yy and zz together 0.2"),
        ({"xx": 0.1, "yz": 0.2}, "yz is 0.2 kg m2, and xx 0.1"),
    ],
)
def test_inertias_that_no_body_has_are_refused(parameters: dict[str, float], problem: str) -> None:
    with pytest.raises(GtauError, match=re.escape(f"{problem}, which no body has; correct the parameters")):
        as_payload({"name": "block", "mass": 2.0, "parameters": parameters})
    block = {"mx": 0.1, "my": -0.04, "xx": 0.02, "yy": 0.03, "zz": 0.02, "xy": 0.005}
    assert as_payload({"name": "block", "mass": 2.0, "parameters": block}) is not None


def test_the_same_samples_are_refused_twice(tmp_path: Path) -> None:
    arm = stated_arm.robot(tmp_path)
    run = stated_arm.torque_run(stated_arm.plant(arm), 1)
    loaded = replace(run, name="loaded", payload=Payload(name="block", mass=1.0))
    with pytest.raises(GtauError, match="runs 'run 1' and 'loaded' hold the same samples, so it is declared with two"):
        identify(arm, [run, loaded])
    notes = check(arm, [run, replace(run, name="again")]).notes
    assert any("hold the same samples, so it would count twice" in str(note) for note in notes)


def test_parts_of_a_log_that_overlap_are_refused() -> None:
    refuse_repeated([part_of_log(0.0, 5.0), part_of_log(5.0, 9.0)])
    refuse_repeated([part_of_log(0.0, 5.1), part_of_log(5.0, 9.0)])  # as their clocks have it, cut at a dropout
    with pytest.raises(GtauError, match="hold the same samples"):
        refuse_repeated([part_of_log(0.0, 5.0), part_of_log(4.0, 9.0)])


def test_a_run_in_another_unit_is_refused() -> None:
    one, other = part_of_log(0.0, 5.0), part_of_log(5.0, 9.0)
    refuse_other_unit([one, replace(other, command=50 * other.command)])
    with pytest.raises(GtauError, match=r"the currents of run 'from 5' are 9[0-9]* times as large as in run 'from 0'"):
        refuse_other_unit([one, replace(other, command=1000 * other.command)])


def part_of_log(start: float, end: float) -> Run:
    time = np.arange(start, end, 0.01)
    q = np.sin(time)[:, None]
    return Run(f"from {start:g}", ("j",), time, q, q, log=Log(paths=(Path("log.csv"),)))


def test_prior_gains_of_some_joints_are_enough_where_gains_are_estimated(tmp_path: Path) -> None:
    path = write_experiment(tmp_path, Plant(noise=0.02))
    path.write_text(path.read_text().replace("{left: 2.5, right: 4.0}", "{left: 25.0}"))
    kinds = {
        joint: gain.verdict.finding.kind for joint, gain in identify(path).drive_gains.items() if gain.verdict.finding
    }
    assert kinds["left"] == "prior gain"
    with pytest.raises(GtauError, match="needs a drive gain for every joint, and joint 'right' has none"):
        identify(path, method="wls")
