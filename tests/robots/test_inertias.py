"""Inertias that robot files state, against the engines that read the same files."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import yaml

from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.robot import INERTIAL, Robot

URDF = """<robot name="bent">
  <link name="base"><inertial><mass value="4"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="upper"><inertial><origin xyz="0.1 -0.02 0.2" rpy="0.3 -0.2 0.5"/><mass value="5"/>
    <inertia ixx="0.05" iyy="0.06" izz="0.02" ixy="0.003" ixz="-0.002" iyz="0.001"/></inertial></link>
  <link name="lower"><inertial><origin xyz="0 0.03 0.15"/><mass value="2"/>
    <inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="camera"><inertial><origin xyz="0.01 0 0"/><mass value="0.3"/>
    <inertia ixx="0.001" iyy="0.002" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="a" type="revolute"><origin xyz="0 0 0.3" rpy="0.2 0 0"/><parent link="base"/><child link="upper"/>
    <axis xyz="0 0.6 0.8"/><limit lower="-2" upper="2" velocity="1" effort="50"/></joint>
  <joint name="b" type="revolute"><origin xyz="0.4 0 0.1" rpy="0 0.5 0"/><parent link="upper"/><child link="lower"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="1" effort="20"/></joint>
  <joint name="glue" type="fixed"><origin xyz="0 0.1 0.2" rpy="0.4 0.1 -0.3"/><parent link="lower"/>
    <child link="camera"/></joint>
</robot>"""

MJCF = """<mujoco><compiler angle="radian"/>
  <default><joint armature="0.12"/></default>
  <worldbody><body name="upper" pos="0 0 0.3" quat="0.9 0.1 0 0.2">
    <inertial mass="5" pos="0.1 -0.02 0.2" fullinertia="0.05 0.06 0.02 0.003 -0.002 0.001"/>
    <joint name="a" axis="0 0.6 0.8" pos="0.02 0 0.01"/>
    <body name="lower" pos="0.4 0 0.1" quat="0.8 0 0.6 0">
      <inertial mass="2" pos="0 0.03 0.15" quat="0.9 0.3 0 0.1" diaginertia="0.02 0.021 0.01"/>
      <joint name="b" axis="0 1 0"/>
      <body name="camera" pos="0 0.1 0.2"><inertial mass="0.3" pos="0.01 0 0" diaginertia="0.001 0.002 0.002"/></body>
    </body></body></worldbody>
  <actuator><motor joint="a"/><motor joint="b"/></actuator></mujoco>"""


def torques(robot: Robot, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
    """Torques (n,) with the inertias of the file, and nothing else."""
    model, stated = InverseDynamics(robot), dict(robot.inertias)
    return model.torques(q[None], qd[None], qdd[None], {k: v for k, v in stated.items() if "ground" not in k})[0]


def test_a_urdf_has_the_inertias_that_pinocchio_reads(tmp_path: Path, rng: np.random.Generator) -> None:
    (tmp_path / "bent.urdf").write_text(URDF)
    engine = pin.buildModelFromUrdf(str(tmp_path / "bent.urdf"))
    robot = load_robot(tmp_path / "bent.urdf")
    engine.gravity.linear = np.array(robot.gravity)
    q, qd, qdd = rng.uniform(-1, 1, (3, 2))
    expected = pin.rnea(engine, engine.createData(), q, qd, qdd)
    np.testing.assert_allclose(torques(robot, q, qd, qdd), expected, rtol=1e-9)


def test_a_held_joint_adds_its_link_to_the_one_before(tmp_path: Path) -> None:
    (tmp_path / "bent.urdf").write_text(URDF)
    whole, held = load_robot(tmp_path / "bent.urdf"), load_robot(tmp_path / "bent.urdf", held={"b": 0.7})
    q, qd, qdd = np.array([0.4, 0.7]), np.array([0.9, 0.0]), np.array([-1.1, 0.0])
    np.testing.assert_allclose(torques(held, q[:1], qd[:1], qdd[:1])[0], torques(whole, q, qd, qdd)[0], rtol=1e-9)
    assert not any(name.endswith("_b") for name in held.inertias)


def test_an_mjcf_file_has_the_inertias_and_armatures_of_mujoco(tmp_path: Path, rng: np.random.Generator) -> None:
    (tmp_path / "bent.xml").write_text(MJCF)
    model = mujoco.MjModel.from_xml_string(MJCF)
    data = mujoco.MjData(model)
    data.qpos, data.qvel, data.qacc = rng.uniform(-1, 1, (3, 2))
    mujoco.mj_inverse(model, data)
    robot = load_robot(tmp_path / "bent.xml")
    np.testing.assert_allclose(torques(robot, data.qpos, data.qvel, data.qacc), data.qfrc_inverse, rtol=1e-9)


ARM = """<mujoco><compiler {compiler}/>{rest}<worldbody><body name="pedestal"><geom size="0.1" mass="20"/>
  <body name="upper" pos="0 0 0.3"><joint name="a" axis="0 1 0" armature="0.03"/>
    <inertial mass="1.3" pos="0.12 0.01 0.02" diaginertia="0.01 0.02 0.015"/>
    <body name="lower" pos="0.3 0 0"><joint name="b" axis="0 1 0.3"/>
      <inertial mass="0.9" pos="0.1 0 0.01" {turn} diaginertia="0.006 0.009 {zz}"/>
      <body name="hand" pos="0.2 0 0.1" quat="0.9 0.1 0.3 0">{hand}</body>
    </body></body></body></worldbody>
  <actuator><motor joint="a"/><motor joint="b"/></actuator></mujoco>"""
BOX = '<geom type="box" size="0.05 0.02 0.03" pos="0.05 0 0" mass="0.6"/>'
LIGHT = '<default><geom density="300"/></default>'
MESH = '<asset><mesh name="m" vertex="0 0 0 0.1 0 0 0 0.1 0 0 0 0.1"/></asset>'
MISSING = '<asset><mesh name="m" file="nowhere.obj"/></asset>'


@pytest.mark.parametrize(
    "changed",
    [
        {"hand": BOX},
        {"hand": '<geom size="0.05"/>'},
        {"hand": '<frame euler="0 30 0"><geom size="0.04 0.1" type="capsule" pos="0 0 0.1"/></frame>', "rest": LIGHT},
        {"hand": '<geom type="mesh" mesh="m"/>', "rest": MESH},
        {"hand": BOX + '<geom size="0.1" group="3"/>', "compiler": 'inertiagrouprange="0 1"'},
        {"hand": BOX, "compiler": 'fusestatic="true"'},
        {"hand": BOX, "compiler": 'fusestatic="true" boundmass="1.1"'},
        {"hand": BOX, "compiler": 'settotalmass="7"'},
        {"hand": BOX, "compiler": 'boundmass="1.1" boundinertia="0.01"'},
        {"hand": BOX, "compiler": 'balanceinertia="true"', "zz": "0.001"},
        {"turn": 'euler="20 -30 50"'},
        {"turn": 'axisangle="1 1 0 40"'},
    ],
    ids=lambda changed: "-".join(changed.values())[-60:],
)
def test_inertias_of_an_mjcf_file_are_mujoco_s(
    changed: dict[str, str], tmp_path: Path, rng: np.random.Generator
) -> None:
    text = ARM.format(**({"compiler": "", "rest": "", "turn": "", "zz": "0.007", "hand": ""} | changed))
    (tmp_path / "arm.xml").write_text(text)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qpos, data.qvel, data.qacc = rng.uniform(-1, 1, (3, 2))
    mujoco.mj_inverse(model, data)
    found = torques(load_robot(tmp_path / "arm.xml"), data.qpos, data.qvel, data.qacc)
    np.testing.assert_allclose(found, data.qfrc_inverse, rtol=1e-9)


def test_an_attached_model_has_a_compiler_of_its_own(tmp_path: Path) -> None:
    (tmp_path / "tool.xml").write_text(
        '<mujoco><compiler inertiafromgeom="true"/><worldbody><body name="tool"><geom size="0.1" mass="0.7"/>'
        '<inertial mass="2" pos="0 0 0" diaginertia="1 1 1"/></body></worldbody></mujoco>'
    )
    hand, rest = '<attach model="m" body="tool" prefix="x"/>', '<asset><model name="m" file="tool.xml"/></asset>'
    (tmp_path / "arm.xml").write_text(ARM.format(compiler="", turn="", zz="0.007", hand=hand, rest=rest))
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    expected = model.body_mass[[model.body(name).id for name in ("lower", "hand", "xtool")]].sum()
    assert load_robot(tmp_path / "arm.xml").inertias["m_b"] == pytest.approx(expected)


def test_meshes_that_weigh_nothing_need_not_exist(tmp_path: Path) -> None:
    arm = {"compiler": "", "turn": "", "zz": "0.007", "rest": MISSING}
    (tmp_path / "arm.xml").write_text(ARM.format(hand='<geom type="mesh" mesh="m" mass="0"/>' + BOX, **arm))
    inertias = load_robot(tmp_path / "arm.xml").inertias
    assert inertias["m_b"] == pytest.approx(1.5)
    assert yaml.safe_load(yaml.safe_dump(inertias)) == inertias  # into a simulation file
    (tmp_path / "arm.xml").write_text(ARM.format(hand='<geom type="mesh" mesh="m"/>', **arm))
    robot = load_robot(tmp_path / "arm.xml")
    assert robot.inertias == {}
    assert robot.notes[-1].startswith("the masses in the file were not read, as MuJoCo does not compile them (Error op")


def test_shapes_of_the_density_of_water_are_no_statement_of_the_file(tmp_path: Path) -> None:
    (tmp_path / "ball.xml").write_text(
        '<mujoco><worldbody><body><joint name="a"/><geom size="0.1"/></body></worldbody>'
        '<actuator><motor joint="a"/></actuator></mujoco>'
    )
    robot = load_robot(tmp_path / "ball.xml")
    assert robot.inertias == {}
    assert robot.notes == ("the file states no masses, and masses of its shapes at the density of water were not read",)


def test_a_floating_base_has_the_inertia_of_the_root_link(tmp_path: Path) -> None:
    (tmp_path / "bent.urdf").write_text(URDF)
    stated = dict(load_robot(tmp_path / "bent.urdf", base="floating").inertias)
    assert stated["m_base"] == 4.0
    assert {f"{kind}_base" for kind in INERTIAL} <= set(stated)
