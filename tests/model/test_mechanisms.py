"""Mechanisms of many kinds: balls as chains, several motors a leg, small platforms, tilted bases, couplings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from engines import closed_torques, random_parameters
from robots_for_tests import OBLIQUE, four_bar, hexapod, home

from gtau.errors import GtauError
from gtau.model.base_parameters import base_parameters, symmetric_order
from gtau.model.home import close_home, load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.geometry import identical_legs, turning
from gtau.robots.placement import pose_of
from gtau.robots.robot import Attachment, Closure, Coupling, Joint, Mdh, Platform, Pose, Robot


def near_home(robot: Robot, rng: np.random.Generator, samples: int = 8, span: float = 0.05):
    q = home(robot) + span * rng.uniform(-1, 1, (samples, len(robot.actuated)))
    return q, *rng.normal(size=(2, *q.shape))


def agrees_with_pinocchio(robot: Robot, rng: np.random.Generator) -> None:
    chi, states = random_parameters(robot, rng), near_home(robot, rng)
    expected = closed_torques(robot, chi, *states)
    found = InverseDynamics(robot).torques(*states, chi)
    assert np.abs(found - expected).max() < 1e-9 * np.abs(expected).max()


@pytest.mark.slow
def test_a_ball_as_a_chain_of_massless_links(rng: np.random.Generator) -> None:
    """Three revolute joints and a weld are a connect, whose balls have neither links nor coordinates."""
    tied = hexapod()
    joints, closures = list(tied.joints), []
    for leg, closure in enumerate(tied.closures):
        joints += [
            replace(joint, actuated=False, parameters="none")
            for joint in turning(f"ball {leg}", closure.a.body, closure.a.placement, "xyz")
        ]
        closures.append(Closure("weld", Attachment(f"ball {leg}"), closure.b))
    chained = close_home(replace(tied, joints=tuple(joints), closures=tuple(closures)).with_file(home_given=False))
    chi, states = random_parameters(tied, rng), near_home(tied, rng)
    expected = InverseDynamics(tied).torques(*states, chi)
    assert InverseDynamics(chained).torques(*states, chi) == pytest.approx(expected, rel=1e-9)
    agrees_with_pinocchio(chained, rng)


def test_two_motors_in_one_leg(rng: np.random.Generator) -> None:
    robot = load_robot("five-bar")
    driven = {"left", "left_forearm"}
    robot = replace(robot, joints=tuple(replace(joint, actuated=joint.name in driven) for joint in robot.joints))
    agrees_with_pinocchio(robot, rng)


@pytest.mark.parametrize("dof", [("z",), ("x", "z"), ("rx",), ("x", "z", "ry"), ("x", "y", "z", "rx", "ry", "rz")])
def test_platforms_of_few_and_many_freedoms(dof: tuple[str, ...], rng: np.random.Generator) -> None:
    """A platform welded to the end of a chain that has just its freedoms."""
    axes = {name: tuple(np.eye(3)["xyz".index(name[-1])]) for name in dof}
    joints, before = [], "ground"
    for name in dof:
        kind = "revolute" if name.startswith("r") else "prismatic"
        joints.append(Joint(name, before, kind, Pose(), axes[name], home=0.1))
        before = name
    chain = Robot("chain", tuple(joints), gravity=OBLIQUE)
    x, y, z = (0.1 if name in dof else 0.0 for name in "xyz")
    rotation = Pose()
    for name in (name for name in dof if name.startswith("r")):
        turned = [0.0, 0.0, 0.0]
        turned["xyz".index(name[-1])] = 0.1
        rotation = pose_of(rotation.rotation @ Pose((0, 0, 0), tuple(turned)).rotation, np.zeros(3))
    platform = Platform("P", dof, Pose((x, y, z), rotation.rpy))
    robot = replace(chain, platforms=(platform,), closures=(Closure("weld", Attachment(before), Attachment("P")),))
    agrees_with_pinocchio(robot, rng)
    # a body that moves with the last link acts as if it were part of it
    chi, states = random_parameters(robot, rng), near_home(robot, rng)
    one = {name: value for name, value in chi.items() if not name.endswith("_P")}
    for name in [name for name in chi if name.endswith("_P")]:
        one[f"{name.removesuffix('P')}{before}"] += chi[name]
    expected = InverseDynamics(chain).torques(*states, one)
    assert InverseDynamics(robot).torques(*states, chi) == pytest.approx(expected, rel=1e-8, abs=1e-9)


def test_a_tilted_base_is_a_tilted_gravity(rng: np.random.Generator) -> None:
    robot = load_robot("delta")
    tilt = Pose(rpy=(0.3, -0.4, 0.9))

    def tilted(joint: Joint) -> Joint:
        if joint.antecedent != "ground":
            return joint
        rotation = tilt.rotation @ joint.placement.rotation
        return replace(joint, placement=pose_of(rotation, tilt.rotation @ joint.placement.position))

    turned = replace(
        robot,
        joints=tuple(map(tilted, robot.joints)),
        platforms=(
            replace(robot.platforms[0], home=pose_of(tilt.rotation, tilt.rotation @ robot.platforms[0].home.position)),
        ),
    )
    gravity = tuple(tilt.rotation.T @ np.array(robot.gravity))
    chi, states = random_parameters(robot, rng), near_home(robot, rng)
    expected = InverseDynamics(replace(robot, gravity=gravity)).torques(*states, chi)
    assert InverseDynamics(turned).torques(*states, chi) == pytest.approx(expected, rel=1e-9)


def test_motors_through_a_transmission(rng: np.random.Generator) -> None:
    """Torques at the motors of the TX40 are those of its joints through the transposed inverse of the gear matrix."""
    robot = load_robot("staubli-tx40")
    arm = Robot("arm", tuple(replace(joint, actuated=True) for joint in robot.joints[:6]))
    R = np.diag([32.0, 32, 45, -48, 45, 32])
    R[5, 4] = 32.0
    zero = np.array([0, -np.pi / 2, np.pi / 2, 0, 0, 0])  # as its log's description says
    q, qd, qdd = rng.normal(size=(3, 20, 6))
    chi = random_parameters(robot, rng)
    motors = {name: chi[name] for name in chi if "motor" in name}
    at_joints = InverseDynamics(arm).torques(q, qd, qdd, {name: chi[name] for name in chi if name not in motors})
    at_motors = at_joints @ np.linalg.inv(R)
    for k in range(6):
        speed = (qd @ R.T)[:, k]
        ia, fv, fs, off = (chi[f"{kind}_motor_{k + 1}"] for kind in ("ia", "fv", "fs", "off"))
        at_motors[:, k] += ia * (qdd @ R.T)[:, k] + fv * speed + fs * np.sign(speed) + off
    found = InverseDynamics(robot).torques((q - zero) @ R.T, qd @ R.T, qdd @ R.T, chi)
    assert found == pytest.approx(at_motors, rel=1e-9, abs=1e-9)


def test_the_coupled_wrist_has_columns_of_its_own() -> None:
    """Rotor inertia and friction of motor 6 act in rows 5 and 6, beside the friction of joint 6."""
    found = base_parameters(InverseDynamics(load_robot("staubli-tx40")))
    assert {name.kind for name in found.names if name.body == "motor_6"} == {"ia", "fv", "fs", "off"}
    assert {name.kind for name in found.names if name.body == "joint_6"} >= {"fv", "fs"}


def test_friction_of_joints_is_regrouped_with_their_motors() -> None:
    found = base_parameters(InverseDynamics(load_robot("staubli-tx40")))
    friction = {name.body for name in found.names if name.kind == "fs"}
    assert friction == {*(f"motor_{k}" for k in range(1, 7)), "joint_6"}


def test_a_loop_and_a_coupling_together(rng: np.random.Generator) -> None:
    """A four-bar whose crank turns through a gear with an offset."""
    loop = four_bar()
    motor = Joint("motor", "ground", "revolute", parameters="drive", home=3.0 * loop.joints[0].home + 0.4)
    joints = (*(replace(joint, actuated=False) for joint in loop.joints), motor)
    robot = replace(loop, joints=joints, couplings=(Coupling("motor", (("1", 3.0),), 0.4),))
    agrees_with_pinocchio(robot, rng)


def test_a_coupling_that_is_one_too_many_is_refused() -> None:
    robot = replace(load_robot("ur10e"), couplings=(Coupling("elbow_joint", (("wrist_1_joint", 1.0),)),))
    with pytest.raises(GtauError, match="actuation is redundant"):
        _ = InverseDynamics(robot).loops


# Legs that are alike


def test_legs_are_told_by_their_geometry() -> None:
    sizes = {
        name: sorted(len(group) for group in identical_legs(load_robot(name)))
        for name in ("orthoglide", "delta", "3-rrr", "gough-stewart", "five-bar", "ur10e", "palletiser")
    }
    assert sizes == {
        "orthoglide": [3],
        "delta": [3],
        "3-rrr": [3],
        "gough-stewart": [6],
        "five-bar": [2],
        "ur10e": [1],
        "palletiser": [1],
    }
    delta = load_robot("delta")
    longer = replace(
        delta, joints=tuple(replace(j, placement=Mdh(d=0.43)) if j.name == "22" else j for j in delta.joints)
    )
    assert identical_legs(longer) == [[("11", "21", "31"), ("13", "23", "33")], [("12", "22", "32")]]
    closures = (Closure("connect", Attachment("31", Mdh(d=1.0)), delta.closures[0].b), *delta.closures[1:])
    assert len(identical_legs(replace(delta, closures=closures))) == 2
    limited = tuple(replace(joint, limits=delta.joints[1].limits, home=joint.home + 0.1) for joint in delta.joints)
    assert len(identical_legs(replace(delta, joints=limited))) == 1


def test_like_legs_regroup_alike() -> None:
    order = symmetric_order(load_robot("delta"), InverseDynamics(load_robot("delta")).parameter_names)
    assert order[:3] == ["xx_P", "xy_P", "xz_P"]
    assert order[10:14] == ["xx_11", "xx_12", "xx_13", "xy_11"]
    found = base_parameters(InverseDynamics(load_robot("gough-stewart")))
    forms = {
        formula.replace(f"_{leg}", "_#")
        for name, formula in found.regroupings.items()
        for leg in "123456"
        if name.removesuffix("R").endswith(f"_cylinder_{leg}")
    }
    assert len(forms) * 6 == sum("_cylinder_" in name for name in found.names)
