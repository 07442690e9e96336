"""A base that floats: regressor of Pinocchio's free flyer, and base parameters as the literature has them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from free_flyer import regressor
from robots_for_tests import four_bar, hexapod, planar_3rrr, seven_r, tree

from gtau.errors import GtauError
from gtau.model.base_parameters import base_parameters, independent_columns
from gtau.model.home import close_home
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.singularities import random_motion
from gtau.robots.geometry import float_base
from gtau.robots.robot import INERTIAL, Attachment, Joint, Pose, Robot, Spring


def quadruped() -> Robot:
    """Four legs of three revolute joints on a trunk that floats, as most robots of that kind."""
    joints: list[Joint] = []
    for name, x, y in (("FL", 0.24, 0.05), ("FR", 0.24, -0.05), ("RL", -0.24, 0.05), ("RR", -0.24, -0.05)):
        side = np.sign(y)
        joints += [
            Joint(f"{name}_hip", "ground", "revolute", Pose((x, y, 0.0)), (1.0, 0.0, 0.0)),
            Joint(f"{name}_thigh", f"{name}_hip", "revolute", Pose((0.0, side * 0.08, 0.0)), (0.0, 1.0, 0.0)),
            Joint(f"{name}_calf", f"{name}_thigh", "revolute", Pose((0.0, 0.0, -0.25)), (0.0, 1.0, 0.0)),
        ]
    return float_base(Robot("quadruped", tuple(joints)), "trunk")


def states(robot: Robot, rng: np.random.Generator, samples: int = 30) -> np.ndarray:
    """Positions, rates and accelerations (3, samples, n)."""
    return rng.uniform(-1, 1, (3, samples, len(robot.actuated))) * np.array([1.2, 2.0, 5.0])[:, None, None]


@pytest.mark.parametrize(
    "robot", [float_base(seven_r()), float_base(tree()), quadruped()], ids=lambda robot: robot.name
)
def test_the_regressor_is_that_of_a_free_flyer(robot: Robot, rng: np.random.Generator) -> None:
    model = InverseDynamics(robot, "inertial")
    q, qd, qdd = states(robot, rng, 10)
    W = model.regressor(q, qd, qdd)
    for k in range(len(q)):
        expected, names = regressor(robot, q[k], qd[k], qdd[k])
        assert set(names) == set(model.parameter_names)
        own = W[k][:, [model.parameter_names.index(name) for name in names]]
        assert own == pytest.approx(expected, abs=1e-10 * np.abs(expected).max())


def rank_of_base_rows(model: InverseDynamics, rng: np.random.Generator) -> int:
    """Rank of the six base rows alone, at random states."""
    motion = random_motion(model, 2 * len(model.parameter_names), rng)
    full = model.full
    W = np.zeros((len(model.actuated), motion.c.shape[1], len(model.parameter_names)))
    W[full.rows, :, full.columns] = full(model.layout, motion)
    return len(independent_columns(W[:6].reshape(-1, len(model.parameter_names)))[0])


@pytest.mark.parametrize(
    "robot", [float_base(seven_r()), float_base(tree()), quadruped()], ids=lambda robot: robot.name
)
def test_base_equations_alone_identify_what_all_equations_do(robot: Robot, rng: np.random.Generator) -> None:
    """The theorem of Ayusawa, Venture and Nakamura (IJRR 33(3), 2014): the joints' torques add nothing.

    A free body has ten base parameters; a revolute joint adds seven, a slide four, as its link turns no other way.
    """
    model = InverseDynamics(robot, "inertial")
    slides = sum(joint.kind == "prismatic" for joint in robot.joints[6:])
    count = 10 + 7 * (len(robot.joints) - 6 - slides) + 4 * slides
    assert (base_parameters(model).count, rank_of_base_rows(model, rng)) == (count, count)


def test_a_base_that_floats_tells_more_than_one_that_is_fixed() -> None:
    fixed, floating = seven_r(), float_base(seven_r())
    assert base_parameters(InverseDynamics(fixed, "inertial")).count < 7 * 7
    names = base_parameters(InverseDynamics(floating)).names
    assert not [name for name in names if name.startswith(("ia_base", "fv_base", "fs_base", "off_base"))]


@pytest.mark.parametrize("make", [four_bar, pytest.param(hexapod, marks=pytest.mark.slow)])
def test_loops_may_stand_on_a_base_that_floats(make: Callable[[], Robot], rng: np.random.Generator) -> None:
    """With the base at rest its six joints change nothing of the loops; their rows carry the whole weight."""
    fixed = close_home(make())
    floating = close_home(float_base(make()))
    one, other = InverseDynamics(fixed), InverseDynamics(floating)
    motion = random_motion(one, 5, rng)
    q, qd, qdd = (each[one.layout.actuated].T for each in (motion.c, motion.yd, motion.ydd))
    still = np.zeros((5, 6))
    chi = {
        name: float(value)
        for name, value in zip(one.parameter_names, rng.normal(size=len(one.parameter_names)), strict=True)
    }
    expected = one.torques(q, qd, qdd, chi)
    chi |= {"m_base": 3.0}
    tau = other.torques(*(np.hstack([still, each]) for each in (q, qd, qdd)), chi)
    assert tau[:, 6:] == pytest.approx(expected, rel=1e-9, abs=1e-9)
    weight = other.torques(*(np.hstack([still, each]) for each in (q, 0 * qd, 0 * qdd)), chi)[:, :3]
    mass = sum(value for name, value in chi.items() if name.startswith("m_"))
    assert weight == pytest.approx(np.tile(-mass * np.array(fixed.gravity), (5, 1)), rel=1e-9)


def test_a_spring_inside_the_robot_does_not_push_its_base(rng: np.random.Generator) -> None:
    """Whatever lies within has no wrench on the whole: drives, friction, and springs between base and links."""
    ends = Attachment("ground", Pose((0.1, 0.2, 0.3))), Attachment("2", Pose((0.05, 0.1, 0.0)))
    robot = float_base(replace(seven_r(), springs=(Spring("coil", *ends),)))
    assert robot.springs[0].a.body == "base"
    model = InverseDynamics(robot)
    W = model.regressor(*states(robot, rng, 5))
    inner = [k for k, name in enumerate(model.parameter_names) if name.split("_")[0] not in INERTIAL]
    assert len(inner) == 4 * 7 + 2
    assert np.abs(W[:, :6, inner]).max() < 1e-12
    assert np.abs(W[:, 6:, inner]).max(axis=(0, 1)).min() > 1e-3


def test_platforms_that_the_ground_guides_cannot_float() -> None:
    with pytest.raises(GtauError, match=r"moves in .* of the ground alone, which a floating base carries along"):
        float_base(planar_3rrr())
    with pytest.raises(GtauError, match="its base 'base' floats already"):
        float_base(float_base(seven_r()))
    with pytest.raises(GtauError, match="used twice"):
        float_base(seven_r(), "3")


def test_the_joints_of_the_base_stand_first() -> None:
    with pytest.raises(GtauError, match="its base '1' floats, but its first joints are not 1_x"):
        replace(seven_r(), floating="1")
