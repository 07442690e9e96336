"""Draws of what was identified: correlated, of rigid bodies, reproducible, and around the truth."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from models_to_export import model_of
from stated_arm import chi, plant, robot, torque_run

from gtau.errors import GtauError
from gtau.export.exported import export_model
from gtau.export.samples import Draws, draw
from gtau.model.home import load_robot
from gtau.result import Result, identify, load
from gtau.robots.parameter import pseudo_inertia
from gtau.robots.robot import INERTIAL

COUNT = 200


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Result:
    true = robot(tmp_path_factory.mktemp("arm"))
    made = plant(true)
    return identify(true, [torque_run(made, 1), torque_run(made, 2)], consistent=True)


@pytest.fixture(scope="module")
def samples(result: Result) -> Draws:
    return draw(result, COUNT, seed=5)


def test_every_draw_is_of_rigid_bodies(samples: Draws) -> None:
    names = list(samples.result.idm.parameter_names)
    for body in samples.result.robot.bodies:
        columns = [names.index(f"{kind}_{body}") for kind in INERTIAL]
        assert min(np.linalg.eigvalsh(pseudo_inertia(values))[0] for values in samples.standard[:, columns]) > 0
    of_drives = [k for k, name in enumerate(names) if name.startswith(("ia_", "fv_", "fs_"))]
    assert samples.standard[:, of_drives].min() >= -1e-9


def test_draws_are_as_wide_and_as_correlated_as_the_result(samples: Draws) -> None:
    result = samples.result
    known = [k for k, name in enumerate(result.base.names) if name in result.covariance_names]
    rows = [result.covariance_names.index(result.base.names[k]) for k in known]
    std = np.sqrt(np.diag(result.covariance)[rows])
    ratio = samples.base[:, known].std(axis=0) / std
    assert 0.75 < np.median(ratio) < 1.2
    expected = result.covariance[np.ix_(rows, rows)] / np.outer(std, std)
    strong = np.triu(np.abs(expected) > 0.8, 1)
    assert strong.any()
    assert np.corrcoef(expected[strong], np.corrcoef(samples.base[:, known].T)[strong])[0, 1] > 0.9


def test_the_truth_lies_within_the_draws(samples: Draws) -> None:
    result = samples.result
    truth = result.base.matrix @ [chi(result.robot).get(name, 0.0) for name in result.idm.parameter_names]
    low, high = np.quantile(samples.base, [0.025, 0.975], axis=0)
    assert np.mean((truth >= low) & (truth <= high)) > 0.8  # benchmarks/sim_to_real.py counts many experiments


@pytest.fixture(scope="module")
def noisy(tmp_path_factory: pytest.TempPathFactory) -> Result:
    true = robot(tmp_path_factory.mktemp("noisy"))
    made = plant(true, noise=3.0)
    return identify(true, [torque_run(made, 1), torque_run(made, 2)], consistent=True)


def test_draws_of_a_weak_result_are_arms(noisy: Result) -> None:
    """Where the logs say little, the mass stays near the file's 15.2 kg, and no draw is far from the estimates."""
    samples = draw(noisy, 60, seed=5)
    names = noisy.idm.parameter_names
    masses = samples.standard[:, [name.startswith("m_") for name in names]].sum(axis=1)
    assert 10 < masses.min() < 15.2 < masses.max() < 25
    assert samples.moved.max() < 1
    assert "all of rigid bodies: the moving mass is" in samples.note
    assert "no draw lies more than 1 outside" in samples.note


def test_what_the_data_leave_open_has_the_files_value_to_30_per_cent(samples: Draws) -> None:
    """No torque depends on the mass of the first link, which turns about the vertical."""
    mass = samples.standard[:, samples.result.idm.parameter_names.index("m_j1")]
    assert mass.mean() == pytest.approx(6.0, rel=0.1)
    assert mass.std() == pytest.approx(0.3 * 6.0, rel=0.2)


@pytest.mark.parametrize(("off", "drawn"), [(100.0, True), (100_000.0, False)])
def test_an_estimate_that_no_bodies_have_is_said(result: Result, off: float, drawn: bool) -> None:
    name = next(name for name in result.parameters if name.startswith("yy_j3"))
    true = result.parameters[name]
    false = replace(true, value=true.value - off * true.std)
    changed = result.replaced(parameters={**result.parameters, name: false})
    if not drawn:
        with pytest.raises(GtauError, match="no rigid bodies near the robot file"):
            draw(changed, 5)
        return
    samples = draw(changed, 5)
    assert samples.moved_share == 1
    assert "100 % of the draws lie more than 1 standard deviation outside" in samples.note
    assert "do not use the draws" in samples.note


def test_a_model_file_gives_the_same_draws(result: Result, tmp_path: Path) -> None:
    result.save(tmp_path / "model.json")
    read = load(tmp_path / "model.json")
    assert dict(read.robot.inertias) == dict(result.robot.inertias)
    np.testing.assert_allclose(draw(read, 2, 1).standard, draw(result, 2, 1).standard, rtol=1e-6, atol=1e-9)


def test_a_seed_gives_the_same_draws(result: Result, samples: Draws) -> None:
    again, other = draw(result, 3, seed=5), draw(result, 3, seed=6)
    np.testing.assert_array_equal(again.npz(), draw(result, 3, seed=5).npz())
    assert not np.allclose(again.base, other.base)
    loaded = np.load(io.BytesIO(samples.npz()))
    assert loaded["standard"].shape == (COUNT, len(loaded["standard_names"]))
    np.testing.assert_allclose(loaded["base"], loaded["standard"] @ result.base.matrix.T)


def test_draws_become_models(result: Result, tmp_path: Path) -> None:
    exported = export_model(result, "mjcf", tmp_path, samples=4, models=2, seed=1)
    names = [str(path.relative_to(tmp_path)) for path in exported.files]
    assert names == ["stated_arm.xml", "samples.npz", "samples/0000/stated_arm.xml", "samples/0001/stated_arm.xml"]
    masses = [mujoco.MjModel.from_xml_path(str(tmp_path / name)).dof_frictionloss for name in names if "xml" in name]
    assert not np.allclose(masses[1], masses[2])
    assert "4 draws of the identified model (seed 1)" in exported.notes[-1]
    assert 0 <= exported.figures["moved_share"] <= 1


def test_what_cannot_be_drawn_is_refused(tmp_path: Path) -> None:
    with pytest.raises(GtauError, match="identify it with --consistent"):
        draw(model_of(load_robot("five-bar"), consistent=False), 3)
    with pytest.raises(GtauError, match="leave out --samples"):
        export_model(model_of(load_robot("five-bar")), "csv", tmp_path, samples=3)
    with pytest.raises(GtauError, match="the number of samples is -1"):
        draw(model_of(load_robot("five-bar")), -1)
