"""The inverse dynamic model of any robot, linear in its standard parameters (paper, eqs. 1, 2 and 11 to 15).

By the principle of virtual power (eq. 14), a body's wrench acts on actuated joint k through the body's partial twist:
its twist when q_k alone moves at unit rate and the closures hold. The partial twists are propagated along each chain
from the columns of ``J = dy/dq``. So the projections ``J_t^T IDM_t`` and ``J_p^T D^T IDM_p`` of eq. (15) are built in,
IDM_t is never formed, and the Lagrange multipliers of eqs. (11) and (12) need not be solved for.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from gtau.model.kinematics import (
    Coordinates,
    Frame,
    Twist,
    accelerations,
    attached_frame,
    attached_velocity,
    constant,
    frames,
    twists,
)
from gtau.robots.parameter import Parameter
from gtau.robots.placement import WrenchFrame
from gtau.robots.robot import DAMPING, DRIVE, INERTIAL, PRELOAD, STIFFNESS, Robot, Spring

TOUCHING = 1e-9  # m: length of a spring whose points coincide


def parameter_names(robot: Robot, parameters: str = "all") -> tuple[Parameter, ...]:
    """List the standard parameters of joints, platforms and springs; ``"inertial"`` ones are of bodies alone."""
    kinds = {"all": INERTIAL + DRIVE, "inertial": INERTIAL, "drive": DRIVE, "none": ()}
    joints: list[Parameter] = []
    for joint in robot.joints:
        joints += [Parameter(kind, joint.name) for kind in kinds[joint.parameters] if kind in kinds[parameters]]
        if joint.spring is not None and parameters == "all":
            joints.append(Parameter(STIFFNESS, joint.name))
    platforms = [Parameter(kind, platform.name) for platform in robot.platforms for kind in INERTIAL]
    springs = [Parameter(kind, spring.name) for spring in robot.springs for kind in spring.parameters]
    return (*joints, *platforms, *(springs if parameters == "all" else ()))


def _wrench(chi: dict[Parameter, ca.SX], body: str, twist: Twist, acceleration: Twist) -> Twist:
    """Apply Newton-Euler at the frame's origin: moment (angular) and force (linear) on a body, eqs. (1) and (2)."""
    xx, xy, xz, yy, yz, zz, mx, my, mz, m = (chi[Parameter(kind, body)] for kind in INERTIAL)
    inertia = ca.vertcat(ca.horzcat(xx, xy, xz), ca.horzcat(xy, yy, yz), ca.horzcat(xz, yz, zz))
    ms = ca.vertcat(mx, my, mz)
    omega, alpha, a = twist.angular, acceleration.angular, acceleration.linear
    force = m * a + ca.cross(alpha, ms) + ca.cross(omega, ca.cross(omega, ms))
    moment = inertia @ alpha + ca.cross(omega, inertia @ omega) + ca.cross(ms, a)
    return Twist(moment, force)


def spring_length(spring: Spring, frame: dict[str, Frame]) -> tuple[ca.SX, ca.SX]:
    """Express the length of a spring and the unit vector (3,) from its first to its second attachment, in base axes."""
    line = attached_frame(spring.b, frame)[1] - attached_frame(spring.a, frame)[1]
    length = ca.sqrt(ca.sumsqr(line) + TOUCHING**2)
    return length, line / length


def _lengthening(spring: Spring, direction: ca.SX, frame: dict[str, Frame], twist: dict[str, Twist]) -> ca.SX:
    """Express the rate of a spring's length for the bodies' twists, or partial twists."""
    v_a, v_b = (attached_velocity(end, frame, twist).linear for end in (spring.a, spring.b))
    return ca.dot(direction, v_b - v_a)


def torques(
    layout: Coordinates,
    c: ca.SX,
    yd: ca.SX,
    ydd: ca.SX,
    J: ca.SX,
    chi: dict[Parameter, ca.SX],
    gravity: ca.SX | None = None,
) -> ca.SX:
    """Express the torques of the actuated joints ``tau_idm`` (n,), eq. (15).

    They equal ``-B^T lambda`` with the multipliers of eqs. (11) and (12). c (n_c,), yd and ydd (n_y,) are of the whole
    virtual tree; J = ``dy/dq`` (n_y, n) is the identity in the actuated rows, J_t and J_p in the others. ``chi`` has
    the standard parameters by name, missing drive parameters being zero; ``gravity`` (3,), m/s2 in base axes, is the
    robot's if omitted.
    """
    robot = layout.robot
    frame = frames(layout, c)
    twist = twists(layout, frame, yd)
    gravity = constant(np.array(robot.gravity)) if gravity is None else gravity
    acceleration = accelerations(layout, frame, twist, yd, ydd, gravity)
    massive = [body for body in robot.bodies if Parameter("m", body) in chi]
    wrench = {body: _wrench(chi, body, twist[body], acceleration[body]) for body in massive}
    pulls = []  # of the springs, against their lengthening
    for spring in robot.springs:
        length, direction = spring_length(spring, frame)
        stretching = _lengthening(spring, direction, frame, twist)
        pull = ca.SX(0)
        for kind, effort in ((PRELOAD, ca.SX(-1)), (STIFFNESS, length), (DAMPING, stretching)):
            if Parameter(kind, spring.name) in chi:
                pull += chi[Parameter(kind, spring.name)] * effort
        pulls.append((spring, direction, pull))
    tau, n_joints = [], len(robot.joints)
    for k in range(J.shape[1]):
        partial = twists(layout, frame, J[:, k])
        power, moved = ca.SX(0), [(row, robot.joints[row]) for row in J[:, k].sparsity().row() if row < n_joints]
        for body in massive:  # eqs. (13) and (14): for a platform, D^T tau_p along the columns of J_p
            if not partial[body].moves:
                continue
            power += ca.dot(partial[body].angular, wrench[body].angular)
            power += ca.dot(partial[body].linear, wrench[body].linear)
        for row, joint in moved:
            terms = dict(zip(DRIVE, (ydd[row], yd[row], ca.sign(yd[row]), ca.SX(1)), strict=True))
            if joint.spring is not None:
                terms[STIFFNESS] = c[row] - joint.spring
            for kind in terms:
                if Parameter(kind, joint.name) in chi:
                    power += J[row, k] * chi[Parameter(kind, joint.name)] * terms[kind]
        for spring, direction, pull in pulls:
            power += pull * _lengthening(spring, direction, frame, partial)
        tau.append(power)
    return ca.vertcat(*tau)


def wrench_torques(layout: Coordinates, c: ca.SX, J: ca.SX, frames_of: Sequence[WrenchFrame], wrenches: ca.SX) -> ca.SX:
    """Express the forces ``J^T w`` (n,) of ``wrenches`` (6 k,), N m and N, at the actuated joints (eq. 14)."""
    frame = frames(layout, c)
    tau = []
    for k in range(J.shape[1]):
        partial = twists(layout, frame, J[:, k])
        power = ca.SX(0)
        for number, (body, in_world) in enumerate(frames_of):
            moment, force = wrenches[6 * number : 6 * number + 3], wrenches[6 * number + 3 : 6 * number + 6]
            angular, linear = partial[body].angular, partial[body].linear
            if in_world:
                angular, linear = frame[body].R_0 @ angular, frame[body].R_0 @ linear
                linear += ca.cross(frame[body].p_0, angular)  # at the origin of the world
            power += ca.dot(moment, angular) + ca.dot(force, linear)
        tau.append(power)
    return ca.vertcat(*tau)
