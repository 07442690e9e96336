"""The two reference engines agree with each other, and with robots small enough for a formula."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest
from engines import Mujoco, Pinocchio, closed_motion, closed_torques, random_parameters, tree_torques
from robots_for_tests import CLOSED, home, tree

from gtau.robots.robot import Attachment, Closure, Joint, Mdh, Pose, Robot


def close_to(expected):
    scale = np.abs(expected).max()
    return pytest.approx(expected, rel=1e-9, abs=1e-10 * scale)


def parallelogram(crank: float, base: float) -> Robot:
    """Crank 1, coupler 2 and rocker 3 in the plane of gravity."""
    return Robot(
        name="parallelogram",
        joints=(
            Joint("1", "ground", "revolute", home=pi / 2),
            Joint("2", "1", "revolute", Mdh(d=crank), actuated=False, home=-pi / 2),
            Joint("3", "ground", "revolute", Mdh(d=base), actuated=False, home=1.2),
        ),
        closures=(
            Closure("connect", Attachment("2", Pose((base, 0.0, 0.0))), Attachment("3", Pose((crank, 0.0, 0.0)))),
        ),
        gravity=(0.0, -9.81, 0.0),
    )


def motions(robot, rng, count=8, span=0.08):
    """Actuated positions about home with velocities and accelerations of unit size, each (count, n)."""
    n = len(robot.actuated)
    return home(robot) + span * rng.uniform(-1, 1, (count, n)), *rng.normal(size=(2, count, n))


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
    n, h = len(robot.actuated), 1e-4
    steps = np.concatenate([np.eye(n), -np.eye(n)]) * h
    tau = closed_torques(robot, chi, home(robot) + steps, 0 * steps, 0 * steps)
    stiffness = (tau[:n] - tau[n:]) / (2 * h)
    assert stiffness == pytest.approx(stiffness.T, abs=1e-5 * np.abs(tau).max())


@pytest.mark.parametrize("engine", [Pinocchio, Mujoco])
def test_parallelogram_has_a_formula(engine):
    """The coupler of a parallelogram moves on a circle without turning; its weight is a point's."""
    robot = parallelogram(crank=0.3, base=0.6)
    chi = dict.fromkeys((f"{kind}_{link}" for link in "123" for kind in ("xy", "xz", "yz", "mx", "my", "mz")), 0.0)
    chi |= dict.fromkeys((f"{kind}_{link}" for link in "123" for kind in ("xx", "yy", "zz", "m")), 1.0)
    chi |= {"mx_2": 0.2, "my_2": 0.1, "zz_2": 1.3, "xx_2": 1.1, "yy_2": 1.2, "m_2": 2.0}
    chi |= {"ia_1": 0.4, "ia_3": 0.5, "fv_1": 0.6, "fs_3": 0.7, "off_1": 0.8, "fs_2": 0.25}
    q, qd, qdd = np.array([[1.4], [1.7]]), np.array([[0.5], [-0.5]]), np.array([[2.0], [3.0]])
    inertia = 2.0 * 0.3**2 + 1.0 + 1.0 + 0.4 + 0.5  # coupler's mass, two links about their axes, two rotors
    friction = 0.6 * qd + (0.7 + 0.25) * np.sign(qd) + 0.8
    assert closed_torques(robot, chi, q, qd, qdd, engine) == close_to(
        inertia * qdd + 2.0 * 9.81 * 0.3 * np.cos(q) + friction
    )
