"""Robot files whose base floats, as MJCF, URDF and robot file, against MuJoCo and Pinocchio."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from free_flyer import free_state, pinocchio_state
from typer.testing import CliRunner

from gtau.cli.commands import app
from gtau.errors import GtauError
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.geometry import refuse_floating
from gtau.robots.readers.native import read_native, write_native
from gtau.robots.robot import Robot

LEG = """<body pos="{x} 0 0"><inertial mass="1" pos="0.02 0.1 0" diaginertia="0.01 0.02 0.02"/>
  <joint name="{n}_hip" axis="1 0 0"/><body pos="0 0.08 0"><joint name="{n}_knee" axis="0 1 0"/>
  <inertial mass="0.7" pos="0 0.01 -0.2" diaginertia="0.02 0.02 0.01"/></body></body>"""
MOTORS = "".join(f'<motor joint="{n}_{joint}"/>' for n in "AB" for joint in ("hip", "knee"))
LEGS = f"""<mujoco><compiler angle="radian"/><worldbody>
  <body name="door" pos="9 9 9"><joint name="hinge"/><geom size="1"/></body>
  <body name="trunk" pos="0 0 1" euler="0.4 -0.2 0.3"><freejoint/>
  <inertial mass="5" pos="0.1 0 0" diaginertia="1 2 2"/>{LEG.format(n="A", x=0.3)}{LEG.format(n="B", x=-0.3)}</body>
  </worldbody><actuator>{MOTORS}</actuator></mujoco>"""

MASS = (
    '<inertial><origin xyz="0.1 -0.02 0.03" rpy="0.2 0.1 -0.3"/><mass value="{}"/>'
    '<inertia ixx="0.2" ixy="0.01" ixz="-0.02" iyy="0.3" iyz="0.01" izz="0.25"/></inertial>'
)
ARM = f"""<robot name="arm"><link name="world"/><link name="bus">{MASS.format(4)}</link>
  <link name="upper">{MASS.format(2)}</link><link name="lower">{MASS.format(1)}</link>
  <joint name="free" type="floating"><parent link="world"/><child link="bus"/></joint>
  <joint name="a" type="revolute"><parent link="bus"/><child link="upper"/><origin xyz="0.3 0.1 0.2" rpy="0.3 -0.4 1"/>
    <axis xyz="0 0 1"/><limit lower="-1" upper="2" effort="1" velocity="1"/></joint>
  <joint name="b" type="prismatic"><parent link="upper"/><child link="lower"/><origin xyz="0.1 0.5 0" rpy="1 0.2 0"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""
OTHER = '<body name="other"><freejoint/><geom size="1"/><body><joint name="k"/><geom size="1"/></body></body>'
SAMPLES = 60


def written(tmp_path: Path, name: str, text: str) -> Path:
    (tmp_path / name).write_text(text)
    return tmp_path / name


def states(robot: Robot, rng: np.random.Generator) -> np.ndarray:
    return rng.normal(size=(3, SAMPLES, len(robot.actuated)))


def explained(robot: Robot, states: np.ndarray, tau: np.ndarray) -> float:
    """What the best parameters of the model leave of the torques, as a share of the largest."""
    W = InverseDynamics(robot, "inertial").regressor(*states).reshape(tau.size, -1)
    chi = np.linalg.lstsq(W, tau.ravel(), rcond=1e-12)[0]
    return float(np.abs(W @ chi - tau.ravel()).max() / np.abs(tau).max())


def test_an_mjcf_file_with_a_free_joint(tmp_path: Path, rng: np.random.Generator) -> None:
    mujoco = pytest.importorskip("mujoco")
    path = written(tmp_path, "legs.xml", LEGS)
    robot = load_robot(path, base="floating")
    assert robot.floating == "trunk"
    assert robot.actuated[6:] == ("A_hip", "A_knee", "B_hip", "B_knee")
    model = mujoco.MjModel.from_xml_string(LEGS)
    data, free = mujoco.MjData(model), model.jnt_dofadr[1]
    q, qd, qdd = states(robot, rng)
    tau = np.zeros_like(q)
    for k in range(SAMPLES):
        state = free_state(q[k, :6], qd[k, :6], qdd[k, :6])
        at = model.jnt_qposadr[1]
        data.qpos[at : at + 3] = state.p
        mujoco.mju_mat2Quat(data.qpos[at + 3 : at + 7], state.R.ravel())
        data.qvel[free : free + 6] = [*state.v, *state.omega]
        acceleration = np.zeros(model.nv)
        acceleration[free : free + 6] = [*state.a, *state.alpha]
        for i, name in enumerate(robot.actuated[6:], start=6):
            data.joint(name).qpos[0], data.joint(name).qvel[0] = q[k, i], qd[k, i]
            acceleration[model.joint(name).dofadr[0]] = qdd[k, i]
        data.qacc[:] = acceleration
        mujoco.mj_inverse(model, data)
        wrench = data.qfrc_inverse[free : free + 6]
        tau[k, :6] = state.six(state.R.T @ wrench[:3], wrench[3:])
        tau[k, 6:] = [data.qfrc_inverse[model.joint(name).dofadr[0]] for name in robot.actuated[6:]]
    assert explained(robot, (q, qd, qdd), tau) < 1e-10


def test_a_urdf_file_that_floats(tmp_path: Path, rng: np.random.Generator) -> None:
    """Its floating joint, or where it has none its root link."""
    pin = pytest.importorskip("pinocchio")
    path = written(tmp_path, "arm.urdf", ARM)
    free = load_robot(path, base="floating")
    rooted = ARM.replace('<link name="world"/>', "").replace(
        ARM[ARM.index('  <joint name="free"') : ARM.index('  <joint name="a"')], ""
    )
    root = load_robot(written(tmp_path, "root.urdf", rooted), base="floating")
    assert root.with_file(source="") == free.with_file(source="")
    assert free.floating == "base"
    model = pin.buildModelFromXML(rooted, pin.JointModelFreeFlyer())
    data = model.createData()
    model.gravity.linear = np.array(free.gravity)
    q, qd, qdd = states(free, rng)
    tau = np.zeros_like(q)
    for k in range(SAMPLES):
        state = free_state(q[k, :6], qd[k, :6], qdd[k, :6])
        found = pin.rnea(model, data, *pinocchio_state(state, q[k, 6:], qd[k, 6:], qdd[k, 6:]))
        tau[k] = [*state.six(found[:3], found[3:6]), *found[6:]]
    assert explained(free, (q, qd, qdd), tau) < 1e-10


AXES = ("1 0 0", "0 1 0", "0 0 1")
DRAWN = "".join(
    f'<link name="s{k}">{{mass}}</link><joint name="base{k}" type="{kind}"><parent link="s{k}"/>'
    f'<child link="{"bus" if k == 5 else f"s{k + 1}"}"/><axis xyz="{AXES[k % 3]}"/>'
    '<limit lower="-9" upper="9" effort="{effort}" velocity="1"/></joint>'
    for k, kind in enumerate(["prismatic"] * 3 + ["revolute"] * 3)
)
MOTOR = '<transmission name="of_{0}"><joint name="{0}"/></transmission>'
ARM_MOTORS = MOTOR.format("a") + MOTOR.format("b")


@pytest.mark.parametrize(
    ("mass", "effort", "motors", "floats"),
    [
        ("", 9, "", True),  # links without masses
        (MASS.format(1), 0, "", True),  # joints without effort
        (MASS.format(1), 9, ARM_MOTORS, True),  # joints without transmissions
        (MASS.format(1), 9, "", False),  # a gantry
        ("", 0, ARM_MOTORS + "".join(MOTOR.format(f"base{k}") for k in range(6)), False),
    ],
)
def test_six_joints_of_a_urdf_without_motors_are_a_floating_base(
    mass: str, effort: int, motors: str, floats: bool, tmp_path: Path
) -> None:
    free = slice(ARM.index('  <joint name="free"'), ARM.index('  <joint name="a"'))
    six = DRAWN.replace("{mass}", mass).replace("{effort}", str(effort))
    text = ARM.replace(ARM[free], six).replace('<link name="world"/>', "").replace("</robot>", motors + "</robot>")
    path = written(tmp_path, "drawn.urdf", text)
    if not floats:
        assert load_robot(path).actuated == (*(f"base{k}" for k in range(6)), "a", "b")
        return
    with pytest.raises(GtauError, match="have no motor and carry the rest, as a base that floats; write 'robot: "):
        load_robot(path)
    assert load_robot(path, base="fixed").actuated == ("a", "b")
    drawn, known = load_robot(path, base="floating"), load_robot(written(tmp_path, "arm.urdf", ARM), base="floating")
    assert (drawn.floating, drawn.motors) == ("base5", ("a", "b"))
    assert [replace(joint, antecedent="") for joint in drawn.joints[6:]] == [
        replace(joint, antecedent="") for joint in known.joints[6:]
    ]


def test_an_arm_of_seven_joints_keeps_its_motors(tmp_path: Path) -> None:
    links = "".join(f'<link name="l{k}"/>' for k in range(8))
    joints = "".join(
        f'<joint name="j{k}" type="continuous"><origin xyz="0 0 0.2" rpy="{k} 0 0"/><parent link="l{k}"/>'
        f'<child link="l{k + 1}"/></joint>'
        for k in range(7)
    )
    path = written(tmp_path, "arm.urdf", f'<robot name="arm">{links}{joints}</robot>')
    assert load_robot(path).actuated == tuple(f"j{k}" for k in range(7))


def test_a_robot_file_keeps_its_floating_base(tmp_path: Path) -> None:
    robot = load_robot(written(tmp_path, "arm.urdf", ARM), base="floating")
    write_native(robot, tmp_path / "arm.yaml")
    assert "floating: base" in (tmp_path / "arm.yaml").read_text()
    assert read_native(tmp_path / "arm.yaml") == robot
    fixed, again = (load_robot(tmp_path / name, base="fixed") for name in ("arm.urdf", "arm.yaml"))
    assert again.with_file(source="") == fixed.with_file(source="")


def test_parts_of_a_robot_float_with_its_base(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    path = written(tmp_path, "legs.xml", LEGS)
    robot = load_robot(path, base="floating", joints=["A_*"], held={"B_hip": 0.3})
    assert robot.actuated == (*robot.base, "A_hip", "A_knee")
    with pytest.raises(GtauError, match="unknown joint 'trunk'"):
        load_robot(path, base="floating", held={"trunk": 0.3})


def test_an_arm_whose_joint_is_called_base(tmp_path: Path) -> None:
    path = written(tmp_path, "arm.urdf", ARM.replace('name="a"', 'name="base"'))
    assert load_robot(path, base="floating").floating == "floating_base"


@pytest.mark.parametrize(
    ("name", "text", "sentence"),
    [
        (
            "two.xml",
            LEGS.replace("<worldbody>", f"<worldbody>{OTHER}"),
            "the bodies 'other' and 'trunk' float; give the file of one robot",
        ),
        (
            "planar.urdf",
            ARM.replace('"floating"', '"planar"'),
            "joint 'free' is planar, so unknown guiding forces act on the base",
        ),
        (
            "two.urdf",
            ARM.replace('type="prismatic"', 'type="floating"'),
            "joint 'b' floats and does not carry the whole robot",
        ),
    ],
    ids=["two bases", "planar", "an object"],
)
def test_what_cannot_float(name: str, text: str, sentence: str, tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    with pytest.raises(GtauError) as refused:
        load_robot(written(tmp_path, name, text), base="floating")
    assert sentence in str(refused.value)


def test_a_root_link_is_noted_as_fixed_where_nothing_says_so(tmp_path: Path) -> None:
    """Two joints on it: it may be the trunk of a robot that walks."""
    end = ARM.index("</robot>")
    free = slice(ARM.index('  <joint name="free"'), ARM.index('  <joint name="a"'))
    second = '<joint name="c" type="continuous"><parent link="bus"/><child link="wheel"/></joint><link name="wheel"/>'
    rooted = (ARM[:end] + second + ARM[end:]).replace('<link name="world"/>', "").replace(ARM[free], "")
    path = written(tmp_path, "arm.urdf", rooted)
    noted = [note for note in load_robot(path).notes if "root link was taken as fixed" in note]
    assert len(noted) == 1
    assert noted[0].endswith("write --base floating (base: floating) if it moved")
    for base in ("fixed", {"rpy": [0, 0, 0]}, "floating"):
        assert "root link" not in " ".join(load_robot(path, base=base).notes)


@pytest.mark.parametrize("angle", [90, -180.0, "90"])
def test_a_base_turned_by_degrees_is_refused(angle: float | str, tmp_path: Path) -> None:
    path = written(tmp_path, "arm.urdf", ARM)
    with pytest.raises(GtauError, match=r"base\.rpy.*rad is more than a turn; write deg\(\.\.\.\) where"):
        load_robot(path, base={"rpy": [0, angle, 0]})
    assert load_robot(path, base={"rpy": [0, "deg(90)", 0]}).gravity == pytest.approx((9.80665, 0, 0), abs=1e-9)


def test_the_command_shows_a_floating_base(tmp_path: Path) -> None:
    path = written(tmp_path, "arm.urdf", ARM)
    shown = CliRunner().invoke(app, ["robot", str(path), "--base", "floating"])
    assert shown.exit_code == 0, shown.output
    words = " ".join(shown.output.split())
    assert "8 degrees of freedom" in words
    assert "floating base base; its six equations are the rows base_x to base" in words
    assert "21 without rotor inertia, friction and offset" in words  # 10 + 7 + 4
    refused = CliRunner().invoke(app, ["robot", str(path)])
    assert "base: fixed" in refused.output
    assert "base: floating" in refused.output


def test_fixing_a_base_is_advised_only_where_it_did_not_move(tmp_path: Path) -> None:
    robot = load_robot(written(tmp_path, "arm.urdf", ARM), base="floating")
    with pytest.raises(GtauError, match=r"simulation is not supported there; if the base did not move, fix it by"):
        refuse_floating(robot, "simulation is")
    refuse_floating(load_robot("five-bar"), "simulation is")
