"""Equations of any robot in symbolic form: closures of its loops (paper, eqs. 3 to 10) and torques (1, 2, 11 to 15).

A closure ties two frames; its residual is the offset of their origins (and, for a weld, the misalignment of
their axes) in base axes. A coupling ties joint coordinates by a linear equation. Differentiated once both
give ``G yd = 0``, in which the columns of the passive coordinates are J_k and J_tk of the paper and
the columns of the actuated ones are B_p; differentiated twice, ``G ydd + gamma = 0``.

The inverse dynamic model is linear in the standard parameters (eq. 1). By the principle of virtual power (eq. 14), a
body's wrench acts on actuated joint k through the body's partial twist: its twist when q_k alone moves at unit rate and
the closures hold. The partial twists are propagated along each chain from the columns of ``J = dy/dq``. So the
projections ``J_t^T IDM_t`` and ``J_p^T D^T IDM_p`` of eq. (15) are built in, IDM_t is never formed, and the Lagrange
multipliers of eqs. (11) and (12) need not be solved for.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce

import casadi as ca
import numpy as np

from gtau.model.kinematics import (
    Coordinates,
    Frame,
    Twist,
    accelerations,
    attached_frame,
    attached_velocity,
    configuration_rates,
    constant,
    frames,
    placed,
    twists,
)
from gtau.robots.parameter import Parameter
from gtau.robots.placement import WrenchFrame
from gtau.robots.robot import DAMPING, DRIVE, INERTIAL, PRELOAD, STIFFNESS, Attachment, Robot, Spring

TOUCHING = 1e-9  # m: length of a spring whose points coincide


def _acceleration(
    end: Attachment, frame: dict[str, Frame], twist: dict[str, Twist], acceleration: dict[str, Twist]
) -> Twist:
    body, omega, arm = acceleration[end.body], twist[end.body].angular, placed(end.placement)[1]
    linear = body.linear + ca.cross(body.angular, arm) + ca.cross(omega, ca.cross(omega, arm))
    R_0 = frame[end.body].R_0
    return Twist(R_0 @ body.angular, R_0 @ linear)


def error_expressions(layout: Coordinates, c: ca.SX, yd: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Express the errors (rows,) of the loops at any ``c``, closed or not, and their scaled Jacobian at closed poses.

    Where :func:`closure_expressions` have the sine of the angle by which a weld's frames are turned, zero again at half
    a turn, the errors have twice the sine of half the angle, and at the end the flips, one less its cosine.
    """
    residual, velocity, _ = closure_expressions(layout, c, yd)
    frame, rows, flips, start = frames(layout, c), [], [], 0
    for closure in layout.robot.closures:
        rows.append(residual[start : start + 3])
        start += 3
        if closure.kind == "weld":
            (R_a, _), (R_b, _) = attached_frame(closure.a, frame), attached_frame(closure.b, frame)
            trace = ca.trace(R_b.T @ R_a)
            rows.append(2 * residual[start : start + 3] / ca.sqrt(ca.fmax(1 + trace, 1e-12)))
            flips.append((3 - trace) / 2)
            start += 3
    G = ca.jacobian(velocity, yd) @ constant(np.diag(layout.unit))
    return ca.vertcat(*rows, residual[start:], *flips), ca.vertcat(G, ca.SX(len(flips), layout.n_y))


def _largest(values: ca.SX) -> ca.SX:
    return reduce(ca.fmax, ca.vertsplit(ca.fabs(values)), ca.SX(0))


def _on_unit_quaternions(layout: Coordinates, c: ca.SX) -> ca.SX:
    """Normalise the quaternions of a configuration ``c``, as a guess has other lengths."""
    c = ca.SX(c)
    for slots in layout.platforms:
        if slots.quaternion is not None:
            c[slots.quaternion] /= ca.sqrt(ca.sumsqr(c[slots.quaternion]))
    return c


def scaled(layout: Coordinates, velocity: ca.SX, yd: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Differentiate by the scaled passive coordinates, all pure numbers, and by the actuated ones."""
    G, passive = ca.jacobian(velocity, yd), layout.passive
    return G[:, passive.tolist()] @ constant(np.diag(layout.unit[passive])), G[:, layout.actuated.tolist()]


def newton_step(layout: Coordinates) -> tuple[ca.SX, list[ca.SX]]:
    """Express a Newton step from ``c``: configuration, largest correction, condition number, and the gap before it."""
    given, yd = ca.SX.sym("c", layout.n_c), ca.SX.sym("yd", layout.n_y)
    c = _on_unit_quaternions(layout, given)
    residual, velocity, _ = closure_expressions(layout, c, yd)
    correction, condition = solve(scaled(layout, velocity, yd)[0], -residual, refine=False)
    step = ca.SX(layout.n_y, 1)
    step[layout.passive.tolist()] = correction * layout.unit[layout.passive]
    moved = _on_unit_quaternions(layout, c + configuration_rates(layout, c, step))
    return given, [moved, _largest(correction), condition, _largest(residual) - 1e-15 * _largest(c)]


def closed_motion(layout: Coordinates) -> tuple[list[ca.SX], list[ca.SX]]:
    """Express eqs. (5) to (8): from closed c, and qd and qdd, to condition, yd and ydd (n_y,), and J (n_y, n)."""
    given, yd = ca.SX.sym("c", layout.n_c), ca.SX.sym("yd", layout.n_y)
    actuated = layout.actuated.tolist()
    passive = layout.passive.tolist()
    unit = layout.unit[layout.passive]
    _, velocity, gamma = closure_expressions(layout, _on_unit_quaternions(layout, given), yd)
    G_p, G_a = scaled(layout, velocity, yd)
    qd = ca.SX.sym("qd", len(actuated))
    qdd = ca.SX.sym("qdd", len(actuated))
    J = ca.SX(layout.n_y, len(actuated))
    J[actuated, :] = ca.SX.eye(len(actuated))
    J_passive, condition = solve(G_p, -G_a, refine=True)
    J[passive, :] = constant(np.diag(unit)) @ J_passive  # J_p and J_t of the paper
    yd_all, ydd_all = J @ qd, J @ qdd  # eqs. (5) and (7); eqs. (6) and (8) without the velocity terms
    drift, _ = solve(G_p, -ca.substitute(gamma, yd, yd_all), refine=True)
    ydd_all[passive] += drift * unit  # eqs. (6) and (8)
    return [given, qd, qdd], [condition, yd_all, ydd_all, J]


def closure_expressions(layout: Coordinates, c: ca.SX, yd: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Express the closures and couplings symbolically, eqs. (3) and (4) in one; the rest of the loops is derived.

    From c (n_c,), its quaternions of unit length, and yd (n_y,): residual, velocity and gamma (rows,), in rad or
    lengths over the characteristic length, and per s and s2. ``G = jacobian(velocity, yd)``, and accelerations obey ``G
    ydd + gamma = 0``. Where the loops are closed, velocity and gamma are the time derivatives of the residual.
    """
    robot, length = layout.robot, layout.length
    frame = frames(layout, c)
    twist = twists(layout, frame, yd)
    still = accelerations(layout, frame, twist, yd, ca.SX(layout.n_y, 1), ca.SX(3, 1))
    residual, velocity, gamma = [], [], []
    for closure in robot.closures:
        (R_a, p_a), (R_b, p_b) = attached_frame(closure.a, frame), attached_frame(closure.b, frame)
        v_a = attached_velocity(closure.a, frame, twist)
        v_b = attached_velocity(closure.b, frame, twist)
        a_a, a_b = (_acceleration(end, frame, twist, still) for end in (closure.a, closure.b))
        residual.append((p_a - p_b) / length)
        velocity.append((v_a.linear - v_b.linear) / length)
        gamma.append((a_a.linear - a_b.linear) / length)
        if closure.kind == "weld":
            # half the rotation's skew part: its derivative is the relative angular velocity
            residual.append(sum((ca.cross(R_b[:, k], R_a[:, k]) for k in range(3)), ca.SX(3, 1)) / 2)
            velocity.append(v_a.angular - v_b.angular)
            gamma.append(a_a.angular - a_b.angular)
    index = {joint.name: k for k, joint in enumerate(robot.joints)}
    for coupling in robot.couplings:
        row = np.zeros(layout.n_y)
        for name, factor in coupling.terms.items():
            row[index[name]] = factor
        size = np.linalg.norm(row * layout.unit)
        residual.append((ca.dot(constant(row[: len(index)]), c[: len(index)]) - coupling.offset) / size)
        velocity.append(ca.dot(constant(row), yd) / size)
        gamma.append(ca.SX(1, 1))
    return ca.vertcat(*residual), ca.vertcat(*velocity), ca.vertcat(*gamma)


def solve(a: ca.SX, b: ca.SX, refine: bool) -> tuple[ca.SX, ca.SX]:
    """Solve ``min |a x - b|`` by the sparse ``L D L^T`` of the normal equations, a (m, n) sparse, b (m, k).

    ``refine`` restores the digits that the normal equations lose. Beside x (n, k) returns the square root of ``trace(M)
    trace(M^-1)``, ``M = a^T a``: 1 to n times the condition number of ``a``, huge or not a number where it is singular.
    """
    normal = a.T @ a
    d, lt, order = ca.ldl(normal, True)
    x = ca.ldl_solve(a.T @ b, d, lt, order)
    if refine:
        x += ca.ldl_solve(a.T @ (b - a @ x), d, lt, order)
    inverse = _inverse(lt)
    spread = ca.sum1(ca.sum2(inverse**2 / ca.repmat(d.T, d.numel(), 1)))
    return x, ca.sqrt(ca.trace(normal) * spread)


def _inverse(upper: ca.SX) -> ca.SX:
    """Invert a unit upper triangle, given without its diagonal, by sparse back substitution."""
    n = upper.shape[0]
    inverse = ca.SX(n, n)
    for column in range(n):
        inverse[column, column] = 1
        for row in range(column - 1, -1, -1):
            rest = ca.mtimes(upper[row, row + 1 : column + 1], inverse[row + 1 : column + 1, column])
            if rest.nnz():
                inverse[row, column] = -rest
    return ca.sparsify(inverse)


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
    return Twist(inertia @ alpha + ca.cross(omega, inertia @ omega) + ca.cross(ms, a), force)


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
        power = ca.SX(0)
        moved = [(row, robot.joints[row]) for row in J[:, k].sparsity().row() if row < n_joints]
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
            moment = wrenches[6 * number : 6 * number + 3]
            force = wrenches[6 * number + 3 : 6 * number + 6]
            angular, linear = partial[body].angular, partial[body].linear
            if in_world:
                angular, linear = frame[body].R_0 @ angular, frame[body].R_0 @ linear
                linear += ca.cross(frame[body].p_0, angular)  # at the origin of the world
            power += ca.dot(moment, angular) + ca.dot(force, linear)
        tau.append(power)
    return ca.vertcat(*tau)
