"""Friction identified on all samples: the stop operator, the terms that are found, and what predictions gain."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from five_bar_logs import GAINS, JOINTS, five_bar
from friction_logs import PLAIN, experiment, robot, run
from models_to_export import of_equations

import gtau
from gtau.estimation.friction.law import FrictionLaw, PreslidingState
from gtau.estimation.friction.normal_equations import WIDTHS, FrictionJoint
from gtau.estimation.friction.selection import Structure, parameter_columns
from gtau.estimation.regression.rows import FORMULAS, stop
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.parameter import KINDS, Parameter
from gtau.robots.robot import PLAIN_FRICTION

SHAPES = {Parameter("width", "left"): 1.5e-3, Parameter("vs", "right"): 0.2}
VALUES = {"fb_right": 0.6, "fl_left": 0.05}


def walk(rng: np.random.Generator, samples: int) -> np.ndarray:
    """A path that turns at once, goes far, and rests for a while, rounded as by an encoder."""
    steps = rng.normal(size=samples) * rng.choice([0.0, 0.01, 1.0], samples)
    return np.round(np.cumsum(steps) / 0.02) * 0.02


def test_the_stop_operator_is_its_recursion(rng: np.random.Generator) -> None:
    q, widths = walk(rng, 400), np.array([0.05, 0.7, 6.0])
    z = np.array([1.0, -1.0, 0.3])
    found = stop(q, widths, z)
    for k in range(1, len(q)):
        z = np.clip(z + (q[k] - q[k - 1]) / widths, -1, 1)
        np.testing.assert_allclose(found[:, k], z, atol=1e-9)


def test_the_stop_operator_gives_no_energy(rng: np.random.Generator) -> None:
    """Along any path its force takes at least what it may have stored, w / 2."""
    q, widths = np.interp(np.arange(4000) / 10, np.arange(401), walk(rng, 401)), np.array([0.3, 2.0])
    z = stop(q, widths, np.zeros(2))
    work = np.cumsum((z[:, 1:] + z[:, :-1]) / 2 * np.diff(q), axis=1)
    assert (work >= -1e-9).all()
    assert (np.maximum.accumulate(work, axis=1) - work <= widths[:, None] / 2 + 1e-9).all()


def test_blocks_that_overlap_go_on_where_the_last_one_was(rng: np.random.Generator) -> None:
    q, widths = walk(rng, 300), np.array([0.4])
    time = np.arange(300) / 100
    follow, found = PreslidingState(widths), np.zeros((1, 300))
    for begin in range(0, 300, 60):
        part = slice(max(begin - 20, 0), begin + 60)
        found[:, part] = follow(time[part], q[part])
    np.testing.assert_allclose(found, stop(q, widths, np.zeros(1)), atol=1e-12)


@pytest.fixture(scope="module")
def result() -> gtau.Result:
    return gtau.identify(robot(), experiment(SHAPES, VALUES))


def test_terms_and_parameters_are_found(result: gtau.Result) -> None:
    left, right = result.curves["left"], result.curves["right"]
    assert set(left.evidence) == {"presliding", "load"}
    assert set(right.evidence) == {"bent"}
    truth = PLAIN | VALUES | {"width_left": 1.5e-3, "vs_right": 0.2}
    truth = {name: value for name, value in truth.items() if not name.endswith("forearm")}  # passive
    found = {**result.friction_parameters, **result.friction}
    assert {name for name in found if name.body in result.curves} == set(truth)
    for name in truth:
        estimate = found[name]
        low, high = estimate.interval(0.9999)
        assert low <= truth[name] <= high, estimate


@pytest.mark.parametrize("passive", [False, True])
def test_friction_that_differs_between_runs(passive: bool) -> None:
    """Joints rub less as they warm up, passive ones too: gains were 5 % off where only motors were thought to."""
    runs = []
    for k, warmth in enumerate((1.1, 1.05, 0.9, 0.95)):
        values = {
            name: value * (warmth if passive or "forearm" not in name else 1.0)
            for name, value in PLAIN.items()
            if name[:2] in ("fv", "fs")
        }
        runs.append(run(str(k), {}, values, k, loaded=k % 2 == 1, noise=1e-3))
    result = gtau.identify(robot(), runs)
    for joint, truth in zip(JOINTS, GAINS, strict=True):
        gain = result.drive_gains[joint]
        assert gain.value == pytest.approx(truth, abs=3 * gain.std, rel=0)
        assert gain.std < 5e-4 * truth
    for name in ("fv_left", "fs_left", "fv_right", "fs_right"):
        friction = result.friction_parameters[name]
        assert friction.value == pytest.approx(PLAIN[name], abs=3 * friction.std, rel=0)
        assert friction.std < (0.03 if passive else 2e-3) * PLAIN[name]


def test_a_delay_that_stood_for_presliding_is_none(result: gtau.Result) -> None:
    """Currents have no delay; without friction's shape the equations of a joint with presliding find -2 ms."""
    low, high = result.delays["left"].interval(0.9999)
    assert low < 0 < high
    assert high - low < 0.01
    assert result.delays["left"].value > -0.001


def test_friction_has_one_value_a_name(result: gtau.Result) -> None:
    """That with which the model predicts, whose variance the covariance has; that of the equations is evidence."""
    names = result.to_frame()["name"].to_list()
    assert len(names) == len(set(names) | set(result.drive_gains)) + 2 * len(result.drive_gains)
    variances = dict(zip(result.covariance_names, np.diag(result.covariance), strict=True))
    for name, estimate in {**result.friction_parameters, **result.friction}.items():
        assert np.sqrt(variances[name]) == pytest.approx(estimate.std or 0.0)
    assert set(result.equation_friction) == {
        "fl_left",
        *(f"{kind}_{side}" for kind in PLAIN_FRICTION for side in ("left", "right")),
    }
    assert result.equation_friction["fs_left"].value != result.parameters["fs_left"].value


def test_every_sample_is_predicted_better_than_by_the_plain_law(result: gtau.Result) -> None:
    check = run("check", SHAPES, VALUES, seed=7)
    plain = of_equations(result)
    for found, before in zip(result.validate(check), plain.validate(check), strict=True):
        assert found.relative_all < 0.5 * before.relative_all
        assert found.relative_all < 1.2 * found.relative + 0.3
    prediction = result.predict(check)
    assert len(prediction.time) == len(check.time)
    assert prediction.keep.mean() < 0.85 < 0.95 < prediction.valid.mean()


def test_friction_moves_no_gain(result: gtau.Result, monkeypatch: pytest.MonkeyPatch) -> None:
    """Gains, parameters and their intervals are those of an identification without the step."""
    monkeypatch.setattr("gtau.estimation.identify.friction_step", lambda _, estimates: (estimates, {}, {}))
    plain = gtau.identify(robot(), experiment(SHAPES, VALUES))
    assert plain.curves == {}
    assert dict(plain.drive_gains) == dict(result.drive_gains)
    assert dict(plain.parameters) == dict(of_equations(result).parameters)


def test_plain_friction_stays_plain() -> None:
    found = gtau.identify(robot(), experiment({}, {}, seed=11))
    for curve in found.curves.values():
        assert curve.evidence == {}
    assert found.friction == {}


def test_friction_of_a_joint_that_goes_one_way_is_no_offset() -> None:
    """Forwards the two look alike: the equations leave the offset out, and so do the curves."""
    model, time = InverseDynamics(gtau.load_robot("emps")), np.arange(0, 18, 0.002)[:, None]
    w, size = 2 * np.pi * np.array([0.4, 0.9]), np.array([0.004, 0.002])
    q = 0.01 * time - 0.1 + np.sin(w * time) @ (size / w)[:, None]
    qd, qdd = 0.01 + np.cos(w * time) @ size[:, None], -np.sin(w * time) @ (size * w)[:, None]
    chi = {"m_carriage": 95.0, "fv_carriage": 200.0, "fs_carriage": 20.0}
    torque = model.torques(q, qd, qdd, chi) + 0.2 * np.random.default_rng(1).normal(size=time.shape)
    found = gtau.identify(model.robot, [gtau.Run("forwards", model.actuated, time[:, 0], q, torque, kind="torque")])
    assert found.parameters["off_carriage"].value is None
    back = found.torques(q[:100], -qd[:100], 0 * qdd[:100])
    np.testing.assert_allclose(back, -200.0 * qd[:100] - 20.0, rtol=0.01)


def test_a_model_file_holds_the_curves(result: gtau.Result, tmp_path: Path) -> None:
    result.save(tmp_path / "model.json")
    again = gtau.load(tmp_path / "model.json")
    assert again.curves == dict(result.curves)
    assert again.friction_law.shapes == result.friction_law.shapes


def test_friction_of_curves_takes_energy_at_every_speed_and_load(result: gtau.Result, rng: np.random.Generator) -> None:
    model = five_bar()
    law = FrictionLaw(model, {}, result.friction_law.shapes)
    values = {name: each.value or 0.0 for name, each in result.friction_parameters.items()}
    yd, load = 20 * rng.normal(size=(model.layout.n_y, 300)), 200 * rng.normal(size=(2, 300))
    forces, speeds = (np.stack(each) for each in law.forces(np, values, yd, load))
    assert (forces * speeds >= 0).all()


def test_every_friction_term_has_a_formula() -> None:
    terms = [kind for kind in KINDS.values() if kind.friction and kind.friction != "shape" and kind.symbol != "off"]
    assert set(FORMULAS) == {kind.symbol for kind in terms if not kind.slope_of}
    assert {kind.slope_of for kind in terms} - {""} <= set(FORMULAS)


def test_the_first_width_is_a_width() -> None:
    joint = FrictionJoint("j", 0, np.ones(1), 0, 1.0, 1.0, ("off", "fv", "fs"), False)
    v, states = np.array([0.4]), np.arange(2.0, 3.0 + len(WIDTHS))[:, None]
    columns = joint.columns(v, states, 5.0, 0.0)[:, 0]
    assert parameter_columns(Structure(width=float(joint.widths[0])), joint)["fs"] @ columns == states[1]
    assert parameter_columns(Structure(), joint)["fs"] @ columns == states[0]
    assert "fl" not in parameter_columns(Structure(), joint)
    assert parameter_columns(Structure(load=True), joint)["fl"] @ columns == 5.0 * states[0]
