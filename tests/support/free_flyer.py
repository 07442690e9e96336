"""Floating bases in outside engines: a free joint's pose, twist and wrench from six joints' coordinates, and back.

The six joints slide along x, y and z of the world and turn about x, then the turned y, then the twice turned z.
Nothing of ``gtau.model`` is used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from gtau.robots.robot import GROUND, INERTIAL, Robot


@dataclass(frozen=True)
class FreeState:
    """A free body: ``R`` (3, 3) and ``p`` in the world; angular velocity and acceleration in its own axes; ``E``.

    The angular velocity is ``E`` times the angles' rates. Velocity and acceleration of its origin in world axes.
    """

    R: np.ndarray
    p: np.ndarray
    omega: np.ndarray
    v: np.ndarray
    alpha: np.ndarray
    a: np.ndarray
    E: np.ndarray

    def six(self, force: np.ndarray, moment: np.ndarray) -> np.ndarray:
        """Forces of the six joints from a force and a moment about the origin, in the body's axes."""
        return np.concatenate([self.R @ force, self.E.T @ moment])


def free_state(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> FreeState:
    """The free body from coordinates, rates and accelerations (6,) of the six joints."""
    (a, b, c), rates = q[3:], qd[3:]
    (_, sb, sc), (_, cb, cc), (_, b_d, c_d) = np.sin(q[3:]), np.cos(q[3:]), rates
    E = np.array([[cc * cb, sc, 0.0], [-sc * cb, cc, 0.0], [sb, 0.0, 1.0]])
    by_b = np.array([[-cc * sb, 0.0, 0.0], [sc * sb, 0.0, 0.0], [cb, 0.0, 0.0]])
    by_c = np.array([[-sc * cb, cc, 0.0], [-cc * cb, -sc, 0.0], [0.0, 0.0, 0.0]])
    E_d = by_b * b_d + by_c * c_d
    R = pin.exp3(np.array([a, 0.0, 0.0])) @ pin.exp3(np.array([0.0, b, 0.0])) @ pin.exp3(np.array([0.0, 0.0, c]))
    return FreeState(R, q[:3], E @ rates, qd[:3], E @ qdd[3:] + E_d @ rates, qdd[:3], E)


def pinocchio_state(state: FreeState, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> tuple[np.ndarray, ...]:
    """Configuration, velocity and acceleration in Pinocchio, whose free flyer stands first; joints (n,) as they are."""
    v = state.R.T @ state.v
    a = state.R.T @ state.a - pin.skew(state.omega) @ v  # a spatial acceleration
    quaternion = pin.Quaternion(state.R).coeffs()
    return (
        np.concatenate([state.p, quaternion, q]),
        np.concatenate([v, state.omega, qd]),
        np.concatenate([a, state.alpha, qdd]),
    )


def free_flyer_model(robot: Robot) -> pin.Model:
    """The tree of a robot on a free flyer in Pinocchio, without masses; joints in the order of the robot."""
    model = pin.Model()
    model.gravity.linear = np.array(robot.gravity)
    number = {GROUND: 0, robot.floating: model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")}
    for joint in robot.joints[6:]:
        kind = pin.JointModelRevoluteUnaligned if joint.kind == "revolute" else pin.JointModelPrismaticUnaligned
        placement = pin.SE3(joint.placement.rotation, joint.placement.position)
        number[joint.name] = model.addJoint(number[joint.antecedent], kind(np.array(joint.axis)), placement, joint.name)
        model.appendBodyToJoint(number[joint.name], pin.Inertia.Zero(), pin.SE3.Identity())
    return model


PINOCCHIO_ORDER = ("m", "mx", "my", "mz", "xx", "xy", "yy", "xz", "yz", "zz")


def regressor(robot: Robot, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Regressor (6 + n, 10 bodies) of Pinocchio at a state, in the six joints' forces, and its columns' names."""
    assert set(PINOCCHIO_ORDER) == set(INERTIAL)
    model = free_flyer_model(robot)
    state = free_state(q[:6], qd[:6], qdd[:6])
    Y = pin.computeJointTorqueRegressor(model, model.createData(), *pinocchio_state(state, q[6:], qd[6:], qdd[6:]))
    six = np.array([state.six(force, moment) for force, moment in zip(Y[:3].T, Y[3:6].T, strict=True)]).T
    names = [f"{kind}_{body}" for body in model.names[1:] for kind in PINOCCHIO_ORDER]
    return np.vstack([six, Y[6:]]), [name.replace("_base", f"_{robot.floating}") for name in names]
