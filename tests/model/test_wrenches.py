"""Wrenches on bodies from outside: their torques are those of gravity on any body, and Pinocchio's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from free_flyer import free_flyer_model, free_state, pinocchio_state
from robots_for_tests import four_bar, hexapod, planar_3rrr, seven_r, tree, two_platforms

from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics, Regressor
from gtau.model.kinematics import poses
from gtau.model.singularities import random_motion
from gtau.robots.geometry import float_base
from gtau.robots.placement import WrenchFrame
from gtau.robots.robot import Robot

ROBOTS = [
    seven_r(),
    tree(),
    float_base(tree()),
    four_bar(),
    planar_3rrr(),
    hexapod(),
    two_platforms(),
    load_robot("delta"),
    load_robot("orthoglide"),
]


def torques_of(model: InverseDynamics, entries: np.ndarray, columns: Regressor, wrenches: np.ndarray) -> np.ndarray:
    """Torques (n, N) of wrenches (6 k, N)."""
    tau = np.zeros((len(model.actuated), wrenches.shape[1]))
    for entry, row, column in zip(entries, columns.rows, columns.columns, strict=True):
        tau[row] += entry * wrenches[column]
    return tau


@pytest.mark.parametrize("robot", ROBOTS, ids=lambda robot: robot.name)
def test_the_weight_of_a_body_is_a_wrench(robot: Robot, rng: np.random.Generator) -> None:
    """At rest the motors hold what gravity pulls: ``W chi = -J^T w`` with the body's weight for w, in either axes."""
    gravity = np.array([1.2, -3.4, -8.9])
    model = InverseDynamics(replace(robot, gravity=tuple(gravity)), "inertial")
    motion = random_motion(model, 10, rng)
    at_rest = replace(motion, yd=np.zeros_like(motion.yd), ydd=np.zeros_like(motion.ydd))
    felt = False
    bodies = [body for body in model.robot.bodies if f"m_{body}" in model.parameter_names]
    frames = [WrenchFrame(body, in_world) for body in bodies for in_world in (False, True)]
    columns = model.wrenches(frames)
    entries, at = columns(model.layout, at_rest), [poses(model.layout, c) for c in motion.c.T]
    for b, body in enumerate(bodies):
        mass, first = rng.uniform(1, 3), rng.normal(size=3)
        chi = dict(zip((f"{kind}_{body}" for kind in ("m", "mx", "my", "mz")), (mass, *first), strict=True))
        full = model.full
        vector = np.array([chi.get(name, 0.0) for name in model.parameter_names])
        held = full.torques(full(model.layout, at_rest), vector, len(model.actuated))
        own, world = [], []
        for R, p in (pose[body] for pose in at):
            own.append(np.concatenate([np.cross(first, R.T @ gravity), mass * R.T @ gravity]))
            world.append(np.concatenate([np.cross(mass * p + R @ first, gravity), mass * gravity]))
        scale = np.abs(held).max()
        felt = felt or scale > 1
        for k, wrench in ((2 * b, own), (2 * b + 1, world)):
            wrenches = np.zeros((6 * len(frames), len(wrench)))
            wrenches[6 * k : 6 * k + 6] = np.array(wrench).T
            found = torques_of(model, entries, columns, wrenches)
            assert found == pytest.approx(-held, abs=1e-11 * (1 + scale))
    assert felt


def test_wrenches_on_two_feet_are_those_of_pinocchio(rng: np.random.Generator) -> None:
    """One in axes of its body and one in those of the world, on a tree whose base floats, in motion."""
    robot = float_base(tree())
    model = InverseDynamics(robot, "inertial")
    frames = [WrenchFrame("g"), WrenchFrame("e", in_world=True)]
    q, qd, qdd = (each.T for each in 0.7 * rng.normal(size=(3, len(model.actuated), 8)))
    wrenches = rng.normal(size=(12, 8))
    motion = model.motion(*(each.T.copy() for each in (q, qd, qdd)))
    columns = model.wrenches(frames)
    found = torques_of(model, columns(model.layout, motion), columns, wrenches)
    pinocchio = free_flyer_model(robot)
    data = pinocchio.createData()
    joint = {name: number for number, name in enumerate(pinocchio.names)}
    for k in range(8):
        state = free_state(q[k, :6], qd[k, :6], qdd[k, :6])
        at = pinocchio_state(state, q[k, 6:], qd[k, 6:], qdd[k, 6:])
        pin.forwardKinematics(pinocchio, data, at[0])
        forces = [pin.Force.Zero() for _ in range(pinocchio.njoints)]
        forces[joint["g"]] = pin.Force(wrenches[3:6, k], wrenches[:3, k])
        forces[joint["e"]] = data.oMi[joint["e"]].actInv(pin.Force(wrenches[9:, k], wrenches[6:9, k]))
        tau = pin.rnea(pinocchio, data, *at, forces)  # of links without mass: what resists the wrenches
        expected = np.concatenate([state.six(tau[:3], tau[3:6]), tau[6:]])
        assert found[:, k] == pytest.approx(-expected, abs=1e-11)
