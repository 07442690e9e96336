"""Names of robots, joints and payloads that the program of an export takes for something else."""

from __future__ import annotations

import ast
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from zipfile import ZipFile

import numpy as np
import pytest
from models_to_export import model_of

from gtau.export.exported import export_model
from gtau.export.generated import in_matlab
from gtau.robots.parameter import parameter_of
from gtau.robots.robot import Joint, Pose, Robot
from gtau.signals.reading.logs import read_log
from gtau.signals.run import Run
from gtau.simulation.closed_loop import write_log
from gtau.simulation.trajectories import log_column


def arm(name: str = "arm", joint: str = "a") -> Robot:
    first = Joint(joint, "ground", "revolute", Pose(), actuated=True)
    return Robot(name, (first, Joint("b", joint, "revolute", Pose(xyz=(0.3, 0.0, 0.0)), actuated=True)))


@pytest.mark.parametrize("kind", ["mjcf", "mjlab", "mujoco-actuators"])
@pytest.mark.parametrize("platform", ["b", "world_"])
def test_a_joint_may_have_the_name_of_mujoco_s_ground(kind: str, platform: str, tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    robot = arm(joint="world")
    robot = replace(robot, joints=(robot.joints[0], replace(robot.joints[1], name=platform)))
    files = [file for file in export_model(model_of(robot), kind, tmp_path).files if file.suffix == ".xml"]
    model = mujoco.MjModel.from_xml_path(str(files[0]))
    assert [model.joint(k).name for k in range(2)] == ["world", platform]
    assert model.body(0).name == "world"


@pytest.mark.parametrize("name", ["return", "lambda", "json", "casadi", "\N{ROBOT FACE}"])
def test_a_robot_may_be_called_as_what_python_reserves(name: str, tmp_path: Path) -> None:
    pytest.importorskip("pythonfmu3")
    (file,) = export_model(model_of(arm(name, name)), "fmu", tmp_path).files
    with ZipFile(file) as archive:
        script = next(member for member in archive.namelist() if member.endswith(f"{file.stem}.py"))
        source = archive.read(script).decode()
    ast.parse(source)
    assert file.stem.startswith("robot_")
    assert f"Inverse dynamics of {name}" in source


@pytest.mark.skipif(not shutil.which("cc"), reason="needs a C compiler")
@pytest.mark.parametrize("name", ["features", "all", "install", "test"])
def test_a_robot_may_be_called_as_what_compilers_and_cmake_reserve(name: str, tmp_path: Path) -> None:
    export_model(model_of(arm(name)), "c", tmp_path)
    sources = [path.name for path in tmp_path.glob("*.c")]
    subprocess.run(["cc", "-std=c99", "-I.", "-fsyntax-only", *sources], cwd=tmp_path, check=True)
    if shutil.which("cmake"):
        subprocess.run(["cmake", "-S", ".", "-B", "build"], cwd=tmp_path, check=True, capture_output=True)


def test_a_line_break_ends_no_text_of_matlab() -> None:
    assert in_matlab("a'\nb\u2028c") == "'a'' b c'"


@pytest.mark.parametrize("name", ["a;b", 'a"b', '"a"', '"', "'a'", "a ", " a", "a,b", 'a;b,c"d ', "#a", "nan", "-1"])
def test_logs_of_joints_of_any_name_are_read(name: str, tmp_path: Path) -> None:
    time, values = np.arange(100) / 100.0, np.arange(200.0).reshape(100, 2)
    write_log(Run("run", (name, "b"), time, values, -values), tmp_path / "log.csv")
    columns = [log_column(letter, joint) for letter in "qv" for joint in (name, "b")]
    read = read_log(tmp_path / "log.csv", ("t", *columns)).arrays()
    assert np.array_equal(np.column_stack([read[column] for column in columns]), np.hstack([values, -values]))


def test_a_name_with_an_at_is_no_run() -> None:
    assert parameter_of("zz_a@b").body == "a@b"
    assert parameter_of("fs_a@2").run == 1
