"""Physically consistent parameters: bodies that can exist, close to what the data say."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from five_bar_logs import CHI, EXPERIMENT, GAINS, JOINTS, STEEL, Plant, write_log
from typer.testing import CliRunner

from gtau.cli.commands import app
from gtau.errors import GtauError
from gtau.estimation.estimators.physical_consistency import (
    LAST_OVERHANG,
    MARGIN,
    OVERHANG,
    Body,
    Consistency,
    constrained_least_squares,
    unbounded,
)
from gtau.export.consistent import consistent_model
from gtau.model.home import load_robot
from gtau.result import Result, identify, load
from gtau.robots.geometry import extent, longest_placement
from gtau.robots.parameter import BASIS, ball_row, pseudo_inertia
from gtau.robots.robot import INERTIAL
from gtau.signals.reading.statements import Payload, Prior
from gtau.signals.run import Run

FIVE_BAR = load_robot("five-bar")
KNOWN = Payload(name="steel", mass=STEEL["m"])
BODY = Body("body", np.arange(10), np.zeros(10))


def logs(plant: Plant) -> list[Run]:
    free = plant.run("free", 6.0, seed=1)
    loaded = plant.run("loaded", 6.0, STEEL, seed=2)
    return [free, replace(loaded, payload=KNOWN)]


@pytest.fixture(scope="module")
def runs() -> list[Run]:
    return logs(Plant(noise=0.05))


@pytest.fixture(scope="module")
def result(runs: list[Run]) -> Result:
    return identify(FIVE_BAR, runs, consistent=True)


def found(result: Result) -> Consistency:
    assert result.consistency is not None
    return result.consistency


# The cone


def test_pseudo_inertia_of_points(rng: np.random.Generator) -> None:
    masses, points = rng.uniform(0.1, 1.0, 7), rng.normal(size=(7, 3))
    x, y, z = points.T
    kinds = {
        "xx": masses @ (y**2 + z**2), "yy": masses @ (x**2 + z**2), "zz": masses @ (x**2 + y**2),
        "xy": -masses @ (x * y), "xz": -masses @ (x * z), "yz": -masses @ (y * z),
        "mx": masses @ x, "my": masses @ y, "mz": masses @ z, "m": masses.sum(),
    }  # fmt: skip
    ends = np.column_stack([points, np.ones(7)])
    expected = np.einsum("k,ki,kj->ij", masses, ends, ends)
    np.testing.assert_allclose(pseudo_inertia(np.array([kinds[kind] for kind in INERTIAL])), expected, rtol=1e-12)


def test_mass_within_a_ball(rng: np.random.Generator) -> None:
    masses, points, centre, radius = rng.uniform(0.1, 1.0, 7), rng.normal(size=(7, 3)), rng.normal(size=3), 0.8
    ends = np.column_stack([points, np.ones(7)])
    J = np.einsum("k,ki,kj->ij", masses, ends, ends)
    values = np.linalg.lstsq(BASIS.reshape(10, 16).T, J.ravel(), rcond=None)[0]
    expected = masses @ (radius**2 - np.sum((points - centre) ** 2, axis=1))
    assert ball_row(centre, radius) @ values == pytest.approx(expected)


def test_no_body_reaches_further_than_its_joints_allow(result: Result) -> None:
    standard, bound = found(result).standard, []
    for body in FIVE_BAR.bodies:
        values = np.array([standard[f"{kind}_{body}"] for kind in INERTIAL])
        centre, radius, ends = extent(FIVE_BAR, body)
        reach = radius + (LAST_OVERHANG if ends else OVERHANG) * longest_placement(FIVE_BAR)
        J = pseudo_inertia(values)
        about = np.trace(J[:3, :3]) - 2 * centre @ J[:3, 3] + centre @ centre * J[3, 3]
        bound.append(np.sqrt(about / J[3, 3]) / reach)
    assert max(bound) <= 1 + 1e-6


def test_the_nearest_body_in_the_frobenius_norm_has_its_eigenvalues_cut(rng: np.random.Generator) -> None:
    # |R x - y| is the distance between pseudo-inertias, and the nearest positive matrix is known in closed form.
    half = rng.normal(size=(4, 4))
    wanted = half + half.T
    R = BASIS.reshape(10, 16).T
    x = constrained_least_squares(R, wanted.ravel(), unbounded([BODY], np.ones(10), 1.0, 1.0))
    values, vectors = np.linalg.eigh(wanted)
    nearest = vectors @ np.diag(np.maximum(values, MARGIN)) @ vectors.T
    np.testing.assert_allclose(pseudo_inertia(x), nearest, atol=1e-6)


def test_scales_of_the_solver_do_not_change_the_answer(rng: np.random.Generator) -> None:
    R, y = rng.normal(size=(14, 10)), rng.normal(size=14)
    upper = np.append(np.full(9, np.inf), 0.7)
    answers = [
        constrained_least_squares(R, y, replace(unbounded([BODY], unit, mass, length), upper=upper))
        for unit, mass, length in ((np.ones(10), 1.0, 1.0), (np.geomspace(0.03, 30.0, 10), 3.0, 0.4))
    ]
    np.testing.assert_allclose(answers[0], answers[1], atol=2e-4)


def test_bounds_that_no_body_meets_are_refused() -> None:
    upper = np.append(np.full(9, np.inf), -1.0)
    with pytest.raises(GtauError, match="no rigid bodies"):
        constrained_least_squares(
            np.eye(10), np.ones(10), replace(unbounded([BODY], np.ones(10), 1.0, 1.0), upper=upper)
        )


# A robot


def test_every_body_can_exist_and_friction_dissipates(result: Result) -> None:
    consistency = found(result)
    assert set(consistency.eigenvalues) == {*FIVE_BAR.bodies, "L2"}
    assert min(consistency.eigenvalues.values()) > 0
    for name, value in consistency.standard.items():
        if name.split("_")[0] in ("ia", "fv", "fs"):
            assert value >= -1e-8
    assert consistency.payloads["L2"]["m"] == KNOWN.mass


def test_the_standard_parameters_regroup_to_what_moved(result: Result) -> None:
    consistency = found(result)
    chi = np.array([consistency.standard[name] for name in result.idm.parameter_names])
    regrouped = dict(zip(result.base.names, result.base.matrix @ chi, strict=True))
    moves = {move.name: move for move in consistency.moves}
    for name in result.parameters:
        move = moves[name]
        assert regrouped[name] == pytest.approx(move.consistent, abs=1e-7)
        estimate = result.equation_friction.get(
            name, result.parameters[name]
        )  # which the equations are made consistent of
        assert move.free == estimate.value
        assert estimate.std is not None
        assert move.deviations == pytest.approx(abs(move.consistent - move.free) / estimate.std)
    assert [m.deviations for m in consistency.moves] == sorted((m.deviations for m in consistency.moves), reverse=True)


def test_a_robot_that_can_exist_moves_little(result: Result) -> None:
    consistency = found(result)
    assert max(consistency.loss.values()) < 1.0
    for joint, truth in zip(JOINTS, GAINS, strict=True):
        gain, std = consistency.gains[joint]
        assert abs(gain - truth) < 4 * std
        assert std == result.drive_gains[joint].std
    assert consistency.moves[0].deviations < 3.0


def test_a_robot_that_cannot_exist_is_noticed(runs: list[Run]) -> None:
    impossible = {**CHI, "fs_left_forearm": -0.3}
    consistency = found(identify(FIVE_BAR, logs(Plant(noise=0.01, chi=impossible)), consistent=True))
    deviations = {move.name.rstrip("R"): move.deviations for move in consistency.moves}
    assert deviations["fs_left_forearm"] > 10
    assert consistency.standard["fs_left_forearm"] >= -1e-8
    assert max(consistency.loss.values()) > 1.0


def test_given_gains_stay(runs: list[Run]) -> None:
    gains = dict(zip(JOINTS, GAINS, strict=True))
    consistency = found(identify(FIVE_BAR, runs, method="wls", prior_gains=gains, consistent=True))
    for joint, truth in gains.items():
        assert consistency.gains[joint] == (pytest.approx(truth), 0.0)
    assert not any(move.name.startswith("gain") for move in consistency.moves)
    assert min(consistency.eigenvalues.values()) > 0


def test_priors_and_bounds_decide_what_the_data_leave_open(runs: list[Run]) -> None:
    priors = {"m_left": Prior(value=2.0, std=0.01), "yy_right": Prior(min=0.5, max=0.6)}
    consistency = found(identify(FIVE_BAR, runs, consistent=True, priors=priors))
    assert "yy_right" in consistency.open
    assert consistency.standard["m_left"] == pytest.approx(2.0, abs=0.03)
    assert 0.5 <= consistency.standard["yy_right"] <= 0.6 + 1e-6
    with pytest.raises(GtauError, match="'m_wrist', which is no parameter of the robot"):
        identify(FIVE_BAR, runs, consistent=True, priors={"m_wrist": Prior(max=1.0)})


def test_a_search_that_finds_no_bodies_is_a_finding_beside_the_result(runs: list[Run], result: Result) -> None:
    one_axis = {"xx_left": Prior(min=1.0), "yy_left": Prior(max=0.1), "zz_left": Prior(max=0.1)}
    other = identify(FIVE_BAR, runs, consistent=True, priors=one_axis)
    assert other.consistency is None
    assert "no physically consistent parameters" in [note.kind for note in other.notes]
    assert other.drive_gains == result.drive_gains
    assert (other.believable, other.accepted) == (True, False)
    assert "check the bounds" in other.summary(verbose=False)
    with pytest.raises(GtauError, match=r"were not found: no rigid bodies .* check the bounds"):
        consistent_model(other, "URDF")


def test_without_the_solver_one_sentence_says_what_to_install(runs: list[Run], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "clarabel", None)
    with pytest.raises(GtauError, match=r"gtau\[consistency\]"):
        identify(FIVE_BAR, runs, consistent=True)


def test_from_file_to_model_and_back(tmp_path: Path) -> None:
    plant = Plant(noise=0.02)
    for name, payload, seed in (("free", None, 1), ("loaded", STEEL, 2), ("check", STEEL, 3)):
        write_log(tmp_path / f"{name}.csv", plant.run(name, 6.0, payload, seed))
    experiment = tmp_path / "experiment.yaml"
    experiment.write_text(EXPERIMENT + "priors:\n  m_left: {min: 1.5}\n")
    answer = CliRunner().invoke(app, ["identify", str(experiment), "--consistent", "--out", str(tmp_path)])
    assert answer.exit_code == 0, answer.stderr
    assert "Physically consistent" in answer.stdout
    document = json.loads((tmp_path / "model.json").read_text())["standard"]
    values = {each["name"]: each["value"] for each in document["parameters"]}
    assert values["m_left"] >= 1.5 - 1e-6
    loaded = found(load(tmp_path / "model.json"))
    assert dict(loaded.standard) == values
    assert loaded.moves[0].deviations >= loaded.moves[-1].deviations
    load(tmp_path / "model.json").save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_text() == (tmp_path / "model.json").read_text()


def test_incomplete_priors_are_refused(tmp_path: Path) -> None:
    for prior, sentence in (("{value: 1.0}", "together"), ("{min: 2, max: 1}", "write the smaller one")):
        experiment = tmp_path / "experiment.yaml"
        for name in ("free", "loaded", "check"):
            (tmp_path / f"{name}.csv").touch()
        experiment.write_text(EXPERIMENT + f"priors:\n  m_left: {prior}\n")
        answer = CliRunner().invoke(app, ["identify", str(experiment), "--consistent"])
        assert answer.exit_code == 2
        assert sentence in answer.stderr


# Measured and simulated logs


@pytest.mark.slow
@pytest.mark.parametrize("name", ["orthoglide", "ur10e"])
def test_the_loss_on_the_shared_logs_is_small(name: str, shared: Path, tmp_path: Path) -> None:
    experiment = tmp_path / "experiment.yaml"
    experiment.write_text((ORTHOGLIDE if name == "orthoglide" else UR10E).format(shared=shared))
    result = identify(experiment, consistent=True)
    consistency = found(result)
    assert min(consistency.eigenvalues.values()) > 0
    growth = np.array(list(consistency.loss.values()))
    assert np.sqrt(np.mean((1 + growth / 100) ** 2)) < 1.01
    for joint, (gain, std) in consistency.gains.items():
        free = result.drive_gains[joint]
        assert abs(gain - (free.value or 0.0)) < 0.5 * std
        assert std == free.std


ORTHOGLIDE = """\
robot: orthoglide
signals: {{time: t, position: {{11: q11, 12: q12, 13: q13}}, current: {{11: v1, 12: v2, 13: v3}}}}
runs:
  - {{log: {shared}/orthoglide_sim/exciting_1_unloaded.csv}}
  - {{log: {shared}/orthoglide_sim/exciting_2_unloaded.csv}}
  - {{log: {shared}/orthoglide_sim/exciting_3_loaded_1983g.csv, payload: {{name: steel, mass: 1.983}}}}
"""
UR10E = """\
robot: {shared}/ur10e/ur10e.urdf
signals:
  time: 1
  position: {{shoulder_pan_joint: 2, shoulder_lift_joint: 3, elbow_joint: 4, wrist_1_joint: 5, wrist_2_joint: 6,
    wrist_3_joint: 7}}
  current: {{shoulder_pan_joint: 14, shoulder_lift_joint: 15, elbow_joint: 16, wrist_1_joint: 17, wrist_2_joint: 18,
    wrist_3_joint: 19}}
runs:
  - {{log: {shared}/ur10e/ur-20_02_19_14harm50sec.csv}}
  - {{log: {shared}/ur10e/ur-20_02_19_14harm50secLoad.csv, payload: {{name: block, mass: 2.805}}}}
"""
