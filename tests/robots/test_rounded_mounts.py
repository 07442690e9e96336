"""Angles with few digits do not tilt axes: a robot has the base parameters of the one that was meant."""

from __future__ import annotations

from math import cos, pi, sin
from pathlib import Path

import numpy as np
import pytest

from gtau.model.base_parameters import base_parameters
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.readers.native import write_native
from gtau.robots.robot import Robot

ARM = """robot: arm
joints:
  base: {{antecedent: ground, alpha: {eighth}, theta: q}}
  shoulder: {{antecedent: base, alpha: {quarter}, d: 0.1, theta: q}}
  elbow: {{antecedent: shoulder, d: 0.4, theta: q}}
  wrist: {{antecedent: elbow, gamma: {eighth}, alpha: {quarter}, r: 0.3, theta: q}}
gravity: [0, {gravity}, {gravity}]
"""
"""An arm whose first axis is vertical, as gravity is the same along y and z: by an angle of 45 degrees."""


def counts(robot: Robot) -> tuple[int, tuple[str, ...]]:
    base = base_parameters(InverseDynamics(robot))
    return base.count, base.names


def write(angle: float, digits: int | None) -> str:
    return repr(angle) if digits is None else f"{angle:.{digits}f}"


@pytest.mark.parametrize("digits", [3, 4, 5, 6, 7, 8, 9, 10])
def test_robot_files(digits: int, tmp_path: Path) -> None:
    found = []
    for places in (None, digits):
        angles = {"eighth": write(-pi / 4, places), "quarter": write(pi / 2, places)}
        (tmp_path / "arm.yaml").write_text(ARM.format(**angles, gravity=-9.81 / 2**0.5))
        found.append(load_robot(tmp_path / "arm.yaml"))
    meant, read = found
    assert counts(read) == counts(meant)
    assert digits > 9 or "rounded angles" in read.notes[-1]
    assert not any("rounded" in note for note in meant.notes)


@pytest.mark.parametrize("name", ["puma560", "ur10e", "staubli-tx40"])
def test_the_catalog_written_with_five_digits(name: str, tmp_path: Path) -> None:
    robot = load_robot(name)
    write_native(robot, tmp_path / "exact.yaml")
    text = exact = (tmp_path / "exact.yaml").read_text()
    for angle in (pi, pi / 2):
        text = text.replace(repr(angle), f"{angle:.5f}")
    assert text != exact
    (tmp_path / "rounded.yaml").write_text(text)
    assert counts(load_robot(tmp_path / "rounded.yaml")) == counts(robot)


URDF = """<robot name="arm"><link name="ground"/>{links}
<joint name="wedge" type="fixed"><origin rpy="{eighth} 0 0"/><parent link="ground"/><child link="w"/></joint>
<joint name="flange" type="fixed"><origin rpy="{eighth} 0 0"/><parent link="w"/><child link="f"/></joint>
<joint name="a" type="revolute"><origin xyz="0 0 1"/><parent link="f"/><child link="l1"/><axis xyz="0 1 0"/></joint>
<joint name="b" type="revolute"><origin xyz="0 0 1" rpy="0 0 {third}"/><parent link="l1"/><child link="l2"/>
<axis xyz="1 0 0"/></joint></robot>"""
MJCF = """<mujoco><compiler angle="radian"/><worldbody><body {first}><frame {second}>
<body name="l1" pos="0 0 1"><joint name="a" axis="0 1 0"/><body name="l2" pos="0 0 1" {third}>
<joint name="b" axis="1 0 0"/></body></body></frame></body></worldbody></mujoco>"""


@pytest.mark.parametrize("digits", [3, 4, 6, 10])
@pytest.mark.parametrize("kind", ["urdf", "euler", "quat", "axisangle"])
def test_two_wedges_that_make_a_wall(kind: str, digits: int, tmp_path: Path) -> None:
    """Two mounts of 45 degrees make the first axis vertical, whatever the digits, in URDF and MJCF."""
    found = []
    for places in (None, digits):
        eighth, third = write(pi / 4, places), write(2 * pi / 3, places)

        def turned(angle: float, axis: int, places: int | None = places) -> str:
            if kind == "quat":
                part = [cos(angle / 2), 0.0, 0.0, 0.0]
                part[1 + axis] = sin(angle / 2)
                return 'quat="' + " ".join(write(x, places) for x in part) + '"'
            if kind == "axisangle":
                return f'axisangle="{"1 0 0" if axis == 0 else "0 0 1"} {write(angle, places)}"'
            return f'euler="{" ".join(write(angle, places) if k == axis else "0" for k in range(3))}"'

        links = "".join(f'<link name="{name}"/>' for name in ("w", "f", "l1", "l2"))
        path = tmp_path / ("arm.urdf" if kind == "urdf" else "arm.xml")
        made = (turned(pi / 4, 0), turned(pi / 4, 0), turned(2 * pi / 3, 2))
        mjcf = MJCF.format(first=made[0], second=made[1], third=made[2])
        path.write_text(URDF.format(links=links, eighth=eighth, third=third) if kind == "urdf" else mjcf)
        found.append(load_robot(path))
    meant, read = found
    assert counts(read) == counts(meant)
    for one, other in zip(read.joints, meant.joints, strict=True):
        np.testing.assert_allclose(one.placement.rotation, other.placement.rotation, atol=1e-15)


def test_a_tilt_that_is_written_is_real(tmp_path: Path) -> None:
    found = []
    for eighth in ("-pi/4", "-0.7864", "-0.785498"):
        (tmp_path / "arm.yaml").write_text(ARM.format(eighth=eighth, quarter="pi/2", gravity=-9.81 / 2**0.5))
        found.append(counts(load_robot(tmp_path / "arm.yaml"))[0])
    assert found[1] == found[2] > found[0]
