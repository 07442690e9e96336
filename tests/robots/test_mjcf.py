"""MJCF files: geometry and loops against MuJoCo itself, and the same robot in three formats."""

from __future__ import annotations

import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from engines import closed_torques, random_parameters
from scipy.spatial.transform import Rotation

from gtau.documents.markup import read_xml
from gtau.errors import GtauError
from gtau.estimation.regression.priors import stated_inertias
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.kinematics import Coordinates, poses
from gtau.model.loop_closure import loop_errors
from gtau.robots.readers.mjcf import as_written, read_mjcf
from gtau.robots.readers.mjcf_file import compile_mjcf, refuse_deadly
from gtau.robots.readers.native import read_native, write_native
from gtau.robots.readers.source import RobotSource
from gtau.robots.robot import GROUND, INERTIAL, Coupling, Robot

mujoco = pytest.importorskip("mujoco")

ARM = """<mujoco model="arm"><compiler angle="radian"/><option gravity="0 -9 1"/><worldbody>
<body name="stand" pos="0 0 1" euler="0 0.3 0">
  <body name="a" pos="0.1 0 0" euler="0.2 0.1 0"><joint name="j1" axis="0 1 0" pos="0.01 0 0.02" ref="0.3"/>
    <geom size="0.1"/>
    <body name="b" pos="0.3 0 0"><joint name="j2" axis="0 1 1" range="-1 2"/>
      <joint name="j3" type="slide" axis="1 0 2" ref="0.05"/><geom size="0.1"/>
      <body name="fixed" pos="0 0.1 0" euler="0 0 1">
        <body name="c" pos="0.2 0.1 0"><joint name="j4" type="ball" pos="0 0.1 0"/><geom size="0.1"/>
          <site name="s" pos="0 0.2 0.1" euler="0.5 0.1 0"/></body></body></body></body></body>
<body name="P" pos="0.5 0.2 0.8" euler="0.1 0 0.3"><freejoint/><geom size="0.1"/>
  <site name="p" pos="0.1 0 0" euler="0 0 0.7"/></body>
</worldbody>
<equality>%s</equality>
<actuator><motor joint="j1" gear="30"/><motor joint="j2"/><motor joint="j3"/></actuator></mujoco>"""


def load(text: str, tmp_path: Path) -> Robot:
    (tmp_path / "robot.xml").write_text(text)
    return load_robot(tmp_path / "robot.xml")


def read(text: str, tmp_path: Path, base: str | None = None) -> Robot:
    """With its idle pins, and without assembly, which would refuse what can still move."""
    path = tmp_path / "robot.xml"
    path.write_text(text)
    return as_written(compile_mjcf(read_xml(path), path), path, RobotSource(file="", base=base).base)


@pytest.mark.parametrize(
    "equality",
    [
        '<weld body1="c" body2="P" anchor="0.1 0.2 0.3"/>',
        '<weld body1="c" body2="P" relpose="0.1 0.2 0.3 0.6 0 0.8 0"/>',
        '<weld body1="fixed" body2="P" anchor="0.1 0.2 0.3"/>',
        '<connect body1="c" body2="P" anchor="0.1 0.2 0.3"/>',
        '<connect body1="P" body2="world" anchor="0.1 0.2 0.3"/>',
        '<connect site1="s" site2="p"/>',
        '<weld site1="s" site2="p"/>',
    ],
)
def test_frames_and_closures_are_mujoco_s(equality: str, tmp_path: Path, rng: np.random.Generator) -> None:
    text = ARM % equality
    robot = read(text, tmp_path)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    assert robot.actuated == ("j1", "j2", "j3")
    assert robot.gravity == (0.0, -9.0, 1.0)
    assert [joint.parameters for joint in robot.joints] == ["all", "drive", "all", "none", "none", "inertial"]
    assert robot.joint("j2").limits.position == (-1.0, 2.0)
    assert any("gear of 30" in note for note in robot.notes)
    errors = loop_errors(Coordinates(robot))
    c = errors.layout.home
    for _ in range(3):
        q = rng.uniform(-1, 1, 6)
        data.qpos[:3] = q[:3]
        turns = [(np.eye(3)[k], angle) for k, angle in enumerate(q[3:])]
        quat, part = np.array([1.0, 0, 0, 0]), np.zeros(4)
        for axis, angle in turns:
            mujoco.mju_axisAngle2Quat(part, axis, angle)
            product = np.zeros(4)
            mujoco.mju_mulQuat(product, quat, part)
            quat = product
        data.qpos[3:7] = quat
        data.qpos[7:10] = rng.normal(size=3)
        data.qpos[10:14] = rng.normal(size=4)
        mujoco.mj_normalizeQuat(model, data.qpos)
        mujoco.mj_forward(model, data)
        body = {name: model.body(name).id for name in ("a", "b", "c", "P")}
        pose = {name: (data.xmat[k].reshape(3, 3), data.xpos[k]) for name, k in body.items()}
        c[:6], c[6:9] = q, pose["P"][1]
        c[9:13] = data.xquat[body["P"]]
        found = poses(errors.layout, c)
        for joint, name, anchor in (("j1", "a", [0.01, 0, 0.02]), ("j3", "b", np.zeros(3)), ("j4", "c", [0, 0.1, 0])):
            R, p = found[joint]
            np.testing.assert_allclose(R, pose[name][0], atol=1e-9)
            np.testing.assert_allclose(p - R @ anchor, pose[name][1], atol=1e-9)
        error, _ = errors(c)
        np.testing.assert_allclose(error[:3] * errors.layout.length, data.efc_pos[:3], atol=1e-9)
        if robot.closures[0].kind == "weld":  # MuJoCo's orientation error is the sine of half the angle, ours twice it
            assert np.linalg.norm(error[3:6]) / 2 == pytest.approx(np.linalg.norm(data.efc_pos[3:6]), abs=1e-9)


def test_home_and_couplings(tmp_path: Path) -> None:
    text = """<mujoco><compiler angle="radian"/><worldbody><body name="a"><joint name="x" ref="0.1"/>
      <body name="b" pos="1 0 0"><joint name="y" type="slide" ref="0.2"/></body></body></worldbody>
      <equality><joint joint1="y" joint2="x" polycoef="0.3 2 0 0 0"/></equality>
      <keyframe><key name="home" qpos="0.5 1.3"/></keyframe></mujoco>"""
    robot = load(text, tmp_path)
    # y - 0.2 = 0.3 + 2 (x - 0.1), and 'y' follows as no actuator says otherwise
    assert robot.couplings == (Coupling("y", (("x", 2.0),), pytest.approx(0.3)),)
    assert robot.actuated == ("x",)
    assert [joint.home for joint in robot.joints] == pytest.approx([0.5, 1.3])
    assert robot.notes == ()


def test_meshes_are_not_needed(tmp_path: Path) -> None:
    text = """<mujoco><asset><mesh name="m" file="nowhere.stl"/><texture name="t" type="2d" file="no.png"/></asset>
      <worldbody><body><joint name="j"/><geom type="mesh" mesh="m"/></body></worldbody>
      <sensor><jointpos joint="j"/></sensor></mujoco>"""
    assert [joint.name for joint in load(text, tmp_path).joints] == ["j"]


def test_a_quaternion_of_zeros_in_a_keyframe_is_no_rotation(tmp_path: Path) -> None:
    """As MuJoCo takes it, of a free body and of a ball."""
    text = """<mujoco><worldbody><body name="b" euler="40 0 0"><freejoint/><geom size="1"/><body name="c" pos="1 0 0">
      <joint name="j" pos="0 1 0"/><geom size="1"/><body name="d" pos="0 0 1" euler="0 30 0">
      <joint name="k" type="ball"/><geom size="1"/></body></body></body></worldbody>
      <actuator><motor joint="j"/></actuator>
      <keyframe><key name="home" qpos="0.3 0.2 1 0 0 0 0 0.5 0 0 0 0"/></keyframe></mujoco>"""
    (tmp_path / "robot.xml").write_text(text)
    robot = read(text, tmp_path, "fixed").with_file(home_given=True)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_kinematics(model, data)
    R, p = poses(Coordinates(robot), Coordinates(robot).home)["k"]
    np.testing.assert_allclose(R, data.body("d").xmat.reshape(3, 3), atol=1e-12)
    np.testing.assert_allclose(p, data.body("d").xpos, atol=1e-12)


# One robot in three formats: a five-bar in a tilted plane, closed by a point

PLANE = "0.4 -0.7 0.3"


def as_mjcf() -> str:
    """MuJoCo's Euler angles are told to be about fixed axes, as a URDF's, and its gravity is 9.81 unless stated."""

    def leg(side: str, x: float) -> str:
        return f"""<body pos="{x} 0 0"><joint name="{side}" axis="0 0 1"/>
          <body pos="0.25 0 0.02"><joint name="{side}_2" axis="0 0 1"/><site name="{side}" pos="0.35 0 0"/></body>
          </body>"""

    return f"""<mujoco model="same"><compiler angle="radian" eulerseq="XYZ"/><option gravity="0 0 -9.80665"/>
      <worldbody><body pos="0 0 1" euler="{PLANE}">{leg("left", -0.1)}{leg("right", 0.1)}</body></worldbody>
      <equality><connect site1="left" site2="right"/></equality>
      <actuator><position joint="left"/><position joint="right"/></actuator></mujoco>"""


def as_urdf(tmp_path: Path) -> Path:
    def joint(name: str, kind: str, parent: str, child: str, xyz: str, rpy: str = "0 0 0") -> str:
        return (
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="0 0 1"/></joint>'
        )

    links = "".join(f'<link name="{name}"/>' for name in ("base", "plate", "l1", "l2", "r1", "r2", "l", "r"))
    joints = [
        joint("stand", "fixed", "base", "plate", "0 0 1", PLANE),
        joint("left", "continuous", "plate", "l1", "-0.1 0 0"),
        joint("left_2", "continuous", "l1", "l2", "0.25 0 0.02"),
        joint("right", "continuous", "plate", "r1", "0.1 0 0"),
        joint("right_2", "continuous", "r1", "r2", "0.25 0 0.02"),
        joint("l_end", "fixed", "l2", "l", "0.35 0 0"),
        joint("r_end", "fixed", "r2", "r", "0.35 0 0"),
    ]
    (tmp_path / "same.urdf").write_text(f'<robot name="same">{links}{"".join(joints)}</robot>')
    (tmp_path / "same.yaml").write_text("closed_loop: [[l, r]]\ntype: [3d]\nname_mot: [left, right]\n")
    return tmp_path / "same.urdf"


def test_the_same_robot_in_three_formats(tmp_path: Path, rng: np.random.Generator) -> None:
    urdf = load_robot(as_urdf(tmp_path))
    mjcf = load(as_mjcf(), tmp_path)
    write_native(urdf, tmp_path / "native.yaml")
    native = read_native(tmp_path / "native.yaml")
    assert urdf.actuated == mjcf.actuated == native.actuated == ("left", "right")
    chi = random_parameters(native, rng)
    home = np.array([joint.home for joint in native.joints if joint.actuated])
    q, (qd, qdd) = home + 0.1 * rng.uniform(-1, 1, (20, 2)), rng.normal(size=(2, 20, 2))
    expected = InverseDynamics(native).torques(q, qd, qdd, chi)
    for robot in (urdf, mjcf):
        found = InverseDynamics(robot).torques(q, qd, qdd, chi)
        assert np.abs(found - expected).max() < 1e-10 * np.abs(expected).max()
    assert closed_torques(native, chi, q[:3], qd[:3], qdd[:3]) == pytest.approx(expected[:3], rel=1e-9)


# What is refused

BODY = '<mujoco><worldbody><body name="a"><joint name="j"/></body>%s</worldbody>%s</mujoco>'
FLOATING = '<body name="f"><freejoint/><body name="g"><joint name="k"/></body></body>'
TWO = '<body name="b"><joint name="k"/></body>'
BAD: list[tuple[str, str, str]] = [
    ("not XML", "mujoco", ": this is not valid XML"),
    ("XML bomb", '<!DOCTYPE m [<!ENTITY a "aa"><!ENTITY b "&a;&a;">]><mujoco model="&b;"/>', ": the file declares"),
    ("a URDF", '<robot name="r"/>', ": the outermost element is <robot>, not <mujoco>; give an MJCF file."),
    ("unknown element", BODY % ("<bodi/>", ""), ": MuJoCo refuses the file ("),
    ("unknown attribute", BODY % ('<body posn="0 0 0"/>', ""), ": MuJoCo refuses the file ("),
    ("short vector", BODY % ('<body pos="0 0"/>', ""), ": MuJoCo refuses the file ("),
    ("not a number", BODY % ('<body pos="0 0 x"/>', ""), ": line 1: pos of <body> is '0 0 x'; write plain"),
    ("zero axis", BODY % ('<body><joint axis="0 0 0"/></body>', ""), ": MuJoCo refuses the file ("),
    ("two joints of a name", BODY % ('<body name="b"><joint name="j"/></body>', ""), ": MuJoCo refuses the file ("),
    ("no joints", "<mujoco/>", ": it has no joints except joints of free bodies"),
    ("floating base", BODY % (FLOATING, ""), ": body 'f' floats and carries joints; write"),
    ("unknown body", BODY % ("", '<equality><weld body1="z"/></equality>'), ": MuJoCo refuses the file ("),
    (
        "polynomial coupling",
        BODY % (TWO, '<equality><joint joint1="j" joint2="k" polycoef="0 1 1 0 0"/></equality>'),
        ": equality 'equality 1' is neither connect, weld nor a linear joint coupling of two joints;",
    ),
    (
        "tendon",
        BODY % ('<site name="s"/><site name="w"/>', '<tendon><spatial name="t"><site site="s"/><site site="w"/>'
                    '</spatial></tendon><actuator><motor name="m" tendon="t"/></actuator>'),
        ": no actuator drives a joint (joint=...)",
    ),
    ("copies", BODY % ('<replicate count="900"><replicate count="9"><body><joint/></body></replicate></replicate>', ""),
     ": it holds 8102 bodies, and at most 2000 are read;"),
    ("tied tendons", BODY % ("", '<tendon><fixed name="t"><joint joint="j" coef="1"/></fixed><fixed name="u"><joint '
                                 'joint="j" coef="1"/></fixed></tendon><equality><tendon name="e" tendon1="t" '
                                 'tendon2="u" polycoef="0 0 1 0 0"/></equality>'), ": equality 'e' ties tendons"),
    ("missing include", BODY % ('<include file="nowhere.xml"/>', ""), ": MuJoCo refuses the file ("),
]  # fmt: skip


@pytest.mark.parametrize(("text", "sentence"), [case[1:] for case in BAD], ids=[case[0] for case in BAD])
def test_bad_mjcf(text: str, sentence: str, tmp_path: Path) -> None:
    with pytest.raises(GtauError) as refused:
        load(text, tmp_path)
    said = str(refused.value)
    assert said.startswith(str(tmp_path / "robot.xml"))
    assert sentence in said
    assert "\n" not in said


@pytest.mark.parametrize("number", ["nan", "inf", "1e300", "1_0", "\uff11", "0x10"])
@pytest.mark.parametrize(
    ("element", "key"),
    [
        ('<option gravity="0 0 {}"/>', "gravity of <option>"),
        ('<worldbody><body pos="{} 0 0"/></worldbody>', "pos of <body>"),
        ('<worldbody><body quat="{} 0 0 0"/></worldbody>', "quat of <body>"),
        ('<worldbody><body><joint axis="{} 0 1"/></body></worldbody>', "axis of <joint>"),
        ('<equality><connect body1="a" anchor="{} 0 0"/></equality>', "anchor of <connect>"),
        ('<worldbody><body><joint stiffness="{}"/></body></worldbody>', "stiffness of <joint>"),
        ('<worldbody><body><inertial pos="0 0 0" mass="{}"/></body></worldbody>', "mass of <inertial>"),
        ('<tendon><spatial springlength="{}"/></tendon>', "springlength of <spatial>"),
        ('<actuator><general biasprm="0 {} 0"/></actuator>', "biasprm of <general>"),
        ('<keyframe><key name="home" qpos="{}"/></keyframe>', "qpos of <key>"),
    ],
)
def test_numbers_that_no_robot_has(
    element: str, key: str, number: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(GtauError, match=f"robot.xml: line 1: {key} is '.*{number}.*'; write plain decimal numbers, at"):
        load(BODY % ("", element.format(number)), tmp_path)
    assert capfd.readouterr() == ("", "")  # MuJoCo warns of some


@pytest.mark.parametrize("ends", ["-inf inf", "-1e300 1e300"])
def test_infinite_limits_are_none(ends: str, tmp_path: Path) -> None:
    text = (BODY % ("", "")).replace('name="j"', f'name="j" limited="true" range="{ends}"')
    assert load(text, tmp_path).joint("j").limits.position is None


MOTORS = """<mujoco><default><default class="small"><motor forcerange="-9 9"/></default></default>
<worldbody><body><joint name="a"/><geom size="0.1"/><body pos="0 0 1"><joint name="b" actuatorfrcrange="-7 7"/>
<geom size="0.1"/><body pos="0 0 1"><joint name="c"/><joint name="d" axis="0 1 0"/><joint name="e" axis="1 0 0"/>
<joint name="f" type="slide"/><geom size="0.1"/></body></body></body></worldbody>
<tendon><fixed name="c"><joint joint="d" coef="1"/></fixed></tendon><actuator><motor tendon="c" forcerange="-3 3"/>
<motor joint="a" gear="-30" ctrlrange="-0.5 0.4" ctrllimited="true"/><position joint="b" kp="5" forcerange="-90 90"/>
<motor joint="c" class="small"/><motor joint="c" gear="2" forcelimited="true" forcerange="-4 4"/><motor joint="d"/>
<position joint="e" kp="5" ctrlrange="-1 1"/><general joint="f" gainprm="40" ctrlrange="-2 2" ctrllimited="true"/>
</actuator></mujoco>"""


def test_efforts_are_the_largest_forces_of_mujoco_s_actuators(tmp_path: Path) -> None:
    robot, model = load(MOTORS, tmp_path), mujoco.MjModel.from_xml_string(MOTORS)
    data = mujoco.MjData(model)
    largest = np.full(model.nv, np.inf)
    for sign in (1, -1):
        data.ctrl[:] = sign * 1e9 * np.sign(model.actuator_gear[:, 0])
        mujoco.mj_forward(model, data)
        largest = np.minimum(largest, np.abs(data.qfrc_actuator))
    known = dict(zip("abcdef", np.where(largest < 1e6, largest, np.inf), strict=True)) | {"e": np.inf}  # by a position
    assert {joint.name: joint.limits.effort or np.inf for joint in robot.joints} == pytest.approx(known)


def test_inactive_equalities_are_left_out_and_said(tmp_path: Path) -> None:
    text = BODY % ("", '<equality><weld name="w" body1="a" active="false"/></equality>')
    robot = load(text, tmp_path)
    assert robot.closures == ()
    assert robot.notes == ("equality 'w' is not active in the file and was left out",)
    assert robot.joints[0].antecedent == GROUND


LEFT_OUT = [
    ("material", '<body name="b"><site material="m"/><geom size="1" material="m"/></body>',
     '<asset><material name="m"/></asset>', "the file states no masses, and masses of its shapes at the density of"),
    ("keyframe", "", '<keyframe><key name="home" qpos="0.3 0.2"/></keyframe>', "keyframe 'home' has 2 positions for 1"),
    ("loose body", '<body name="f"><freejoint/></body>', "", "free body 'f' attached to nothing: left out"),
    ("site", '<site name="s"/>', '<actuator><motor joint="j"/><motor name="m" site="s"/></actuator>',
     "actuator 'm' on no hinge, slide or fixed tendon: left out"),
    ("tendon", '<body><joint name="k"/></body>', '<tendon><fixed name="t"><joint joint="k" coef="1"/></fixed></tendon>'
     '<actuator><motor joint="j"/><motor tendon="t"/></actuator>', "1 joint held since a tendon pulls them"),
    ("constant", '<body><joint name="k"/></body>', '<equality><joint joint1="k" polycoef="0.2 0 0 0 0"/></equality>',
     "1 joint held by an equality with a constant (rad, m): 'k' at 0.2"),
    ("fluid", "", '<option density="1000"/>', "drag of the fluid around the robot"),
    ("weightless", '<body name="w" gravcomp="1"/>', "", "gravity compensation (gravcomp) acts in the simulator"),
    ("no gravity", "", '<option><flag gravity="disable"/></option>', "gravity is switched off in the file, and here"),
    ("sensor", "", '<sensor><jointpos joint="j"/></sensor>', ""),
]  # fmt: skip


@pytest.mark.parametrize(
    ("bodies", "rest", "note"), [case[1:] for case in LEFT_OUT], ids=[case[0] for case in LEFT_OUT]
)
def test_what_does_not_matter_is_left_out_and_said(bodies: str, rest: str, note: str, tmp_path: Path) -> None:
    robot = load(BODY % (bodies, rest), tmp_path)
    assert robot.actuated == ("j",)
    assert len(robot.notes) == bool(note)
    assert all(each.startswith(note) for each in robot.notes)


def test_fixed_tendons_of_a_length_couple_joints(tmp_path: Path) -> None:
    text = """<mujoco><compiler angle="radian"/><worldbody><body><joint name="a" ref="0.1"/><geom size="1"/><body>
      <joint name="b" range="-1 1"/><geom size="1"/></body></body></worldbody><tendon><fixed name="t">
      <joint joint="a" coef="2"/><joint joint="b" coef="-1"/></fixed></tendon>
      <equality><tendon tendon1="t" polycoef="0.4 0 0 0 0"/></equality>
      <actuator><motor joint="b"/></actuator></mujoco>"""
    robot = load(text, tmp_path)
    assert robot.couplings == (Coupling("a", (("b", 0.5),), pytest.approx(0.3)),)
    assert robot.actuated == ("b",)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qpos[:] = [0.5 * 0.7 + 0.3, 0.7]
    mujoco.mj_forward(model, data)
    assert data.efc_pos[0] == pytest.approx(0.0, abs=1e-12)


DIFFERENTIAL = """<mujoco><compiler angle="radian"/><worldbody>%s<body name="hip">%s
  <joint name="roll" axis="1 0 0" ref="0.2"/><body name="trunk">%s<joint name="yaw" axis="0 0 1"/></body></body>
  </worldbody><tendon>
  <fixed name="sum" limited="true" range="0.3 0.302"><joint joint="m1" coef="1"/><joint joint="m2" coef="1"/>
  <joint joint="roll" coef="-2"/></fixed>
  <fixed name="difference" range="-0.002 0.002"><joint joint="m1" coef="1"/><joint joint="m2" coef="-1"/>
  <joint joint="yaw" coef="-2"/></fixed>
  <fixed name="wide" range="-1 1"><joint joint="m1" coef="1"/><joint joint="yaw" coef="1"/></fixed></tendon>
  <actuator><motor joint="m1"/><motor joint="m2"/></actuator></mujoco>"""


def test_narrow_limits_of_a_tendon_couple_joints(tmp_path: Path) -> None:
    """Gears with play, as of the waist of a small humanoid: two motors turn it about two axes."""
    text = DIFFERENTIAL % (body("m1") + body("m2"), INERTIAL_ELEMENT, INERTIAL_ELEMENT)
    robot = load(text, tmp_path)
    assert robot.couplings == (
        Coupling("roll", (("m1", 0.5), ("m2", 0.5)), pytest.approx(-0.1505)),
        Coupling("yaw", (("m1", 0.5), ("m2", -0.5)), pytest.approx(0.0)),
    )
    assert robot.actuated == ("m1", "m2")
    assert "'roll' follows 'm1', 'm2' within the limits of tendon 'sum'; the play of 0.001 rad is not" in robot.notes[0]
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qpos[:] = [0.7, 0.4, 0.5 * 1.1 - 0.1505, 0.5 * 0.3]
    mujoco.mj_forward(model, data)
    assert data.ten_length[:2] == pytest.approx([0.301, 0.0])


@pytest.mark.parametrize(
    ("old", "new", "free"),
    [
        ('"0.3 0.302"', '"0.3 0.602"', "roll"),
        ('range="-0.002 0.002"', 'range="-0.002 0.002" limited="false"', "yaw"),
        ('<joint name="yaw"', '<joint type="slide" name="yaw"', "yaw"),
    ],
    ids=["wide", "unlimited", "play of a slide"],
)
def test_joints_that_a_tendon_leaves_free(old: str, new: str, free: str, tmp_path: Path) -> None:
    text = DIFFERENTIAL % (body("m1") + body("m2"), INERTIAL_ELEMENT, INERTIAL_ELEMENT)
    with pytest.raises(GtauError, match=f"no motor moves {free} and no closure holds it"):
        _ = InverseDynamics(load(text.replace(old, new), tmp_path)).loops


def test_springs_are_mujoco_s(tmp_path: Path, rng: np.random.Generator) -> None:
    text = """<mujoco><compiler angle="radian"/><worldbody><body><inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>
      <joint name="j" axis="0 1 0" stiffness="7" springref="0.4"/><body pos="1 0 0">
      <inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/><joint name="s" type="slide" stiffness="90" ref="0.1"/></body>
      </body></worldbody></mujoco>"""
    robot = load(text, tmp_path)
    assert [joint.spring for joint in robot.joints] == [0.4, 0.0]
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    q, still = rng.normal(size=(4, 2)), np.zeros((4, 2))
    found = InverseDynamics(robot).torques(q, still, still, {"k_j": 7.0, "k_s": 90.0})
    for k in range(4):
        data.qpos[:] = q[k]
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(found[k], -data.qfrc_passive, rtol=1e-12)
    write_native(robot, tmp_path / "copy.yaml")
    assert read_native(tmp_path / "copy.yaml") == robot


FLOATING_LEGS = """<mujoco><compiler angle="radian"/><worldbody><body name="trunk" pos="0 0 1" euler="0.4 -0.2 0.3">
  <freejoint/><inertial mass="5" pos="0.1 0 0" diaginertia="1 2 2"/>%s</body></worldbody>
  <actuator>%s</actuator></mujoco>"""
LEG = """<body pos="{x} 0 0"><inertial mass="1" pos="0.02 0.1 0" diaginertia="0.01 0.02 0.02"/>
  <joint name="{n}_hip" axis="1 0 0"/><body pos="0 0.08 0"><joint name="{n}_knee" axis="0 1 0"/>
  <inertial mass="0.7" pos="0 0.01 -0.2" diaginertia="0.02 0.02 0.01"/></body></body>"""


def legs_of(tmp_path: Path) -> Path:
    motors = "".join(f'<motor joint="{n}_{joint}"/>' for n in "AB" for joint in ("hip", "knee"))
    path = tmp_path / "legs.xml"
    path.write_text(FLOATING_LEGS % (LEG.format(n="A", x=0.3) + LEG.format(n="B", x=-0.3), motors))
    return path


@pytest.mark.parametrize("turned", [False, True])
def test_a_floating_base_is_fixed_where_it_is(turned: bool, tmp_path: Path, rng: np.random.Generator) -> None:
    """MuJoCo's torques, with the free joint removed, are some parameters' of the model, knees and hips of both legs."""
    path = legs_of(tmp_path)
    robot = load_robot(path, base={"rpy": [0.5, 1.0, -2.0]} if turned else "fixed")
    text = path.read_text().replace("<freejoint/>", "")
    if turned:  # MuJoCo's Euler angles turn with the body, about x, y and z
        angles = Rotation.from_euler("xyz", [0.5, 1.0, -2.0]).as_euler("XYZ")
        text = text.replace("0.4 -0.2 0.3", " ".join(map(repr, angles.tolist())))
    assert explains(robot, mujoco.MjModel.from_xml_string(text), rng)
    assert not explains(load_robot(path, base={"rpy": [0.5, -1.0, -2.0]}), mujoco.MjModel.from_xml_string(text), rng)


def test_one_leg_with_the_other_held(tmp_path: Path, rng: np.random.Generator) -> None:
    path = legs_of(tmp_path)
    robot = load_robot(path, base="fixed", joints=["A_*"], held={"B_hip": 0.3})
    assert robot.actuated == ("A_hip", "A_knee")
    assert "2 joints held as chosen (rad, m): 'B_hip' at 0.3, 'B_knee' at 0" in robot.notes
    model = mujoco.MjModel.from_xml_string(path.read_text().replace("<freejoint/>", ""))
    assert explains(robot, model, rng, held={"B_hip": 0.3})


def explains(
    robot: Robot, model: mujoco.MjModel, rng: np.random.Generator, held: dict[str, float] | None = None
) -> bool:
    """Whether some parameters of the robot give MuJoCo's torques of its joints, the others standing still."""
    data, samples = mujoco.MjData(model), 60
    q, qd, qdd = rng.normal(size=(3, samples, len(robot.actuated)))
    expected = np.zeros_like(q)
    for name, value in (held or {}).items():
        data.joint(name).qpos[0] = value
    for k in range(samples):
        for i, name in enumerate(robot.actuated):
            data.joint(name).qpos[0], data.joint(name).qvel[0] = q[k, i], qd[k, i]
            data.qacc[model.joint(name).dofadr[0]] = qdd[k, i]
        accelerations = data.qacc.copy()
        mujoco.mj_inverse(model, data)
        data.qacc[:] = accelerations
        expected[k] = [data.qfrc_inverse[model.joint(name).dofadr[0]] for name in robot.actuated]
    W = InverseDynamics(robot, "inertial").regressor(q, qd, qdd).reshape(expected.size, -1)
    chi = np.linalg.lstsq(W, expected.ravel(), rcond=1e-12)[0]
    return bool(np.abs(W @ chi - expected.ravel()).max() < 1e-9 * np.abs(expected).max())


def test_what_cannot_be_held(tmp_path: Path) -> None:
    path = legs_of(tmp_path)
    for options, sentence in (
        ({"joints": ["C_*"]}, "no joint of robot 'legs' is called 'C_*'; choose from A_hip,"),
        ({"held": {"A_hup": 0.0}}, "'held': unknown joint 'A_hup'; did you mean 'A_hip'?"),
        ({"joints": ["A_*"], "held": {"A_hip": 0.0}}, "joint 'A_hip' is both among the 'joints' that move and 'held'"),
        ({"held": dict.fromkeys(("A_hip", "A_knee", "B_hip", "B_knee"), 0.0)}, "all joints are held"),
        ({"base": "free"}, "write 'fixed', how the base is turned"),
    ):
        with pytest.raises(GtauError) as refused:
            load_robot(path, **({"base": "fixed"} | options))
        assert sentence in str(refused.value)


def test_without_mujoco(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(
        GtauError, match=r"MJCF file needs the package mujoco.*pip install 'gtau\[mujoco\]' \(in a clone: pip install"
    ):
        load(BODY % ("", ""), tmp_path)


def four_bar(joint: str, turned: float, tip: str) -> str:
    return f"""<mujoco><compiler angle="radian"/><worldbody>
      <body name="crank"><joint name="crank" axis="0 1 0"/><geom size="0.1"/>
        <body name="rod" pos="0 0 0.2" euler="0 {1.1902899497 + turned} 0"><joint name="rod" {joint}/><geom size="0.1"/>
          <site name="a" pos="{tip}"/></body></body>
      <body name="rocker" pos="0.5 0 0"><joint name="rocker" axis="0 1 0"/><geom size="0.1"/>
        <site name="b" pos="0 0 0.4"/></body></worldbody>
      <equality><connect site1="a" site2="b"/></equality><actuator><motor joint="crank"/></actuator></mujoco>"""


@pytest.mark.parametrize(
    ("turned", "tip"),
    [(0.0, "0 0 0.5385164807"), (-np.pi / 2, "0.5385164807 0 0"), (-0.7, "0.3469228389 0 0.4118788645")],
)
def test_a_rod_on_a_ball_keeps_its_mass(turned: float, tip: str, tmp_path: Path, rng: np.random.Generator) -> None:
    """It spins idly about its axis, however drawn: one pin is locked. In a plane, the ball does what a hinge does."""
    hinged, balled = (load(four_bar(joint, turned, tip), tmp_path) for joint in ('axis="0 1 0"', 'type="ball"'))
    assert [note for note in balled.notes if "idle" in note]
    (rod,) = (joint.name for joint in balled.joints if joint.has_mass and joint.name not in ("crank", "rocker"))
    chi = random_parameters(hinged, rng)
    q, qd, qdd = rng.uniform(-0.3, 0.3, (3, 50, 1))
    expected = InverseDynamics(hinged, "inertial").torques(q, qd, qdd, inertial(chi))
    renamed = {key.replace("_rod", f"_{rod}"): value for key, value in inertial(chi).items()}
    found = InverseDynamics(balled, "inertial").torques(q, qd, qdd, renamed)
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


def crank_rod_and_lever(cut: str) -> str:
    """A crank moves a lever, which swings in another plane, by a rod between two balls; the loop is cut somewhere."""
    along = np.array([0.3, 0.12, 0.05])
    length = np.linalg.norm(along)
    turned, _ = Rotation.align_vectors([along / length], [[1, 0, 0]])
    quat, back = (" ".join(map(str, R.as_quat(scalar_first=True))) for R in (turned, turned.inv()))
    lever = '<body name="lever" {}><inertial pos="0 {} 0.02" mass="0.5" diaginertia="0.001 0.0005 0.001"/>{}</body>'
    hinged = lever.format('pos="0.4 0 0.05"', 0.06, '<joint name="lever" axis="1 0 0"/>')
    carried = lever.format(f'pos="{length} 0 0" quat="{back}"', -0.06, '<joint name="b2" type="ball"/>')
    rod = f"""<body name="rod" pos="0.1 0 0" quat="{quat}"><inertial pos="0.15 0 0" mass="0.2"
      diaginertia="0.00002 0.002 0.002"/>%s</body>"""
    on_ball = rod % f'<joint name="b1" type="ball"/>{carried if cut == "hinge" else ""}'
    tip = f'<connect body1="rod" body2="lever" anchor="{length} 0 0"/>'
    loops = {"rod": tip, "free": '<connect body1="rod" body2="crank" anchor="0 0 0"/>' + tip}
    loops["hinge"] = "".join(f'<connect body1="lever" body2="world" anchor="{x} -0.12 0"/>' for x in (0, 0.1))
    return f"""<mujoco><compiler angle="radian"/><worldbody>
      <body name="crank"><joint name="crank" axis="0 1 0"/><inertial pos="0.05 0 0" mass="0.4" diaginertia="1 1 1"/>
      {"" if cut == "free" else on_ball}</body>{"" if cut == "hinge" else hinged}
      {rod % "<freejoint/>" if cut == "free" else ""}</worldbody>
      <equality>{loops[cut]}</equality><actuator><motor joint="crank"/></actuator></mujoco>"""


@pytest.mark.parametrize(
    ("cut", "pin", "place"), [("hinge", "b1", "ball 'b2'"), ("free", "rod", "closure 1")], ids=["hinge", "free"]
)
def test_a_rod_between_two_balls_spins_idly_wherever_its_loop_is_cut(
    cut: str, pin: str, place: str, tmp_path: Path, rng: np.random.Generator
) -> None:
    robot, at_the_rod = (load(crank_rod_and_lever(each), tmp_path) for each in (cut, "rod"))
    assert robot.notes == (
        f"joint '{pin}' is idle, since its axis passes through the centre of {place}; it was locked at zero, its link "
        f"a part of '{pin}_y'",
    )
    q, qd, qdd = rng.uniform(-0.2, 0.2, (3, 20, 1))
    found, expected = (
        InverseDynamics(each, "inertial").torques(q, qd, qdd, stated_inertias(each)) for each in (robot, at_the_rod)
    )
    np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize("link", ["", '<inertial pos="0 0 0" mass="0.01" diaginertia="1e-7 1e-7 1e-7"/>'])
def test_three_hinges_between_a_rod_and_a_ball_are_a_ball(link: str, tmp_path: Path, rng: np.random.Generator) -> None:
    """Whichever axis is the last, with links in between whose masses the crank then carries at the point."""
    ball = '<joint name="b1" type="ball"/>'
    x, y, z = (
        f'<joint name="b1_{name}" axis="{axis}"/>' for name, axis in {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}.items()
    )
    text = crank_rod_and_lever("hinge").replace(ball, x + y + z)
    if link:
        rod = re.search(r'(<body name="rod"[^>]*>)(.*?/>)', text, re.DOTALL)
        assert rod is not None
        text = text.replace(rod[0] + x + y + z, f"{rod[1]}{x}{link}<body>{y}{link}<body>{rod[2]}{z}")
        text = text.replace("</body></body></body>", "</body>" * 5)
    robot, at_the_rod = load(text, tmp_path), load(crank_rod_and_lever("rod"), tmp_path)
    assert robot.notes[0].startswith("the joints 'b1_x', 'b1_y', 'b1_z' meet in one point")
    stated = stated_inertias(at_the_rod)
    for kind, per_mass in {"m": 1.0, "mx": 0.1, "yy": 0.01, "zz": 0.01}.items():
        stated[f"{kind}_crank"] += 0.02 * per_mass if link else 0.0
    q, qd, qdd = rng.uniform(-0.2, 0.2, (3, 20, 1))
    found, expected = (
        InverseDynamics(each, "inertial").torques(q, qd, qdd, chi)
        for each, chi in ((robot, stated_inertias(robot)), (at_the_rod, stated))
    )
    np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize("axis", ["0 0 1", "1 0 0"])
def test_a_leg_that_slides_between_two_balls(axis: str, tmp_path: Path, rng: np.random.Generator) -> None:
    """It spins idly too, whichever axis of its frame it lies along; compared with a leg on a hinge."""

    def leg(joint: str) -> str:
        tip = axis.replace("1", "0.4")
        turned = 1.1071487178 - (0.0 if axis == "0 0 1" else np.pi / 2)  # towards the rocker's tip
        return f"""<mujoco><compiler angle="radian"/><worldbody>
          <body name="leg" euler="0 {turned} 0"><joint name="leg" {joint}/><geom size="0.1"/>
            <body name="rod" pos="{axis.replace("1", "0.4944271910")}"><joint name="rod" type="slide" axis="{axis}"/>
              <geom size="0.1"/><site name="a" pos="{tip}"/></body></body>
          <body name="rocker" pos="0.8 0 0"><joint name="rocker" axis="0 1 0"/><geom size="0.1"/>
            <site name="b" pos="0 0 0.4"/></body></worldbody>
          <equality><connect site1="a" site2="b"/></equality><actuator><motor joint="rod"/></actuator></mujoco>"""

    hinged, balled = (load(leg(joint), tmp_path) for joint in ('axis="0 1 0"', 'type="ball"'))
    (lower,) = (joint.name for joint in balled.joints if joint.has_mass and joint.name not in ("rod", "rocker"))
    chi = inertial(random_parameters(hinged, rng))
    q, qd, qdd = rng.uniform(-0.1, 0.1, (3, 50, 1))
    expected = InverseDynamics(hinged, "inertial").torques(q, qd, qdd, chi)
    renamed = {key.replace("_leg", f"_{lower}"): value for key, value in chi.items()}
    found = InverseDynamics(balled, "inertial").torques(q, qd, qdd, renamed)
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


def inertial(chi: dict[str, float]) -> dict[str, float]:
    """Those of the links alone: a ball has no friction."""
    return {key: value for key, value in chi.items() if key.split("_")[0] in INERTIAL}


SPRUNG = """<mujoco><compiler angle="radian"/><worldbody><site name="post" pos="0.3 0 0.5"/>
  <body name="upper" pos="0 0 0.1"><inertial mass="1" pos="0.1 0 0" diaginertia="1 1 1"/>
  <joint name="shoulder" axis="0 1 0"/>
  <body name="plate" pos="0.1 0 0" euler="0.2 0.1 0"><inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>
  <site name="hook" pos="0.1 0.02 0.03"/></body>
  <body name="lower" pos="0.5 0 0"><inertial mass="1" pos="0.1 0 0" diaginertia="1 1 1"/>
  <joint name="elbow" axis="0 1 0"/><site name="tip" pos="0.2 0 0.1"/></body></body></worldbody>
  <tendon><spatial name="coil" stiffness="200" springlength="0.3" damping="4">
  <site site="post"/><site site="hook"/></spatial>
  <spatial name="gas" damping="2"><site site="hook"/><site site="tip"/></spatial>
  <spatial name="dead" stiffness="20" springlength="0.1 0.2"><site site="post"/><site site="tip"/></spatial>
  <spatial name="bent" stiffness="20"><site site="post"/><site site="hook"/><site site="tip"/></spatial></tendon>
  <actuator><motor joint="shoulder"/><motor joint="elbow"/>
  <general tendon="gas" gainprm="0" biastype="affine" biasprm="70 -30 0"/></actuator></mujoco>"""


def test_straight_tendons_are_springs_between_points(tmp_path: Path, rng: np.random.Generator) -> None:
    """With stiffness and damping of the tendon, or a force without control; MuJoCo's own torques are compared."""
    robot = load(SPRUNG, tmp_path)
    assert [(spring.name, spring.a.body, spring.b.body) for spring in robot.springs] == [
        ("coil", "ground", "shoulder"),
        ("gas", "shoulder", "elbow"),
    ]
    assert all(spring.parameters == ("f0", "k", "c") for spring in robot.springs)
    for name in ("dead", "bent"):
        assert any(f"tendon '{name}' acts as a spring" in note and "not modelled" in note for note in robot.notes)
    assert robot.actuated == ("shoulder", "elbow")
    assert not any("left out" in note for note in robot.notes)
    spec = mujoco.MjSpec.from_string(SPRUNG)
    for tendon in spec.tendons[2:]:
        spec.delete(tendon)
    model = spec.compile()
    model.opt.gravity[:] = 0
    data = mujoco.MjData(model)
    chi = {"f0_coil": 60.0, "k_coil": 200.0, "c_coil": 4.0, "f0_gas": 70.0, "k_gas": 30.0, "c_gas": 2.0}
    q, qd = rng.normal(size=(2, 10, 2))
    tau = InverseDynamics(robot).torques(q, qd, 0 * q, chi)
    for position, speed, expected in zip(q, qd, tau, strict=True):
        data.qpos, data.qvel = position, speed
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(-(data.qfrc_passive + data.qfrc_actuator), expected, rtol=1e-9, atol=1e-8)


def test_tendons_without_a_name_are_springs_too(tmp_path: Path) -> None:
    named = load(SPRUNG.replace(' name="dead"', ' name="tendon 1"'), tmp_path)
    bare = SPRUNG.replace(' name="coil"', "").replace(' name="gas"', "")
    bare = bare[: bare.index("<general")] + "</actuator></mujoco>"
    robot = load(bare.replace(' name="dead"', ' name="tendon 1"'), tmp_path)
    assert [spring.name for spring in robot.springs] == ["tendon 2", "tendon 3"]
    for found, meant in zip(robot.springs, named.springs, strict=True):
        assert (found.a, found.b) == (meant.a, meant.b)
    assert [spring.parameters for spring in robot.springs] == [("f0", "k", "c"), ("c",)]


GRIPPER = """<mujoco><worldbody><body name="palm">
  <body name="l" pos="0 0.1 0"><inertial mass="0.3" pos="0 0.1 0" diaginertia="1e-2 1e-2 1e-2"/>
  <joint name="left" type="slide" axis="0 1 0.5"/></body>
  <body name="r" pos="0 -0.1 0"><inertial mass="0.5" pos="0 0.1 0" diaginertia="1e-2 1e-2 1e-2"/>
  <joint name="right" type="slide" axis="0 -1 0.5"/></body></body></worldbody>
  <equality><joint joint1="left" joint2="right" polycoef="0.01 2 0 0 0"/></equality>
  <tendon><fixed name="both"><joint joint="left" coef="0.3"/><joint joint="right" coef="0.5"/></fixed></tendon>
  <actuator><position name="jaws" tendon="both"/></actuator></mujoco>"""


def test_the_motor_of_a_gripper_pulls_a_fixed_tendon(tmp_path: Path, rng: np.random.Generator) -> None:
    """Its position is MuJoCo's length of the tendon, and its force moves the fingers as MuJoCo's does."""
    robot = load(GRIPPER, tmp_path)
    assert robot.actuated == ("jaws",)
    assert robot.joint("jaws").parameters == "drive"
    assert any("'jaws' is the motor that pulls 'left', 'right' by a fixed tendon" in note for note in robot.notes)
    model = mujoco.MjModel.from_xml_string(GRIPPER)
    data = mujoco.MjData(model)
    motion = InverseDynamics(robot).motion(*rng.uniform(-0.1, 0.1, (3, 1, 6)))
    chi = {"m_left": 0.3, "m_right": 0.5}
    values = np.array([chi.get(name, 0.0) for name in InverseDynamics(robot).parameter_names])
    tau = InverseDynamics(robot).full.torques_along(Coordinates(robot), motion, values)[0]
    for k in range(6):
        data.qpos, data.qvel = motion.c[:2, k], motion.yd[:2, k]
        mujoco.mj_forward(model, data)
        assert data.ten_length[0] == pytest.approx(motion.c[2, k], abs=1e-12)
        assert data.efc_pos[0] == pytest.approx(0.0, abs=1e-12)
        effort = np.zeros(2)
        mujoco.mj_mulM(model, data, effort, motion.ydd[:2, k].copy())
        effort += data.qfrc_bias
        assert tau[k] * motion.yd[2, k] == pytest.approx(effort @ motion.yd[:2, k], rel=1e-9)


def test_a_linkage_on_the_ground_is_no_moving_base(tmp_path: Path) -> None:
    """A passive bar that carries a link but not the motor stays, though the base is fixed."""
    text = """<mujoco><worldbody>
      <body name="crank"><inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/><joint name="crank" axis="0 1 0"/></body>
      <body name="rocker" pos="0.5 0 0"><inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>
      <joint name="rocker" axis="0 1 0"/>
      <body name="bar" pos="0 0 0.3"><inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>
      <joint name="bar" axis="0 1 0"/></body>
      </body></worldbody><equality><connect body1="bar" body2="crank" anchor="-0.5 0 -0.1"/></equality>
      <actuator><motor joint="crank"/></actuator></mujoco>"""
    (tmp_path / "linkage.xml").write_text(text)
    robot = load_robot(tmp_path / "linkage.xml", base="fixed")
    assert [joint.name for joint in robot.joints] == ["crank", "rocker", "bar"]


INERTIAL_ELEMENT = '<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>'


def body(name: str, pos: str = "0 0 0", inner: str = "") -> str:
    """A body on a hinge about y of its own name."""
    return f'<body name="{name}" pos="{pos}">{INERTIAL_ELEMENT}<joint name="{name}" axis="0 1 0"/>{inner}</body>'


def test_the_linkage_of_a_gripper_is_held_with_it(tmp_path: Path) -> None:
    """A tendon pulls the crank of a four-bar on an arm: nothing of the four-bar is left to move."""
    gripper = body("crank") + body("rocker", "0.5 0 0", body("bar", "0 0 0.3"))
    text = f"""<mujoco><worldbody>{body("arm", inner=gripper)}</worldbody>
      <equality><connect body1="bar" body2="crank" anchor="-0.5 0 -0.1"/></equality>
      <tendon><fixed name="t"><joint joint="crank" coef="1"/></fixed></tendon>
      <actuator><motor joint="arm"/><motor tendon="t"/></actuator></mujoco>"""
    robot = load(text, tmp_path)
    assert [joint.name for joint in robot.joints] == ["arm"]
    assert any("3 joints held since a tendon pulls them" in note for note in robot.notes)


def test_coupled_joints_without_a_motor_are_scenery(tmp_path: Path) -> None:
    text = f"""<mujoco><worldbody>{body("arm")}{body("turn", "1 0 0", body("rise"))}</worldbody>
      <equality><joint joint1="rise" joint2="turn" polycoef="0 0.1 0 0 0"/></equality>
      <actuator><motor joint="arm"/></actuator></mujoco>"""
    robot = load(text, tmp_path)
    assert [joint.name for joint in robot.joints] == ["arm"]
    assert not robot.couplings


def test_each_robot_on_a_moving_base_has_its_own(tmp_path: Path) -> None:
    arms = "".join(body(f"base{k}", f"{k} 0 0", body(f"arm{k}")) for k in (1, 2))
    motors = "".join(f'<motor joint="arm{k}"/>' for k in (1, 2))
    (tmp_path / "two.xml").write_text(f"<mujoco><worldbody>{arms}</worldbody><actuator>{motors}</actuator></mujoco>")
    robot = load_robot(tmp_path / "two.xml", base="fixed")
    assert [joint.name for joint in robot.joints] == ["arm1", "arm2"]


def test_loops_without_actuators_are_refused(tmp_path: Path) -> None:
    text = f"""<mujoco><worldbody>{body("crank")}{body("rocker", "0.5 0 0", body("bar", "0 0 0.3"))}</worldbody>
      <equality><connect body1="bar" body2="crank" anchor="-0.5 0 -0.1"/></equality></mujoco>"""
    with pytest.raises(GtauError, match="it has loops but no actuators, so the actuated joints are unknown"):
        load(text, tmp_path)


def test_motors_on_both_fingers_of_a_gripper_are_named(tmp_path: Path) -> None:
    """Simulators drive both slides of a gripper that has one motor; of many joints the refusal names these two."""
    text = f"""<mujoco><worldbody>{body("arm", inner=body("left") + body("right"))}</worldbody>
      <equality><joint joint1="left" joint2="right" polycoef="0 -1 0 0 0"/></equality>
      <actuator><motor joint="arm"/><motor joint="left"/><motor joint="right"/></actuator></mujoco>"""
    with pytest.raises(
        GtauError, match=r"tie left, right at home; mark 1 of them passive \(in MJCF, without an actuat"
    ):
        _ = InverseDynamics(load(text, tmp_path)).loops
    (tmp_path / "robot.xml").write_text(text)
    assert InverseDynamics(load_robot(tmp_path / "robot.xml", held={"left": 0.0})).actuated == ("arm",)


def test_springs_that_leave_joints_free_are_to_be_held(tmp_path: Path) -> None:
    """As in a leg whose shin bends: the refusal says how to hold it, and then it loads."""
    text = as_mjcf().replace('<position joint="right"/>', "").replace('"right" axis', '"right" stiffness="9" axis')
    (tmp_path / "robot.xml").write_text(text)
    with pytest.raises(GtauError) as refused:
        _ = InverseDynamics(load_robot(tmp_path / "robot.xml")).loops
    assert "hold the springs right if they hardly deflect, by 'held: {right: POSITION}' or a list" in str(refused.value)
    model = InverseDynamics(load_robot(tmp_path / "robot.xml", held={"right": 0.1}))
    assert model.loops is not None
    assert model.actuated == ("left",)


def test_what_brakes_a_floating_base_in_the_simulator_is_said(tmp_path: Path) -> None:
    path = legs_of(tmp_path)
    path.write_text(path.read_text().replace("<freejoint/>", '<joint type="free" damping="2"/>'))
    note = "damping, friction or armature of the floating 'trunk' acts in the simulator and is not modelled"
    assert note in load_robot(path, base="floating").notes
    assert note not in load_robot(path, base="fixed").notes


DRAWN = """<mujoco><worldbody><body name="trunk">{joints}<geom size="0.1"/>
  <body name="left" pos="0 0.1 0"><joint name="a" axis="0 1 0"/><geom size="0.1"/></body>
  <body name="right" pos="0 -0.1 0"><joint name="b" axis="0 1 0"/><geom size="0.1"/></body></body></worldbody>
  <actuator><motor joint="a"/><motor joint="b"/></actuator></mujoco>"""
SLIDES = '<joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/><joint type="slide"/>'
TURNS = '<joint name="rx" axis="1 0 0"/><joint name="ry" axis="0 1 0"/><joint name="trunk"/>'


@pytest.mark.parametrize("turns", [TURNS, '<joint name="trunk" type="ball"/>'], ids=["hinges", "ball"])
def test_six_joints_without_motors_are_a_floating_base(turns: str, tmp_path: Path) -> None:
    def loaded(text: str, base: str | None = None) -> Robot:
        (tmp_path / "robot.xml").write_text(text)
        return load_robot(tmp_path / "robot.xml", base=base)

    free = loaded(DRAWN.format(joints="<freejoint/>"), "floating")
    text = DRAWN.format(joints=SLIDES + turns)
    drawn = loaded(text, "floating")
    assert replace(drawn, name=free.name) == free
    assert drawn.floating == "trunk"
    assert drawn.notes[-1].endswith("were taken as the floating base 'trunk', as they have no motor and carry the rest")
    assert loaded(text, "fixed").actuated == ("a", "b")
    with pytest.raises(GtauError, match="have no motor and carry the rest, as a base that floats; write 'robot: "):
        loaded(text)
    gantry = text.replace("<actuator>", '<actuator><motor joint="x"/>')
    assert "x" in loaded(gantry).actuated


ATTACHED = (
    '<mujoco><asset><model name="m" file="{}.xml"/></asset><worldbody><body><attach model="m" body="a" prefix="x"/>'
    "</body></worldbody></mujoco>"
)


def test_includes_that_multiply_are_refused(tmp_path: Path) -> None:
    for k in range(1, 40):
        (tmp_path / f"{k}.xml").write_text(f"""<mujoco>{f'<include file="{k + 1}.xml"/>' * 2}</mujoco>""")
    (tmp_path / "robot.xml").write_text(BODY % ('<include file="1.xml"/>' * 2, ""))
    with pytest.raises(GtauError, match="MuJoCo refuses the file"):
        read_mjcf(tmp_path / "robot.xml")


def test_includes_are_found_where_mujoco_finds_them(tmp_path: Path) -> None:
    """In the folder of the outermost file, whatever folder the file between is in."""
    (tmp_path / "sub").mkdir()
    (tmp_path / "robot.xml").write_text(BODY % ("", '<include file="sub/one.xml"/>'))
    (tmp_path / "sub" / "one.xml").write_text('<mujoco><include file="two.xml"/></mujoco>')
    (tmp_path / "two.xml").write_text('<mujoco><worldbody><body pos="nan 0 0"/></worldbody></mujoco>')
    with pytest.raises(GtauError, match="pos of <body> is 'nan 0 0'"):
        read_mjcf(tmp_path / "robot.xml")


def test_mujoco_dies_and_hangs_in_a_process_of_its_own(tmp_path: Path) -> None:
    (tmp_path / "dies.xml").write_text(ATTACHED.format("dies"))
    with pytest.raises(GtauError, match=r"MuJoCo crashes on the file \(SIG.*; reduce it to the robot alone"):
        refuse_deadly(tmp_path / "dies.xml")
    os.mkfifo(tmp_path / "hangs.xml")
    with pytest.raises(GtauError, match="MuJoCo works on the file for more than 1 s"):
        refuse_deadly(tmp_path / "hangs.xml", patience=1.0)
    size = '<mujoco><asset><hfield name="h" nrow="40000" ncol="40000" size="1 1 1 1"/></asset></mujoco>'
    (tmp_path / "large.xml").write_text(size)
    with pytest.raises(GtauError, match="MuJoCo needs more than 4 GiB of memory"):
        refuse_deadly(tmp_path / "large.xml")
    (tmp_path / "good.xml").write_text(BODY % ("", ""))
    refuse_deadly(tmp_path / "good.xml")
