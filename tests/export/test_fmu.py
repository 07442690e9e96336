"""Exported FMUs, run by FMPy, beside the model in Python."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from models_to_export import model_of, preslid, torques
from robots_for_tests import home, tree

from gtau.documents.files import suffixes
from gtau.export.generated import export_fmu as export
from gtau.model.home import load_robot
from gtau.robots.robot import Robot
from gtau.uses.identified import identified

fmpy = pytest.importorskip("fmpy")
validate_fmu = pytest.importorskip("fmpy.validation").validate_fmu
pytest.importorskip("pythonfmu3")


@pytest.mark.parametrize("robot", [tree(), load_robot("five-bar")], ids=lambda robot: robot.name)
def test_fmpy_runs_the_model(robot: Robot, tmp_path: Path) -> None:
    result = model_of(robot)
    (path,) = export(result, tmp_path).files
    assert not validate_fmu(str(path))
    description = fmpy.read_model_description(str(path))
    assert description.fmiVersion == "3.0"
    assert "Outputs at the end of a step belong to the inputs at its start." in description.description
    model = identified(result)
    names = list(suffixes(model.joints).values())
    units = {each.name: (each.unit, (each.description or "").split(", ")[-1]) for each in description.modelVariables}
    for name, joint, unit in zip(names, model.joints, model.units, strict=True):
        length = "rad" if robot.joint(joint).kind == "revolute" else "m"
        for what, expected in (("q", length), ("qd", f"{length}/s"), ("qdd", f"{length}/s2"), ("torque", unit)):
            assert units[f"{what}_{name}"] == (expected, expected)
        assert units[f"current_{name}"] == ("A", "A")
    seconds = {each.name: each.baseUnit.s for each in description.unitDefinitions}
    assert {unit: power for unit, power in seconds.items() if power} == {
        unit: -1 if unit.endswith("/s") else -2 for unit in seconds if unit not in ("rad", "m", "A")
    }
    home = np.array([joint.home for joint in robot.joints if joint.actuated])
    time = np.arange(0, 0.1, 1e-3)
    phase = time[:, None] * 5 + np.arange(len(names)) + 0.3
    q, qd, qdd = home + 0.05 * np.sin(phase), 0.25 * np.cos(phase), -1.25 * np.sin(phase)
    columns = [(f"{what}_{name}", float) for what in ("q", "qd", "qdd") for name in names]
    signals = np.zeros(len(time), dtype=[("time", float), *columns])
    signals["time"] = time
    for what, values in (("q", q), ("qd", qd), ("qdd", qdd)):
        for j, name in enumerate(names):
            signals[f"{what}_{name}"] = values[:, j]
    outputs = [f"{what}_{name}" for what in ("torque", "current") for name in names]
    for payload, values in ((0, model.values), (1, model.payloads["tool 2"])):
        found = fmpy.simulate_fmu(
            str(path), stop_time=0.099, step_size=1e-3, output_interval=1e-3, input=signals,
            start_values={"payload": payload}, output=[*outputs, "status"],
        )  # fmt: skip
        assert not found["status"].any()
        expected = torques(model, q, qd, qdd, values)
        # an output is that of the inputs at the start of its step
        for j, name in enumerate(names):
            tolerance = 1e-9 * np.abs(expected).max()
            np.testing.assert_allclose(found[f"torque_{name}"][1:100], expected[:99, j], atol=tolerance)
            currents = expected[:99, j] / model.gains[j]
            np.testing.assert_allclose(found[f"current_{name}"][1:100], currents, atol=tolerance)
    signals[f"q_{names[0]}"][50] = np.nan
    found = fmpy.simulate_fmu(
        str(path), stop_time=0.099, step_size=1e-3, output_interval=1e-3, input=signals, output=[*outputs, "status"]
    )
    assert set(found["status"]) == {0, 3}
    assert all(np.isfinite(found[name]).all() for name in outputs)


def test_a_payload_that_does_not_exist_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (path,) = export(model_of(load_robot("five-bar")), tmp_path).files
    with pytest.raises(fmpy.fmi1.FMICallException):
        fmpy.simulate_fmu(str(path), stop_time=1e-3, step_size=1e-3, start_values={"payload": 7})
    captured = capfd.readouterr()
    assert "payload is 7; choose from 0 (none), 1 (tool 2)" in captured.out + captured.err


def test_a_joint_that_moves_at_the_start_slides(tmp_path: Path) -> None:
    robot = load_robot("five-bar")
    result = preslid(model_of(robot, terms=False))
    (path,) = export(result, tmp_path).files
    model = identified(result)
    names, q = (
        list(suffixes(model.joints).values()),
        home(robot)[None],
    )
    start = {f"qd_{name}": 0.5 for name in names}
    found = fmpy.simulate_fmu(str(path), stop_time=1e-3, step_size=1e-3, start_values=start,
                              output=[f"torque_{name}" for name in names])  # fmt: skip
    expected = torques(model, q, 0.5 + 0 * q, 0 * q)[0]
    np.testing.assert_allclose([found[f"torque_{name}"][0] for name in names], expected, rtol=1e-9)
