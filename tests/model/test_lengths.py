"""Torques by changed lengths against those of the robot with its placements moved by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.kinematics import placements
from gtau.model.lengths import Constant, VariableTorques
from gtau.robots.geometry import moved_ends
from gtau.robots.placement import pose_of
from gtau.robots.robot import Placement, Robot


def lengthened(robot: Robot, length: Constant, change: float) -> Robot:
    """The robot whose length is larger at all its places."""
    moves = iter([change * sum((d for k, d in length.directions if k == place), np.zeros(3))
                  for place in range(len(placements(robot)))])  # fmt: skip

    def moved(placement: Placement) -> Placement:
        move = next(moves)
        return pose_of(placement.rotation, placement.position + move) if move.any() else placement

    joints = tuple(replace(joint, placement=moved(joint.placement)) for joint in robot.joints)
    closures, springs = moved_ends(robot, lambda end: replace(end, placement=moved(end.placement)))
    return replace(robot, joints=joints, closures=closures, springs=springs)


@pytest.mark.parametrize("name", ["ur10e", "five-bar", "3-rrr", "delta", "orthoglide"])
def test_torques_are_those_of_the_robot_with_other_lengths(name: str) -> None:
    model = InverseDynamics(load_robot(name))
    rng, n = np.random.default_rng(1), len(model.actuated)
    time, phase = np.linspace(0.0, 1.0, 20), rng.uniform(0, 6, (n, 1))
    home, size = model.home[model.layout.actuated][:, None], 0.02
    q = home + size * (np.sin(3 * time + phase) - np.sin(phase))
    qd, qdd = 3 * size * np.cos(3 * time + phase), -9 * size * np.sin(3 * time + phase)
    chi = rng.normal(size=len(model.parameter_names))
    torques, motion = VariableTorques(model, model.parameter_names), model.motion(q, qd, qdd)
    for number, length in enumerate(torques.constants):
        change = np.zeros(len(torques.constants))
        change[number] = 1e-4 * model.layout.length
        other = InverseDynamics(lengthened(model.robot, length, change[number]))
        expected = other.columns(model.parameter_names).torques_along(other.layout, other.motion(q, qd, qdd), chi)
        assert_allclose(torques(motion, chi, change), expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
