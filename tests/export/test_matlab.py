"""Exported function files, run by GNU Octave, beside the model in Python."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from models_to_export import model_of, sprung, torques
from robots_for_tests import ROBOTS, random_samples

from gtau.export.generated import export_matlab as export
from gtau.result import Result
from gtau.robots.robot import Robot
from gtau.uses.identified import identified

OCTAVE = shutil.which("octave-cli") or shutil.which("octave")
pytestmark = pytest.mark.skipif(OCTAVE is None, reason="GNU Octave is not installed (Debian: apt install octave)")
QUICK = ("sprung", "ur10e", "five-bar", "slider-crank")


def octave(folder: Path, script: str) -> np.ndarray:
    """Run a script in the folder of the files; it prints numbers with ``show``."""
    show = "show = @(x) printf('%.17g\\n', x);\n"
    command = [OCTAVE, "--no-gui", "--norc", "--quiet", "--eval", show + script]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120)
    assert not done.returncode, done.stderr
    return np.array([float(line) for line in done.stdout.split()])


def vector(values: np.ndarray) -> str:
    return "[" + " ".join(repr(float(value)) for value in values) + "].'"


@pytest.mark.parametrize(
    "robot",
    [
        pytest.param(robot, marks=() if robot.name in QUICK else pytest.mark.slow, id=robot.name)
        for robot in (*ROBOTS, sprung())
    ],
)
def test_octave_gives_what_python_gives(robot: Robot, tmp_path: Path, rng: np.random.Generator) -> None:
    result: Result = model_of(robot)
    export(result, tmp_path)
    model = identified(result)
    name, n, n_p = model.name, len(model.joints), len(model.parameters)
    q, qd, qdd = random_samples(robot, rng, 2)
    qd[1, 0] = 0.0  # a zero among the inputs is a zero
    script = f"model = {name}_parameters(); p = model.p; show(p);\n"
    for k in range(2):
        state = f"{vector(q[k])}", f"{vector(qd[k])}", f"{vector(qdd[k])}"
        script += (
            f"[c, status] = {name}_start({state[0]}); show(status); [c, status] = {name}_move(c, {state[0]});"
            f"show(status); qd = {state[1]}; qdd = {state[2]};"
            f"show({name}_torques(c, qd, qdd, p)); show({name}_currents(c, qd, qdd, p));"
            f"show({name}_gravity(c, p)); show({name}_friction(c, qd, qdd, p));"
            f"show({name}_friction(c, 0 * qd, 0 * qdd, p));"
            f"show({name}_inertia(c, p) * qdd); show({name}_regressor(c, qd, qdd, p) * p);\n"
        )
    found = octave(tmp_path, script)
    np.testing.assert_array_equal(found[:n_p], model.values)
    expected, still = torques(model, q, qd, qdd), torques(model, q, 0 * qd, 0 * qdd)
    for k, block in enumerate(found[n_p:].reshape(2, 2 + 7 * n)):
        assert not block[:2].any()
        tau, current, gravity, friction, offsets, inertial, product = block[2:].reshape(7, n)
        tolerance = 1e-12 * np.abs(expected[k]).max()
        np.testing.assert_allclose(tau, expected[k], atol=tolerance, rtol=0)
        np.testing.assert_allclose(current * model.gains, expected[k], atol=tolerance, rtol=0)
        np.testing.assert_allclose(gravity + offsets, still[k], atol=tolerance, rtol=0)
        np.testing.assert_allclose(product, expected[k], atol=10 * tolerance, rtol=0)
        assert np.isfinite(inertial).all()
        assert np.abs(friction).max() > 0


@pytest.mark.parametrize("name", ["five-bar", "ur10e"])
def test_a_position_that_is_no_number_has_the_status_of_c(name: str, tmp_path: Path) -> None:
    robot = next(robot for robot in ROBOTS if robot.name == name)
    export(model_of(robot), tmp_path)
    its = robot.name.replace("-", "_")
    script = f"model = {its}_parameters(); [c, s] = {its}_start(model.home);"
    for wrong in ("NaN", "Inf"):
        script += f"q = model.home; q(1) = {wrong}; [d, t] = {its}_move(c, q); [e, u] = {its}_start(q);"
        script += "show([s t u isequal(c, d) all(isfinite(e))]);"
    np.testing.assert_array_equal(octave(tmp_path, script), [0, 3, 3, 1, 1] * 2)


def test_a_pose_out_of_reach_has_a_status(tmp_path: Path) -> None:
    robot = next(robot for robot in ROBOTS if robot.name == "five-bar")
    export(model_of(robot), tmp_path)
    script = "model = five_bar_parameters(); [c, s] = five_bar_start(model.home); [d, t] = five_bar_move(c, [pi; 0]);"
    np.testing.assert_array_equal(octave(tmp_path, script + "show([s t isequal(c, d)])"), [0, 1, 1])
