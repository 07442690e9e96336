"""Robots with loops in files that are trees: what is lost is said, and the inertia at the motors is right."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml
from models_to_export import model_of

from gtau.export.consistent import consistent_model, motor_inertias
from gtau.export.exported import export_model
from gtau.model.home import load_robot
from gtau.result import Result


@pytest.fixture(scope="module")
def five_bar() -> Result:
    return model_of(load_robot("five-bar"), terms=False)


@pytest.mark.parametrize("kind", ["isaaclab", "urdf"])
def test_a_lost_loop_is_said_first(five_bar: Result, kind: str, tmp_path: Path) -> None:
    exported = export_model(five_bar, kind, tmp_path)
    assert exported.lost == exported.notes[0]
    assert "the files lack 1 closure ('" in exported.lost
    assert sum("OPEN TREE" in note for note in exported.notes) == 1
    drives = yaml.safe_load((tmp_path / "five_bar_drives.yaml").read_text())
    assert set(drives["serial_equivalent"]) == set(five_bar.robot.actuated)
    if kind == "isaaclab":
        text = exported.files[0].read_text()
        assert "OPEN TREE" in text.split("timestep:")[0]
        assert yaml.safe_load(text)["serial_equivalent"] == drives["serial_equivalent"]


def test_serial_robots_and_files_with_loops_lose_nothing(five_bar: Result, tmp_path: Path) -> None:
    exported = export_model(five_bar, "mjlab", tmp_path / "mjlab")
    assert exported.lost == ""
    assert mujoco.MjModel.from_xml_path(str(exported.files[1])).neq == 1
    serial = export_model(model_of(load_robot("puma560"), terms=False), "urdf", tmp_path / "urdf")
    assert serial.lost == ""


def test_the_inertia_at_the_motors_is_that_of_mujoco(five_bar: Result, tmp_path: Path) -> None:
    """MuJoCo has the loop as a constraint: its mass matrix, projected onto the motions that keep the loop closed."""
    (path,) = export_model(five_bar, "mjcf", tmp_path).files
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    M = np.zeros((model.nv, model.nv))
    for column, unit in zip(M, np.eye(model.nv), strict=True):
        mujoco.mj_mulM(model, data, column, unit)
    rows = data.efc_J.reshape(-1, model.nv)[data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY]
    motors = [model.joint(joint).dofadr[0] for joint in five_bar.robot.actuated]
    passive = [k for k in range(model.nv) if k not in motors]
    J = np.zeros((model.nv, len(motors)))
    J[motors] = np.eye(len(motors))
    J[passive] = -np.linalg.lstsq(rows[:, passive], rows[:, motors], rcond=None)[0]
    found = motor_inertias(consistent_model(five_bar, "a test"))
    np.testing.assert_allclose(found[0], J.T @ M @ J, rtol=1e-6)
    assert found[:, 0, 0].min() < found[0, 0, 0] < found[:, 0, 0].max()
