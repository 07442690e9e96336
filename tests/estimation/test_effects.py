"""Effects put into logs are found with their sizes, alone, and healthy logs show none."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import friction_logs
import numpy as np
import pytest
from five_bar_logs import GAINS, JOINTS, STEEL, Plant
from scipy.signal import lfilter
from sensed_logs import SensedPlant
from stated_arm import plant, robot

from gtau.demo import write_tutorial
from gtau.estimation.diagnostics.diagnose import Examination
from gtau.estimation.effects.effect import EstimatedEffect, FitWindow, rms_speeds, rms_torques
from gtau.estimation.effects.estimate import Mixed, contradictions, estimate_effects, estimated_effects
from gtau.estimation.effects.known import EFFECTS
from gtau.estimation.effects.mixed_model import lag_products
from gtau.estimation.effects.rows import _by_noise, difference_root, run_covariance, run_modes
from gtau.estimation.estimators.maximum_likelihood import ML
from gtau.estimation.regression.assembly import FEWEST_ROWS
from gtau.estimation.regression.dataset import reduce_runs
from gtau.findings import Grade
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.result import identify
from gtau.robots.parameter import Parameter
from gtau.robots.robot import PLAIN_FRICTION, Pose
from gtau.signals.preparation.filters import differentiate
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run

ROBOT = load_robot("five-bar")


@pytest.fixture(scope="module")
def runs() -> list[Run]:
    plant, known = Plant(noise=0.01), Payload(name="steel", mass=STEEL["m"])
    free, loaded = plant.run("free", 10.0, seed=1), plant.run("loaded", 10.0, STEEL, seed=2)
    return [free, replace(loaded, payload=known)]


def mixed(runs: list[Run]) -> Mixed:
    result = estimate_effects(ML.fit(reduce_runs(ROBOT, runs).system(per_run=True)))
    assert result is not None
    return result


def of_joint(runs: list[Run], name: str, joint: str) -> EstimatedEffect:
    """The effect of a joint; raises StopIteration where it has no size."""
    return next(each for each in estimated_effects(mixed(runs)) if (each.effect, each.cause.joint) == (name, joint))


def currents(runs: list[Run], change: Callable[[Run], np.ndarray]) -> list[Run]:
    return [replace(run, command=change(run)) for run in runs]


def falling(runs: list[Run], fall: float) -> list[Run]:
    """Currents of a torque constant of the left joint that falls up to twice the rms current."""
    rms = np.sqrt(np.mean([np.mean(run.command**2, axis=0) for run in runs], axis=0))
    return currents(runs, lambda run: run.command * (1 + fall * np.abs(run.command) / (2 * rms) * [1.0, 0.0]))


def test_a_torque_constant_that_falls_has_its_size_and_its_gain_is_right(runs: list[Run]) -> None:
    faulty = falling(runs, 0.02)
    effect = of_joint(faulty, "saturation", "left")
    assert effect.size == pytest.approx(0.02, rel=0.25)
    assert effect.likelihood > 20
    result, plain = mixed(faulty), ML.fit(reduce_runs(ROBOT, faulty).system(per_run=True)).gains[0]
    gain, _ = result.values[result.rows.fit.system.problem.gain_rows]
    assert abs(gain / GAINS[0] - 1) < 0.4 * abs(plain / GAINS[0] - 1)


def test_a_torque_constant_that_rises_is_no_effect(runs: list[Run]) -> None:
    assert "saturation" not in {effect.effect for effect in estimated_effects(mixed(falling(runs, -0.02)))}


def test_a_filter_has_the_shape_of_its_delay(runs: list[Run]) -> None:
    past = np.exp(-1 / (0.02 * runs[0].rate))
    filtered = currents(runs, lambda run: lfilter([1 - past], [1, -past], run.command, axis=0))
    result = mixed(filtered)
    gains = result.values[result.rows.fit.system.problem.gain_rows]
    np.testing.assert_allclose(gains, GAINS, rtol=0.004)


def test_delays_that_effects_hardly_move_keep_their_value_and_deviation(runs: list[Run]) -> None:
    result = mixed(runs)
    delays, plain = result.fit.system.problem.unknowns.delays, result.fit.solution
    np.testing.assert_array_equal(result.values[delays], plain.values[delays])
    own, of_fit = (np.diag(covariance)[delays] for covariance in (result.covariance, plain.jackknife))
    assert (own > 0.99 * of_fit).all()


def test_intervals_grow_with_the_squares_of_moves_by_a_filter(runs: list[Run], monkeypatch: pytest.MonkeyPatch) -> None:
    past = np.exp(-1 / (0.02 * runs[0].rate))
    filtered = currents(runs, lambda run: lfilter([1 - past], [1, -past], run.command, axis=0))
    plain = ML.fit(reduce_runs(ROBOT, filtered).system(per_run=True))
    moves = {
        effect.cause.joint: effect.moves
        for effect in estimated_effects(mixed(filtered))
        if effect.effect == "current lag"
    }
    variances = []
    for curvature in (0.0, 1000.0):
        monkeypatch.setattr("gtau.estimation.effects.estimate.CURVATURE", curvature)
        result = mixed(filtered)
        rows = plain.system.problem.gain_rows
        variances.append(np.diag(result.covariance)[rows] / result.values[rows] ** 2)
    moved = np.sum([[moves[by][joint] / 100 for joint in JOINTS] for by in JOINTS], axis=0)
    added = np.sqrt(variances[1] - variances[0])  # other effects of motion move the gains a little, too
    assert (added > 0.99 * 1000 * moved**2).all()
    assert (added < 1.5 * 1000 * moved**2).all()


def test_columns_are_made_again_until_no_gain_moves(runs: list[Run]) -> None:
    """Beside a torque constant that falls the gains are what the same logs with a constant one give."""
    rms = np.sqrt(np.mean([np.mean(run.command**2, axis=0) for run in runs], axis=0))
    result = mixed(currents(runs, lambda run: run.command * (1 + 0.1 * np.abs(run.command) / (2 * rms))))
    rows = result.rows.fit.system.problem.gain_rows
    np.testing.assert_allclose(result.rows.fit.gains, result.values[rows], rtol=0.005)  # those of the columns
    np.testing.assert_allclose(result.values[rows], mixed(runs).values[rows], rtol=0.0015)


def test_noise_is_of_each_motion(runs: list[Run]) -> None:
    rng, (free, loaded) = np.random.default_rng(8), runs
    noise = 0.1 * np.std(loaded.command, axis=0) * rng.standard_normal(loaded.command.shape)
    found = mixed([free, replace(loaded, command=loaded.command + noise)]).mixed.model.noise
    assert all(loud.std > 3 * quiet.std for quiet, loud in found)
    again = replace(Plant(noise=0.01).run("again", 10.0, STEEL, seed=1), payload=loaded.payload)
    assert [len(noises) for noises in mixed([free, again]).mixed.model.noise] == [1, 1]


@pytest.mark.parametrize(("rows", "parts"), [(FEWEST_ROWS, 2), (FEWEST_ROWS - 1, 1)])
def test_few_rows_of_a_motion_have_no_noise_of_their_own(rows: int, parts: int) -> None:
    table = np.random.default_rng(1).standard_normal((200 + rows, 3))
    part, few = (lag_products(block, np.arange(len(block)) == 0) for block in (table[:200], table[200:]))
    found = _by_noise([part, few])
    assert len(found) == parts
    np.testing.assert_allclose(sum(each.plain for each in found), table.T @ table)


def test_estimates_stay_where_columns_made_again_still_move_them(
    runs: list[Run], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Here they do by less than a share that any move is above."""
    result = mixed(falling(runs, 0.05))
    assert Examination(mixed=result).moved(result.fit) is not None
    monkeypatch.setattr("gtau.estimation.effects.estimate.NONLINEAR", 1e-9)
    result = mixed(falling(runs, 0.05))
    assert Examination(mixed=result).moved(result.fit) is None


def test_a_torque_constant_that_falls_along_the_runs_has_its_size(runs: list[Run]) -> None:
    def warmer(run: Run) -> np.ndarray:
        along = np.linspace(-0.5, 0.5, len(run.time))[:, None]
        return run.command * (1 + 0.02 * along * [1.0, 0.0])

    assert of_joint(currents(runs, warmer), "gain drift", "left").size == pytest.approx(0.02, rel=0.2)


def test_offsets_that_differ_between_runs_are_no_body_at_the_tool(runs: list[Run]) -> None:
    rms = np.sqrt(np.mean(runs[0].command ** 2, axis=0))
    free, loaded = runs
    shifted = [free, replace(loaded, command=loaded.command + 0.03 * rms * [1.0, -1.0])]
    result = identify(ROBOT, shifted)
    for gain, truth in zip(result.drive_gains.values(), GAINS, strict=True):
        low, high = gain.interval()
        assert low < truth < high
        assert high - low < 0.03 * truth
    effects = {effect.effect for effect in result.effects}
    assert "offset of a run" in effects
    assert "tool bodies" not in effects


def test_elastic_joints_that_lead_backwards_are_left_out(tmp_path: Path) -> None:
    """Drives hold their current from sample to sample, at 250 Hz: with elastic joints the gains are 0.9 % off."""
    logs = {log.stem: log for log in write_tutorial(tmp_path)}
    used = [logs[name] for name in ("empty_1", "empty_2", "loaded_1200g")]
    result = identify(used, robot="five-bar", payload={"loaded_1200g.csv": 1.2})
    assert "elasticity" not in {effect.effect for effect in result.effects}
    for joint, truth in {"left": 2.62, "right": 3.95}.items():
        low, high = result.drive_gains[joint].interval()
        assert low < truth < high
        assert high - low < 0.02 * truth


@pytest.mark.parametrize("name", ["elasticity", "load-dependent friction"])
def test_no_gear_transmits_the_friction_and_the_rotor_of_its_motor(name: str, runs: list[Run]) -> None:
    fit = ML.fit(reduce_runs(ROBOT, runs).system())
    effect = next(effect for effect in EFFECTS if effect.name == name)
    of_motor = [
        parameter.kind == "ia" or (parameter.kind in PLAIN_FRICTION and parameter.body in JOINTS)
        for parameter in fit.system.problem.parameters
    ]
    changed = fit.solution.values.copy()
    changed[: len(of_motor)][of_motor] *= 3.0
    run, window = fit.dataset.windows()[0]
    columns = []
    for values in (fit.solution.values, changed):
        at = FitWindow(replace(fit, solution=replace(fit.solution, values=values)), run, window)
        torques = effect.torques(at)(SimpleNamespace(outputs=slice(None)))
        columns.append(torques / np.abs(torques).max(axis=(0, 1)))  # their scale is a share of the whole torque
    np.testing.assert_allclose(*columns, atol=1e-9)


WRIST = {
    "robot": "wrist",
    "joints": {
        "pitch": {"antecedent": "ground", "axis": [0, 1, 0], "type": "revolute"},
        "roll": {"antecedent": "pitch", "xyz": [0.1, 0, 0], "axis": [1, 0, 0], "type": "revolute"},
    }
    | {
        name: {"antecedent": "ground", "axis": [0, 0, 1], "type": "revolute", "actuated": True, "parameters": "drive"}
        for name in ("motor_1", "motor_2")
    },
    "couplings": [
        {"joint": "motor_1", "ratios": {"pitch": -80}},
        {"joint": "motor_2", "ratios": {"pitch": 30, "roll": 50}},
    ],
}


def test_the_friction_of_a_motor_beside_its_joint_is_no_load(tmp_path: Path) -> None:
    """The friction of 'pitch', which moves at a constant ratio to 'motor_1', is regrouped with the motor's."""
    (tmp_path / "wrist.yaml").write_text(json.dumps(WRIST))
    model = InverseDynamics(load_robot(tmp_path / "wrist.yaml"))
    chi = {"m_roll": 2.0, "mx_roll": 0.2, "my_roll": 0.1, "zz_roll": 0.03, "fs_motor_1": 0.06, "fs_motor_2": 0.05}
    wrist = SensedPlant(model, chi, (0.4, 0.3), (0.0, 0.0), (80.0, 80.0), tool="roll")
    loaded = wrist.run(2, {"m": 1.5, "mx": 0.1}, Payload(name="steel", mass=1.5))
    fit = ML.fit(reduce_runs(model.robot, [wrist.run(1), loaded]).system())
    effect = next(effect for effect in EFFECTS if effect.name == "load-dependent friction")
    run, window = fit.dataset.windows()[0]
    columns = []
    for factor in (1.0, 3.0):
        values = fit.solution.values.copy()
        values[fit.system.problem.parameters.index(Parameter("fs", "motor_1", regrouped=True))] *= factor
        at = FitWindow(replace(fit, solution=replace(fit.solution, values=values)), run, window)
        torques = effect.torques(at)(SimpleNamespace(outputs=slice(None)))
        columns.append(torques / np.abs(torques).max(axis=(0, 1)))
    np.testing.assert_allclose(*columns, atol=1e-9)


def test_columns_of_elastic_joints_move_the_links_without_the_rotors(runs: list[Run]) -> None:
    """Beside the term of rotors alone, ``ia^2 / k``, which both columns hold in part."""
    fit = ML.fit(reduce_runs(ROBOT, runs).system())
    model, base, problem = fit.dataset.model, fit.dataset.base, fit.system.problem
    rotors, stiffness = np.array([0.05, 0.08]), 1e6
    links = {name: 0.1 for name in model.parameter_names if name.kind in ("zz", "mx", "m")}
    chi = links | {Parameter("ia", joint): ia for joint, ia in zip(JOINTS, rotors, strict=True)}
    regrouped = dict(zip(base.names, base.matrix @ [chi.get(name, 0.0) for name in model.parameter_names], strict=True))
    values = fit.solution.values.copy()
    values[: len(problem.parameters)] = [regrouped.get(name, 0.0) for name in problem.parameters]
    run, window = fit.dataset.windows()[0]
    at = FitWindow(replace(fit, solution=replace(fit.solution, values=values)), run, window)

    def torques(*motion: np.ndarray) -> np.ndarray:
        return model.torques(*motion, links)

    motion, rate = (window.q, window.qd, window.qdd), window.run.rate
    before = torques(*motion)
    lead = before / stiffness
    leads = (lead, *differentiate(lead, rate))
    after = torques(*(part - moved for part, moved in zip(motion, leads, strict=True)))
    alone = rotors**2 / stiffness * differentiate(window.qdd, rate)[1]
    every = SimpleNamespace(outputs=slice(None))
    effect = next(effect for effect in EFFECTS if effect.name == "elasticity")
    units = 1e3 * np.concatenate([rms_torques(at.fit), -rotors * fit.dataset.rms_accelerations])
    columns = effect.torques(at)(every) @ (units / stiffness)
    expected = at.decimated((after - before + alone).T[None])(every)[..., 0]
    np.testing.assert_allclose(columns, expected, atol=2e-3 * np.abs(expected).max())


@pytest.mark.parametrize("name", ["encoder zeros", "position scales"])
def test_columns_of_positions_are_slopes_where_passive_joints_reverse(name: str, runs: list[Run]) -> None:
    """Dry friction of passive joints, which reverses at other instants, is in no slope."""
    fit = ML.fit(reduce_runs(ROBOT, runs).system())
    model, every, step = fit.dataset.model, SimpleNamespace(outputs=slice(None)), np.array([1e-7, 0.0])
    effect = next(effect for effect in EFFECTS if effect.name == name)
    for run, window in fit.dataset.windows():
        at, labels = FitWindow(fit, run, window), np.array([""] * len(window))
        q, qd, qdd = window.q + step, window.qd, window.qdd
        if name == "position scales":
            q, qd, qdd = (part * (1 + step) for part in (window.q, window.qd, window.qdd))
        path = model.near(at.motion.c, q.T.copy(), labels)
        change = at.torques_along(model.rates(path, qd.T.copy(), qdd.T.copy(), labels), at.values) - at.unmoved
        unit = 0.01 if name == "position scales" else np.radians(1.0)
        expected = at.decimated(change[None] * unit / step[0])(every)[..., 0]
        np.testing.assert_allclose(effect.torques(at)(every)[..., 0], expected, atol=0.05 * np.abs(expected).max())


def test_presliding_is_found_and_gains_are_right() -> None:
    shapes = {Parameter("width", joint): 0.01 for joint in JOINTS}
    result = estimate_effects(ML.fit(reduce_runs(friction_logs.robot(), friction_logs.experiment(shapes, {})).system()))
    assert result is not None
    first, *_ = estimated_effects(result)
    assert first.effect == "presliding"
    assert first.likelihood > 50
    gains = result.values[result.rows.fit.system.problem.gain_rows]  # without the effect 5 % off
    np.testing.assert_allclose(gains, GAINS, rtol=0.02)


def test_friction_that_levels_off_as_a_joint_warms_up_moves_no_gain(runs: list[Run]) -> None:
    """Coulomb friction that falls by 30 %; as a straight line in time it moves the gain by 0.2 %."""

    def warm(run: Run) -> np.ndarray:
        fallen = 0.3 * Plant().chi["fs_left"] / GAINS[0] * -np.expm1(-3 * run.time / run.time[-1])[:, None]
        return run.command - fallen * np.sign(np.gradient(run.position, run.time, axis=0)) * [1, 0]

    result, healthy = mixed(currents(runs, warm)), mixed(runs)
    rows = result.rows.fit.system.problem.gain_rows
    np.testing.assert_allclose(result.values[rows], healthy.values[rows], rtol=6e-4)


@pytest.mark.parametrize("share", [1e-4, 0.1])
def test_rotors_are_tried_in_load_friction_where_the_data_do_not_tell_them(share: float, tmp_path: Path) -> None:
    arm = robot(tmp_path)
    made, known = replace(plant(arm, noise=0.05), tool="j4"), Payload(name="load", mass=3.0)
    fit = ML.fit(reduce_runs(arm, [made.run(1), made.run(1, {"m": 3.0}, known)]).system())
    unit = rms_torques(fit) / fit.dataset.rms_accelerations
    j, place = arm.actuated.index("j3"), fit.problem.unknowns.places[Parameter("ia", "j3")]
    covariance = fit.solution.covariance.copy()
    covariance[place, place] = (share * unit[j]) ** 2
    fit = replace(fit, solution=replace(fit.solution, covariance=covariance))
    effect = next(effect for effect in EFFECTS if effect.name == "load-dependent friction")
    ((run, window), *_) = fit.dataset.windows()
    columns = effect.torques(FitWindow(fit, run, window))(cast(Any, SimpleNamespace(outputs=slice(None))))
    assert columns[j, :, 0].any()
    assert columns[j, :, 1:].any() == (share > 0.02)


def test_ripple_of_a_gear_has_its_period_and_moves_no_gain(runs: list[Run]) -> None:
    """Of 5 % of the current, 101 times a turn: without the effect it moves the left gain by 0.2 %."""
    size = 0.05 * runs[0].command.std(axis=0) * [1, 0]
    rippled = currents(runs, lambda run: run.command + size * np.sin(101 * run.position))
    effect, result, healthy = of_joint(rippled, "ripple", "left"), mixed(rippled), mixed(runs)
    assert effect.likelihood > 1000
    assert "repeats every 3.57 deg" in effect.subject
    (columns,) = (columns for effect, columns in result.rows.acting if effect.name == "ripple")
    assert "ripple" not in {effect.name for effect, _ in healthy.rows.acting}
    np.testing.assert_allclose(columns[0].waves, [101, 0], atol=0.5)
    rows = result.rows.fit.system.problem.gain_rows
    np.testing.assert_allclose(result.values[rows], healthy.values[rows], rtol=3e-4)


def test_friction_that_differs_between_runs_has_its_size() -> None:
    plant, known = Plant(noise=0.01), Payload(name="steel", mass=STEEL["m"])
    drives = [f"{kind}_{joint}" for kind in ("fv", "fs") for joint in JOINTS]
    chi = {name: value * (1.1 if name in drives else 1.0) for name, value in plant.chi.items()}
    loaded = replace(plant, chi=chi).run("loaded", 10.0, STEEL, seed=2)
    result = mixed([plant.run("free", 10.0, seed=1), replace(loaded, payload=known)])
    fit, places = result.rows.fit, result.rows.fit.system.problem.unknowns.places
    for joint, speed in zip(JOINTS, rms_speeds(fit), strict=True):  # 5 % less than the mean of both runs
        fv, fs = (result.values[places[Parameter(kind, joint, 0)]] for kind in ("fv", "fs"))
        expected = -0.05 * (plant.chi[f"fv_{joint}"] * speed + plant.chi[f"fs_{joint}"])
        assert fv * speed + fs == pytest.approx(expected, rel=0.2)
    assert 0.5 < result.mixed.sizes[-1] < 3.0


def test_an_encoder_zero_is_the_first_cause_with_its_size(runs: list[Run]) -> None:
    shifted = [replace(run, position=run.position + np.array([np.radians(1.0), 0.0])) for run in runs]
    first, *_ = contradictions(mixed(shifted))
    # the position is too large, so taking it off gives the right torques
    assert (first.effect, first.cause.joint) == ("encoder zeros", "left")
    assert first.size == pytest.approx(-1.0, abs=0.3)


@pytest.mark.slow
def test_a_wrong_gear_ratio_is_named(tmp_path: Path) -> None:
    joint, scale = "j2", 1.05
    body = {"m": 1.5, "mx": 0.05, "mz": 0.1}
    made = replace(plant(robot(tmp_path), noise=0.02), tool="j4", gains=(8.0, 9.0, 7.0, 5.0))
    runs = [made.run(1), made.run(2, body, Payload(name="disc", mass=body["m"]))]
    factor = np.where(np.array(made.model.actuated) == joint, scale, 1.0)
    result = identify(robot(tmp_path), [replace(run, position=run.position * factor) for run in runs])
    scales = [effect for effect in result.effects if effect.effect == "position scales"]
    best = max(scales, key=lambda effect: effect.share)
    assert best.cause.joints == (joint,)
    assert best.size == pytest.approx(100 * (1 / scale - 1), rel=0.3)
    assert Grade.CONTRADICTORY in {gain.verdict.outcome for gain in result.drive_gains.values()}


@pytest.mark.parametrize("factor", [pytest.param(0.99, marks=pytest.mark.slow), 1.01])
def test_a_wrong_length_of_the_robot_file_is_found_with_its_size(tmp_path: Path, factor: float) -> None:
    body, gains = {"m": 1.5, "mx": 0.05, "mz": 0.1}, (8.0, 9.0, 7.0, 5.0)
    true = robot(tmp_path)
    made = replace(plant(true, noise=0.005), tool="j4", gains=gains)
    runs = [made.run(1), made.run(2, body, Payload(name="disc", mass=body["m"]))]
    x, y, z = true.joint("j3").placement.position
    longer = replace(true.joint("j3"), placement=Pose((x, y, factor * z)))
    told = replace(true, joints=(*true.joints[:2], longer, *true.joints[3:]))
    fit = ML.fit(reduce_runs(told, runs).system(per_run=True))
    result = estimate_effects(fit)
    assert result is not None
    first, *_ = contradictions(result)
    assert "z of 'j3'" in first.subject
    assert first.size == pytest.approx(1e3 * (1 - factor) * z, rel=0.2)
    for plain, move, truth in zip(fit.gains, first.moves.values(), gains, strict=True):
        assert plain * (1 + move / 100) == pytest.approx(truth, rel=0.004)  # without it up to 0.9 % off
    for gain, truth in zip(identify(told, runs).drive_gains.values(), gains, strict=True):
        low, high = gain.interval() or (0.0, 0.0)
        assert low < truth < high


@pytest.mark.parametrize(("gripped", "lost", "when"), [(2.0, 10.0, "before 2.1 s"), (0.0, 8.5, "after 7.9 s")])
def test_a_payload_that_a_run_carries_in_part_is_named(gripped: float, lost: float, when: str) -> None:
    plant = Plant(noise=0.01)
    carried, empty = (plant.run("loaded", 10.0, body, seed=2) for body in (STEEL, None))
    there = (carried.time >= gripped) & (carried.time < lost)
    part = replace(carried, command=np.where(there[:, None], carried.command, empty.command))
    part = replace(part, payload=Payload(name="steel", mass=STEEL["m"]))
    first, *_ = contradictions(mixed([plant.run("free", 10.0, seed=1), part]))
    assert first.subject == f"a payload that is lighter in run 'loaded' {when}"
    assert first.size == pytest.approx(-1.0, abs=0.1)


def test_healthy_logs_contradict_nothing(runs: list[Run]) -> None:
    result = mixed(runs)
    assert not contradictions(result)
    assert max(effect.share for effect in estimated_effects(result)) < 0.02


def test_intervals_hold_a_random_and_a_model_part(runs: list[Run]) -> None:
    result = identify(ROBOT, falling(runs, 0.02))
    for gain in result.drive_gains.values():
        assert gain.std == pytest.approx(np.hypot(gain.random_std or 0.0, gain.model_std or 0.0))
    assert all(set(effect.moves) == set(JOINTS) for effect in result.effects)


@pytest.mark.parametrize("share", [0.05, pytest.param(0.2, marks=pytest.mark.slow)])
def test_friction_that_falls_along_a_run_contradicts_nothing(share: float) -> None:
    plant, known = Plant(noise=0.01), Payload(name="steel", mass=STEEL["m"])
    logged = []
    for name, payload, seed in (("free", None, 1), ("loaded", STEEL, 2)):
        cold, warm = (
            replace(plant, chi={k: v * (factor if k[:2] in ("fv", "fs") else 1) for k, v in plant.chi.items()}).run(
                name, 10.0, payload, seed=seed
            )
            for factor in (1 + share / 2, 1 - share / 2)
        )
        along = np.linspace(0.0, 1.0, len(cold.time))[:, None]
        logged.append(replace(cold, command=(1 - along) * cold.command + along * warm.command))
    result = identify(ROBOT, [logged[0], replace(logged[1], payload=known)])
    for joint, truth in zip(JOINTS, GAINS, strict=True):
        gain = result.drive_gains[joint]
        assert gain.verdict.outcome in (Grade.GOOD, Grade.WEAK), gain.verdict.sentence
        low, high = gain.interval() or (0.0, 0.0)
        assert low < truth < high


def test_effects_have_names_of_their_own() -> None:
    assert len({effect.name for effect in EFFECTS}) == len(EFFECTS)


@pytest.mark.parametrize("count", [2, 5, 20])
def test_modes_of_a_drift_and_its_differences_have_its_covariance(count: int) -> None:
    expected, modes = run_covariance(count), run_modes(count)
    np.testing.assert_allclose(modes @ modes.T, expected, atol=1e-9 if count <= 8 else 0.2)
    centred = np.eye(count) - 1 / count
    root = difference_root(count)
    np.testing.assert_allclose(root @ root.T, (centred @ expected @ centred)[:-1, :-1], atol=1e-8)


@pytest.mark.parametrize(("name", "plausible"), [("staubli-tx40", 16.0), ("ur10e", 0.5), ("orthoglide", 0.5)])
def test_the_zero_of_a_motor_is_as_uncertain_as_the_zero_of_its_joint(name: str, plausible: float) -> None:
    """Behind a gear of 32, half a degree of the joint is 16 of the motor."""
    model = InverseDynamics(load_robot(name))
    dataset = SimpleNamespace(model=model, robot=model.robot)
    columns = list(
        next(effect for effect in EFFECTS if effect.name == "encoder zeros").columns(
            cast("Any", SimpleNamespace(dataset=dataset))
        )
    )
    assert columns[0].plausible == pytest.approx(plausible)
