"""Parameters drawn for a robot of which only the geometry is known."""

from __future__ import annotations

import numpy as np
import pytest
from plausible_parameters import body_parameters, random_bodies, random_parameters

from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.robot import INERTIAL


def test_every_body_is_rigid() -> None:
    """Masses spread in three directions: a positive definite pseudo-inertia."""
    robot = load_robot("ur10e")
    chi = random_bodies(robot, np.random.default_rng(1))
    for body in robot.bodies:
        xx, xy, xz, yy, yz, zz, *first, mass = (chi[f"{kind}_{body}"] for kind in INERTIAL)
        moment = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        spread = np.trace(moment) / 2 * np.eye(3) - moment
        pseudo = np.block([[spread, np.array([first]).T], [np.array([first]), np.array([[mass]])]])
        assert np.linalg.eigvalsh(pseudo).min() > 0


def test_two_points_about_a_frame() -> None:
    computed = body_parameters("b", np.array([1.0, 2.0]), np.array([[0.0, 1.0, 2.0], [3.0, 0.0, 0.0]]))
    assert [computed[f"{kind}_b"] for kind in INERTIAL] == pytest.approx([5, 0, 0, 22, -2, 19, 6, 1, 2, 3])


def test_only_parameters_of_the_model() -> None:
    model = InverseDynamics(load_robot("delta"))
    computed = random_parameters(model, np.random.default_rng(2))
    assert computed.keys() <= set(model.parameter_names)
    assert {f"{kind}_{joint}" for kind in ("ia", "fv", "fs", "off") for joint in model.actuated} <= computed.keys()
