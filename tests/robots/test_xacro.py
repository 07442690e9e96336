"""Xacro files: expanded with arguments and packages, and their expressions read without executing them."""

from __future__ import annotations

import builtins
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from gtau.cli.commands import app
from gtau.errors import GtauError
from gtau.model.home import load_robot
from gtau.robots.robot import Pose, Robot
from gtau.signals.reading.drafting import Stated, draft_logs, draft_text
from gtau.signals.reading.experiment import read_experiment

pytest.importorskip("xacrodoc")
MACRO = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:macro name="body" params="name mass">
    <link name="${name}"><inertial><mass value="${mass}"/><origin xyz="0 0 ${lengths.upper/2}"/>
      <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  </xacro:macro>
</robot>"""
ARM = """<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="prefix" default=""/>
  <xacro:arg name="heavy" default="false"/>
  <xacro:property name="lengths" value="${xacro.load_yaml('$(find arm_description)/config/lengths.yaml')}"/>
  <xacro:include filename="$(find arm_description)/urdf/macro.xacro"/>
  <xacro:property name="prefix" value="$(arg prefix)"/>
  <link name="base"/>
  <xacro:body name="${prefix}upper" mass="${2.5 if '$(arg heavy)' == 'true' else 1}"/>
  <joint name="${prefix}shoulder" type="revolute">
    <parent link="base"/><child link="${prefix}upper"/><axis xyz="0 1 0"/>
    <origin xyz="0 0 EXPRESSION" rpy="${lengths.tilt} ${-pi/2} ${radians(45)}"/>
    <limit lower="-1" upper="${max(1, 2)}" effort="10" velocity="1"/>
  </joint>
  <xacro:if value="$(eval prefix == 'l_')">
    <link name="tip"/>
    <joint name="wrist" type="revolute"><parent link="${prefix}upper"/><child link="tip"/><origin xyz="0 0 1"/>
      <axis xyz="0 1 0"/></joint>
  </xacro:if>
</robot>"""
GOOD = "${round(lengths.upper, 3) + 2**-2}"


def package(folder: Path, expression: str = GOOD, name: str = "arm_description") -> Path:
    """Write a package with an arm, and return the path of its xacro file."""
    for inside in ("urdf", "config"):
        (folder / name / inside).mkdir(parents=True, exist_ok=True)
    (folder / name / "package.xml").write_text(f"<package><name>{name}</name></package>")
    (folder / name / "urdf" / "macro.xacro").write_text(MACRO)
    (folder / name / "config" / "lengths.yaml").write_text("{upper: 0.4, tilt: !degrees 90}")
    file = folder / name / "urdf" / "arm.urdf.xacro"
    file.write_text(ARM.replace("EXPRESSION", expression))
    return file


def masses(robot: Robot) -> list[float]:
    assert robot.file is not None
    return [value for name, value in robot.file.inertias if name.startswith("m_")]


def test_arguments_macros_yaml_and_conditions(tmp_path: Path) -> None:
    file = package(tmp_path)
    light = load_robot(file)
    assert (light.actuated, masses(light)) == (("shoulder",), [1.0])
    heavy = load_robot(file, xacro={"prefix": "l_", "heavy": True})
    assert (heavy.actuated, masses(heavy)) == (("l_shoulder", "wrist"), [2.5])
    placement = heavy.joints[0].placement
    assert isinstance(placement, Pose)
    np.testing.assert_allclose(placement.xyz, (0, 0, 0.65))
    np.testing.assert_allclose(placement.rpy, (np.pi / 2, -np.pi / 2, np.pi / 4))
    assert heavy.joints[0].limits.position == (-1.0, 2.0)


def test_a_misspelt_argument_is_refused(tmp_path: Path) -> None:
    with pytest.raises(GtauError, match=r"declares no argument 'prefx' \(xacro:arg\); it has .*prefix"):
        load_robot(package(tmp_path), xacro={"prefx": "l_"})


def test_in_an_experiment_file_and_on_the_command_line(tmp_path: Path) -> None:
    """The file is outside of its package, which ``packages`` names relative to the experiment file."""
    file = package(tmp_path / "src")
    alone = tmp_path / "robots" / "arm.xacro"
    alone.parent.mkdir()
    file.rename(alone)
    time = np.arange(400) / 250
    columns = (time, np.sin(2 * time), np.cos(3 * time), np.sign(np.cos(2 * time)), np.cos(2 * time))
    header = "t,q_l_shoulder,q_wrist,tau_l_shoulder,tau_wrist"
    np.savetxt(tmp_path / "a.csv", np.column_stack(columns), delimiter=",", header=header, comments="")
    with pytest.raises(GtauError, match="the package 'arm_description' is not found; name the folder that holds it"):
        load_robot(alone)
    text = f"robot: {{file: {alone}, xacro: {{prefix: l_}}, packages: [src]}}\nsignals: {{time: t, position: "
    text += "{l_shoulder: q_l_shoulder, wrist: q_wrist}, torque: {l_shoulder: tau_l_shoulder, wrist: tau_wrist}}\n"
    (tmp_path / "e.yaml").write_text(text + "runs: [{log: a.csv}]\n")
    assert load_robot(read_experiment(tmp_path / "e.yaml").robot).actuated == ("l_shoulder", "wrist")

    file = package(tmp_path / "src")
    shown = CliRunner().invoke(app, ["robot", str(file), "--xacro-arg", "prefix=l_", "--json"])
    assert (shown.exit_code, '"wrist"' in shown.stdout) == (0, True)
    wrong = CliRunner().invoke(app, ["robot", str(file), "--xacro-arg", "prefix", "--json"])
    assert (wrong.exit_code, "write the name of an argument and its value" in wrong.output) == (2, True)
    draft = draft_logs([tmp_path / "a.csv"], str(file), stated=Stated(xacro={"prefix": "l_"}))
    assert draft.signals.position == {"l_shoulder": "q_l_shoulder", "wrist": "q_wrist"}
    (tmp_path / "draft.yaml").write_text(draft_text(draft, tmp_path))
    assert load_robot(read_experiment(tmp_path / "draft.yaml").robot).actuated == ("l_shoulder", "wrist")


@pytest.mark.parametrize("variable", ["ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"])
def test_packages_of_ros(variable: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = package(tmp_path / "share")
    alone = tmp_path / "elsewhere" / "arm.xacro"
    alone.parent.mkdir()
    file.rename(alone)
    places = [tmp_path / "no such", tmp_path / "share" if variable == "ROS_PACKAGE_PATH" else tmp_path]
    monkeypatch.setenv(variable, os.pathsep.join(map(str, places)))
    assert load_robot(alone).actuated == ("shoulder",)


@pytest.mark.parametrize(
    ("expression", "value"),
    [
        ("${7 // 2 + 7 % 4 - -1}", 7.0),
        ("${[1, 2, 3][-1] * [1, 2, 3][:2][0]}", 3.0),
        ("${lengths['upper'] if 1 &lt; 2 == 2 and not False else 0}", 0.4),
        ("${len('a,b'.split(',')) + python.sum([1, 2])}", 5.0),
        ("${'ab'.replace('a', '').startswith('b') or 3}", 1.0),
        ("${float('1.5') + python.abs(-1)}", 2.5),
        ("${math.hypot(3, 4) + sqrt(4)}", 7.0),
        ("${0 or '' or 2}", 2.0),
        ("${1 if 'b' in ['a', 'b'] and lengths.get('no', 3) == 3 else 0}", 1.0),
        ("$(eval 2 * 3)", 6.0),
        ("$(optenv NO_SUCH_VARIABLE 4)", 4.0),
    ],
)
def test_expressions(expression: str, value: float, tmp_path: Path) -> None:
    file = package(tmp_path, expression.replace("'b') or 3", "'b') * 1 or 3"))
    placement = load_robot(file).joints[0].placement
    assert isinstance(placement, Pose)
    assert placement.xyz[2] == pytest.approx(value)


@pytest.mark.parametrize(
    ("expression", "sentence"),
    [
        ("${[c for c in [1]][0]}", "is not read in xacro files"),
        ("${(lambda: 1)()}", "is not read in xacro files"),
        ("${python.type(1)}", "'python.type' is not read in xacro files"),
        ("${xacro.fatal.__globals__}", "is not read in xacro files|Use of invalid name"),
        ("${''.__class__}", "is not read in xacro files"),
        ("${'-0.__class__-'.format(1)}", "is not read in xacro files"),
        ("${str.mro()}", "is not read in xacro files"),
        ("${f'-pi-'}", "is not read in xacro files"),
        ("${open('/etc/hostname')}", "unknown name 'open'"),
        ("$(eval open)", "unknown name 'open'"),
        ("$(eval [].__class__)", "double underscore"),
        ("${9**9**9}", "is out of range"),
        ("${'a' * 10**9}", "cannot be multiplied"),
        ("${nothing}", "unknown name 'nothing'"),
        ("${1/0}", "division by zero"),
        ("${1 +}", "invalid syntax"),
        ("$(arg missing)", "missing"),
    ],
)
def test_refusals(expression: str, sentence: str, tmp_path: Path) -> None:
    with pytest.raises(GtauError, match=rf"arm\.urdf\.xacro cannot be expanded \(.*({sentence})"):
        load_robot(package(tmp_path, expression))


def test_what_is_wrong_in_the_urdf_names_the_xacro_file(tmp_path: Path) -> None:
    with pytest.raises(GtauError, match=r"arm_description.urdf.arm\.urdf\.xacro"):
        load_robot(package(tmp_path, "${'a'}"))


def test_loops_beside_a_xacro_file(tmp_path: Path) -> None:
    """Of the same name without its endings; here they only name the motors."""
    file = package(tmp_path)
    (file.parent / "arm.yaml").write_text("name_mot: [l_shoulder]\n")
    assert load_robot(file, xacro={"prefix": "l_"}).actuated == ("l_shoulder",)


def test_arguments_of_another_file_are_refused(tmp_path: Path) -> None:
    with pytest.raises(GtauError, match="'xacro' and 'packages' are for xacro files, which 'five-bar' is not"):
        load_robot("five-bar", xacro={"a": 1})


def test_a_missing_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(module: str, *rest: Any, **more: Any) -> Any:
        if module.split(".")[0] == "xacrodoc":
            raise ImportError(module)
        return real(module, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(GtauError, match=r"needs the package xacrodoc, .*pip install 'gtau\[xacro\]'"):
        load_robot(package(tmp_path))
