"""Loop-closure equations derived from the geometry (paper, eqs. 3 to 10).

A closure ties two frames; its residual is the offset of their origins (and, for a weld, the misalignment of
their axes) in base axes. A coupling ties joint coordinates by a linear equation. Differentiated once both
give ``G yd = 0``, in which the columns of the passive coordinates are J_k and J_tk of the paper and
the columns of the actuated ones are B_p; differentiated twice, ``G ydd + gamma = 0``.
"""

from __future__ import annotations

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
from gtau.robots.robot import Attachment


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


def _scaled(layout: Coordinates, velocity: ca.SX, yd: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Differentiate by the scaled passive coordinates, all pure numbers, and by the actuated ones."""
    G, passive = ca.jacobian(velocity, yd), layout.passive
    return G[:, passive.tolist()] @ constant(np.diag(layout.unit[passive])), G[:, layout.actuated.tolist()]


def newton_step(layout: Coordinates) -> tuple[ca.SX, list[ca.SX]]:
    """Express a Newton step from ``c``: configuration, largest correction, condition number, and the gap before it."""
    given, yd = ca.SX.sym("c", layout.n_c), ca.SX.sym("yd", layout.n_y)
    c = _on_unit_quaternions(layout, given)
    residual, velocity, _ = closure_expressions(layout, c, yd)
    correction, condition = solve(_scaled(layout, velocity, yd)[0], -residual, refine=False)
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
    G_p, G_a = _scaled(layout, velocity, yd)
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
