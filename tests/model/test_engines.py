"""The two reference engines agree with each other, and with robots small enough for a formula."""

from __future__ import annotations

from math import atan2, cos, hypot, pi, sin

import numpy as np
import pytest
from engines import Mujoco, Pinocchio, closed_motion, closed_torques, random_parameters, tree_torques

from gtau.robots.robot import Attachment, Closure, Joint, Mdh, Platform, Pose, Robot

OBLIQUE = (1.2, -3.4, -8.9)  # a gravity that no axis hides


def close_to(expected):
    scale = np.abs(expected).max()
    return pytest.approx(expected, rel=1e-9, abs=1e-10 * scale)


def tree() -> Robot:
    """A branched tree with a slide, skew placements and a skew axis."""
    return Robot(
        name="tree",
        joints=(
            Joint("1", "ground", "revolute", Mdh(gamma=0.3, b=0.1, alpha=0.7, d=0.2, theta=-0.4, r=0.5)),
            Joint("2", "1", "prismatic", Mdh(alpha=-pi / 2, d=0.3, theta=0.2)),
            Joint("3", "2", "revolute", Pose((0.1, -0.2, 0.3), (0.4, -0.8, 1.1)), axis=(0.6, 0.0, 0.8)),
            Joint("4", "1", "revolute", Pose((0.0, 0.4, 0.1), (-0.3, 0.2, 0.9))),
        ),
        gravity=OBLIQUE,
    )


def four_bar(crank=0.3, coupler=0.7, rocker=0.5, base=0.6) -> Robot:
    """A crank-rocker about z: crank 1, coupler 2, rocker 3, coupler's end on the rocker's."""
    return Robot(
        name="four-bar",
        joints=(
            Joint("1", "ground", "revolute", home=pi / 2),
            Joint("2", "1", "revolute", Mdh(d=crank), actuated=False, home=-pi / 2),
            Joint("3", "ground", "revolute", Mdh(d=base), actuated=False, home=1.2),
        ),
        closures=(
            Closure("connect", Attachment("2", Pose((coupler, 0.0, 0.0))), Attachment("3", Pose((rocker, 0.0, 0.0)))),
        ),
        gravity=OBLIQUE,
    )


def planar_3rrr() -> Robot:
    """Three legs of two links in the plane, welded through a third revolute to a platform with x, y and rz."""
    joints, closures = [], []
    for leg in range(3):
        angle = 2 * pi * leg / 3
        foot, corner = 0.8 * np.exp(1j * angle), 0.2 * np.exp(1j * angle)
        reach = corner - foot  # upper and lower link of 0.45 m, elbow to one side
        bend = np.arccos(abs(reach) / 0.9)
        first = float(np.angle(reach)) - bend
        home = (first, 2 * bend, -first - 2 * bend)
        joints += [
            Joint(f"{leg}1", "ground", "revolute", Pose((foot.real, foot.imag, 0.1 * leg)), home=home[0]),
            Joint(f"{leg}2", f"{leg}1", "revolute", Mdh(d=0.45), actuated=False, home=home[1]),
            Joint(f"{leg}3", f"{leg}2", "revolute", Mdh(d=0.45), actuated=False, home=home[2]),
        ]
        corner_pose = Pose((corner.real, corner.imag, 0.1 * leg))
        closures.append(Closure("weld", Attachment(f"{leg}3"), Attachment("P", corner_pose)))
    return Robot("3-RRR", tuple(joints), (Platform("P", ("x", "y", "rz")),), tuple(closures), gravity=OBLIQUE)


def tripteron() -> Robot:
    """Three slides along the base axes, each with three parallel revolutes, welded to a platform with x, y and z."""
    joints, closures = [], []
    turns = [(0.0, 0.0, 0.0), (pi / 2, 0.0, pi / 2), (-pi / 2, -pi / 2, 0.0)]  # cyclic exchanges of the axes
    for leg, rpy in enumerate(turns, start=1):
        first, second = 0.5, -1.3
        joints += [
            Joint(f"{leg}1", "ground", "prismatic", Pose(rpy=rpy)),
            Joint(f"{leg}2", f"{leg}1", "revolute", actuated=False, home=first),
            Joint(f"{leg}3", f"{leg}2", "revolute", Mdh(d=0.4), actuated=False, home=second),
            Joint(f"{leg}4", f"{leg}3", "revolute", Mdh(d=0.3), actuated=False, home=-first - second),
        ]
        reach = np.array(
            [0.4 * cos(first) + 0.3 * cos(first + second), 0.4 * sin(first) + 0.3 * sin(first + second), 0]
        )
        arm = tuple(Pose(rpy=rpy).rotation @ reach)
        closures.append(Closure("weld", Attachment(f"{leg}4"), Attachment("P", Pose(arm, rpy))))
    return Robot("tripteron", tuple(joints), (Platform("P", ("x", "y", "z")),), tuple(closures), gravity=OBLIQUE)


def hexapod() -> Robot:
    """Six legs of universal joint and actuated slide, each with a point in a platform of six freedoms, home tilted."""
    joints, closures = [], []
    home = Pose((0.05, -0.03, 0.9), (0.1, -0.15, 0.2))
    for leg in range(6):
        low = 2 * pi * (leg // 2) / 3 + (0.2 if leg % 2 else -0.2)
        high = 2 * pi * (leg // 2) / 3 + (0.8 if leg % 2 else -0.8)
        foot, corner = np.array([cos(low), sin(low), 0.0]), 0.6 * np.array([cos(high), sin(high), 0.1])
        x, y, z = home.position + home.rotation @ corner - foot
        joints += [
            Joint(f"{leg}1", "ground", "revolute", Pose(tuple(foot)), (1.0, 0.0, 0.0), False, atan2(-y, z)),
            Joint(f"{leg}2", f"{leg}1", "revolute", Pose(), (0.0, 1.0, 0.0), False, atan2(x, hypot(y, z))),
            Joint(f"{leg}3", f"{leg}2", "prismatic", home=hypot(x, y, z)),
        ]
        closures.append(Closure("connect", Attachment(f"{leg}3"), Attachment("P", Pose(tuple(corner)))))
    platform = Platform("P", ("x", "y", "z", "rx", "ry", "rz"), home)
    return Robot("hexapod", tuple(joints), (platform,), tuple(closures), gravity=OBLIQUE)


CLOSED = [four_bar(), planar_3rrr(), tripteron(), hexapod()]


def motions(robot, rng, count=8, span=0.08):
    """Actuated positions about home with velocities and accelerations of unit size, each (count, n)."""
    home = np.array([joint.home for joint in robot.joints if joint.actuated])
    return home + span * rng.uniform(-1, 1, (count, home.size)), *rng.normal(size=(2, count, home.size))


def test_tree_torques_agree(rng):
    robot = tree()
    chi = random_parameters(robot, rng)
    q, qd, qdd = rng.normal(size=(3, 20, len(robot.joints)))
    expected = tree_torques(robot, chi, q, qd, qdd, Mujoco)
    assert tree_torques(robot, chi, q, qd, qdd, Pinocchio) == close_to(expected)
    assert closed_torques(robot, chi, q, qd, qdd) == close_to(expected)  # nothing to close


@pytest.mark.parametrize("robot", CLOSED, ids=lambda robot: robot.name)
def test_closed_torques_agree(robot, rng):
    chi = random_parameters(robot, rng)
    q, qd, qdd = motions(robot, rng)
    ours, theirs = (closed_motion(robot, chi, q, qd, qdd, engine) for engine in (Pinocchio, Mujoco))
    for quantity in ("q", "qd", "qdd", "J", "tau"):
        assert getattr(ours, quantity) == close_to(getattr(theirs, quantity)), quantity


@pytest.mark.parametrize("engine", [Pinocchio, Mujoco])
@pytest.mark.parametrize("robot", CLOSED, ids=lambda robot: robot.name)
def test_velocities_and_accelerations_are_derivatives(robot, engine, rng):
    chi = random_parameters(robot, rng)
    q, qd, qdd = motions(robot, rng, count=1)
    h = 1e-4
    times = np.array([[-h], [0.0], [h]])
    around = closed_motion(robot, chi, q + qd * times + qdd * times**2 / 2, qd + qdd * times, qdd.repeat(3, 0), engine)
    assert (around.q[2] - around.q[0]) / (2 * h) == pytest.approx(around.qd[1], rel=1e-5, abs=1e-5)
    assert (around.qd[2] - around.qd[0]) / (2 * h) == pytest.approx(around.qdd[1], rel=1e-4, abs=1e-4)


@pytest.mark.parametrize("robot", CLOSED, ids=lambda robot: robot.name)
def test_gravity_torques_derive_from_a_potential(robot, rng):
    """At rest and without offsets the stiffness d tau / d q is a second derivative, hence symmetric."""
    chi = random_parameters(robot, rng) | {f"off_{joint.name}": 0.0 for joint in robot.joints}
    home = np.array([joint.home for joint in robot.joints if joint.actuated])
    n, h = home.size, 1e-4
    steps = np.concatenate([np.eye(n), -np.eye(n)]) * h
    tau = closed_torques(robot, chi, home + steps, 0 * steps, 0 * steps)
    stiffness = (tau[:n] - tau[n:]) / (2 * h)
    assert stiffness == pytest.approx(stiffness.T, abs=1e-5 * np.abs(tau).max())


@pytest.mark.parametrize("engine", [Pinocchio, Mujoco])
def test_parallelogram_has_a_formula(engine):
    """The coupler of a parallelogram moves on a circle without turning; its weight is a point's."""
    robot = four_bar(crank=0.3, coupler=0.6, rocker=0.3, base=0.6)
    robot = Robot(robot.name, robot.joints, closures=robot.closures, gravity=(0.0, -9.81, 0.0))
    home = dict.fromkeys((f"{kind}_{link}" for link in "123" for kind in ("xy", "xz", "yz", "mx", "my", "mz")), 0.0)
    chi = home | dict.fromkeys((f"{kind}_{link}" for link in "123" for kind in ("xx", "yy", "zz", "m")), 1.0)
    chi |= {"mx_2": 0.2, "my_2": 0.1, "zz_2": 1.3, "xx_2": 1.1, "yy_2": 1.2, "m_2": 2.0}
    chi |= {"ia_1": 0.4, "ia_3": 0.5, "fv_1": 0.6, "fs_3": 0.7, "off_1": 0.8, "fs_2": 0.25}
    q, qd, qdd = np.array([[1.4], [1.7]]), np.array([[0.5], [-0.5]]), np.array([[2.0], [3.0]])
    inertia = 2.0 * 0.3**2 + 1.0 + 1.0 + 0.4 + 0.5  # coupler's mass, two links about their axes, two rotors
    friction = 0.6 * qd + (0.7 + 0.25) * np.sign(qd) + 0.8
    assert closed_torques(robot, chi, q, qd, qdd, engine) == close_to(
        inertia * qdd + 2.0 * 9.81 * 0.3 * np.cos(q) + friction
    )
