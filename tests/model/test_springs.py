"""Springs between two points: their torques against MuJoCo, their power, and what they regroup with."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from gtau.errors import GtauError
from gtau.model.base_parameters import base_parameters
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.kinematics import poses
from gtau.model.singularities import random_motion
from gtau.robots.geometry import attached, identical_legs
from gtau.robots.parts import select_joints
from gtau.robots.readers.native import native_text, parse_native
from gtau.robots.robot import Attachment, Pose, Robot, Spring
from gtau.simulation.mujoco_plant import robot_spec

ARM = """robot: arm
joints:
  turret: {antecedent: ground, theta: q}
  arm: {antecedent: turret, alpha: pi/2, theta: q, d: 0.1}
  forearm: {antecedent: arm, d: 0.5, theta: q}
springs:
  gas: {between: [{body: turret, xyz: [0.1, 0, 0.3]}, {body: arm, d: 0.3, r: 0.02}], damping: true}
  coil: {between: [{body: ground, xyz: [0.1, 0.4, 0.3]}, {body: forearm, xyz: [0.3, 0.05, 0.02]}], damping: true}
"""
KINDS = ("f0", "k", "c")
COILS = {"f0_gas": 300.0, "k_gas": 200.0, "c_gas": 5.0, "f0_coil": 50.0, "k_coil": 2000.0, "c_coil": 3.0}


def with_springs(name: str) -> Robot:
    """A robot with loops of the catalog, and a spring from the ground, or its platform, to a link."""
    robot = load_robot(name)
    ends = {
        "five-bar": (("ground", (0.1, -0.2, 0.05)), (robot.joints[-1].name, (0.05, 0.02, 0.0))),
        "delta": (("ground", (0.0, 0.1, 0.2)), (robot.tool, (0.02, 0.0, 0.01))),
    }[name]
    a, b = (Attachment(body, Pose(xyz)) for body, xyz in ends)
    return replace(robot, springs=(Spring("coil", a, b, KINDS),))


@pytest.mark.parametrize("constant", [False, True])
def test_the_torques_are_mujocos(constant: bool, rng: np.random.Generator) -> None:
    """By tendons with stiffness, length at rest and damping, and by ones that an actuator gives a constant force."""
    robot = parse_native(ARM, "arm.yaml")
    chi = COILS | ({"k_gas": 0.0, "f0_coil": -50.0} if constant else {})
    compiled = robot_spec(mujoco, robot, chi).compile()
    assert compiled.nu == (2 if constant else 0)
    compiled.opt.gravity[:] = 0
    data = mujoco.MjData(compiled)
    q, qd, qdd = rng.normal(size=(3, 30, 3))
    tau = InverseDynamics(robot).torques(q, qd, qdd, chi)
    for position, speed, expected in zip(q, qd, tau, strict=True):
        data.qpos, data.qvel = position, speed
        mujoco.mj_forward(compiled, data)
        found = -(data.qfrc_passive + data.qfrc_actuator)
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * np.abs(tau).max())


@pytest.mark.parametrize("name", ["five-bar", "delta"])
def test_the_motors_give_what_the_springs_take(name: str, rng: np.random.Generator) -> None:
    """Power of the motors against the rate of the spring's length, by differences, through the loops."""
    robot = with_springs(name)
    model = InverseDynamics(robot)
    chi = {"f0_coil": 40.0, "k_coil": 300.0, "c_coil": 7.0}
    motion = random_motion(model, 8, rng)
    values = np.array([chi.get(each, 0.0) for each in model.parameter_names])
    tau = model.full.torques_along(model.layout, motion, values)
    for k in range(8):
        lengths, h = [], 1e-6
        for step in (-h, 0.0, h):
            c = model.layout.retract(motion.c[:, k : k + 1], step * motion.yd[:, k : k + 1])[:, 0]
            lengths.append(_length(model, robot, c))
        rate = (lengths[2] - lengths[0]) / (2 * h)
        force = chi["f0_coil"] - chi["k_coil"] * lengths[1] - chi["c_coil"] * rate
        power = tau[:, k] @ motion.yd[model.layout.actuated, k]
        assert power == pytest.approx(-force * rate, rel=1e-6, abs=1e-6)


def _length(model: InverseDynamics, robot: Robot, c: np.ndarray) -> float:
    found = poses(model.layout, c)
    (spring,) = robot.springs
    return float(np.linalg.norm(attached(spring.b, found)[1] - attached(spring.a, found)[1]))


def test_a_spring_across_one_joint_acts_as_a_mass() -> None:
    """Of a spring from the ground to a link of a revolute joint, ``k l dl/dq`` is that of a moment h r k / g."""
    text = """robot: swing
joints: {arm: {antecedent: ground, rpy: [0, pi/2, 0], axis: [0, 1, 0], type: revolute}}
springs: {coil: {between: [{body: ground, xyz: [0, 0, 0.6]}, {body: arm, xyz: [0.4, 0, 0]}]}}
"""
    base = base_parameters(InverseDynamics(parse_native(text, "swing.yaml")))
    assert "f0_coil" in base.standard
    assert "k_coil" not in base.standard
    position = list(InverseDynamics(parse_native(text, "swing.yaml")).parameter_names).index("k_coil")
    row = base.standard.index("mx_arm")
    assert base.matrix[row, position] == pytest.approx(-0.6 * 0.4 / 9.80665)


def test_a_preload_along_a_slide_is_an_offset() -> None:
    text = """robot: lift
joints: {lift: {antecedent: ground, type: prismatic}}
springs: {gas: {between: [{body: ground, xyz: [0, 0, -1]}, {body: lift}]}}
"""
    base = base_parameters(InverseDynamics(parse_native(text, "lift.yaml")))
    assert set(base.standard) >= {"m_lift", "k_gas"}
    assert base.regroupings["m_liftR"].endswith("- 0.10197 f0_gas")


def test_a_robot_file_keeps_its_springs() -> None:
    robot = parse_native(ARM, "arm.yaml")
    assert parse_native(native_text(robot), "again.yaml") == robot
    assert robot.springs[0].parameters == KINDS


def test_springs_move_with_what_is_held() -> None:
    """The turret held: one end of the gas spring is on the ground; the forearm held: one of the coil is on the arm."""
    robot = parse_native(ARM, "arm.yaml")
    part = select_joints(robot, ["arm"], {"turret": 0.3, "forearm": -0.4})
    assert [(spring.a.body, spring.b.body) for spring in part.springs] == [("ground", "arm")] * 2
    q, qd = np.array([[0.7]]), np.array([[1.1]])
    state = (np.array([each]) for each in ([0.3, 0.7, -0.4], [0.0, 1.1, 0.0], [0.0, 0.0, 0.0]))
    whole = InverseDynamics(robot).torques(*state, COILS)
    assert InverseDynamics(part).torques(q, qd, 0 * q, COILS)[0, 0] == pytest.approx(whole[0, 1])
    assert not select_joints(robot, ["forearm"], {}).springs[:-1]


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        (
            "{between: [{body: arm}, {body: arm, xyz: [1, 0, 0]}]}",
            "spring 's' ties 'arm' to itself",
        ),
        ("{between: [{body: arm}, {body: leg}]}", "spring 's' is attached to 'leg', which is not a joint"),
        (
            "{between: [{body: ground}, {body: arm}], preload: false, stiffness: false}",
            "has none of preload",
        ),
        ("{between: [{body: ground}]}", "springs.s.between"),
        ("{between: [{body: ground}, {body: arm}], stiffness: 300}", "springs.s.stiffness"),
    ],
)
def test_springs_that_cannot_be(entry: str, message: str) -> None:
    text = f"robot: r\njoints: {{arm: {{antecedent: ground, theta: q}}}}\nsprings: {{s: {entry}}}\n"
    with pytest.raises(GtauError, match=message):
        parse_native(text, "r.yaml")


def test_a_leg_with_a_spring_is_unlike_the_others() -> None:
    """Five-bar: the legs are alike, with one spring on the same place of each too, and not with one alone."""
    robot = load_robot("five-bar")
    assert len(identical_legs(robot)) == 1
    forearms = [joint.name for joint in robot.joints if not joint.actuated]
    springs = tuple(
        Spring(f"s{name}", Attachment("ground", Pose((0.1, 0.2, 0.3))), Attachment(name, Pose((0.05, 0.0, 0.0))))
        for name in forearms
    )
    assert len(identical_legs(replace(robot, springs=springs))) == 1
    assert len(identical_legs(replace(robot, springs=springs[:1]))) == 2
