"""Loop-closure equations derived from the geometry (paper, eqs. 3 to 10).

A closure ties two frames; its residual is how far their origins (and, for a weld, their axes) are
apart in base axes. A coupling ties joint coordinates by a linear equation. Differentiated once both
give ``G yd = 0``, in which the columns of the passive coordinates are J_k and J_tk of the paper and
those of the actuated ones B_p; differentiated twice, ``G ydd + gamma = 0``.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy.spatial.transform import Rotation

from idim.model.coordinates import Coordinates
from idim.model.kinematics import Frame, Twist, accelerations, constant, frames, twists
from idim.model.program import Program, compile_program
from idim.robots.robot import Attachment, Robot


@dataclass(frozen=True)
class ClosureEquations:
    """The closures of a robot, ready to be evaluated for many samples.

    ``newton`` maps c to the residual (rows,) and ``G`` of the passive coordinates; ``motion`` maps c
    and yd to ``G`` of the actuated coordinates and gamma. Lengths are in units of the robot's
    ``length``, so that rows and columns are pure numbers: rad, or lengths over ``length``.
    """

    rows: int
    length: float
    newton: Program  # (n_c,) -> (rows + rows * n_passive,)
    motion: Program  # (n_c + n_y,) -> (rows * n + rows,)
    pattern: np.ndarray  # (rows, n_passive) True where G may be other than zero


def characteristic_length(robot: Robot) -> float:
    """Mean length (m) of the robot's placements that have one: the scale between m and rad."""
    placements = [joint.placement for joint in robot.joints]
    placements += [end.placement for closure in robot.closures for end in (closure.a, closure.b)]
    lengths = [float(np.linalg.norm(placement.position)) for placement in placements]
    lengths = [length for length in lengths if length > 1e-9]
    return float(np.mean(lengths)) if lengths else 1.0


def _attached(end: Attachment, frame: dict[str, Frame]) -> tuple[ca.SX, ca.SX]:
    """Orientation and position of an attached frame in the base."""
    body = frame[end.body]
    rotation, arm = constant(end.placement.rotation), constant(end.placement.position)
    return body.R_0 @ rotation, body.p_0 + body.R_0 @ arm


def _velocity(end: Attachment, frame: dict[str, Frame], twist: dict[str, Twist]) -> Twist:
    body, arm = twist[end.body], constant(end.placement.position)
    R_0 = frame[end.body].R_0
    return Twist(R_0 @ body.angular, R_0 @ (body.linear + ca.cross(body.angular, arm)))


def _acceleration(
    end: Attachment, frame: dict[str, Frame], twist: dict[str, Twist], acceleration: dict[str, Twist]
) -> Twist:
    body, omega, arm = acceleration[end.body], twist[end.body].angular, constant(end.placement.position)
    R_0 = frame[end.body].R_0
    linear = body.linear + ca.cross(body.angular, arm) + ca.cross(omega, ca.cross(omega, arm))
    return Twist(R_0 @ body.angular, R_0 @ linear)


def gaps(layout: Coordinates, c: np.ndarray) -> np.ndarray:
    """How far apart the frames of every closure are at ``c`` (n_c,): distance in m and angle in rad, (closures, 2)."""
    frame = frames(layout, ca.SX(c))
    found = np.zeros((len(layout.robot.closures), 2))
    for k, closure in enumerate(layout.robot.closures):
        (R_a, p_a), (R_b, p_b) = _attached(closure.a, frame), _attached(closure.b, frame)
        found[k, 0] = np.linalg.norm(np.array(ca.evalf(p_a - p_b)))
        if closure.kind == "weld":
            found[k, 1] = Rotation.from_matrix(np.array(ca.evalf(R_b.T @ R_a))).magnitude()
    return found


def closure_equations(layout: Coordinates) -> ClosureEquations:
    """Derive the closure equations of a robot from its geometry."""
    robot = layout.robot
    length = characteristic_length(robot)
    c, yd = ca.SX.sym("c", layout.n_c), ca.SX.sym("yd", layout.n_y)
    frame = frames(layout, c)
    twist = twists(layout, frame, yd)
    still = accelerations(layout, frame, twist, yd, ca.SX(layout.n_y, 1), np.zeros(3))
    residual, velocity, gamma = [], [], []
    for closure in robot.closures:
        (R_a, p_a), (R_b, p_b) = _attached(closure.a, frame), _attached(closure.b, frame)
        v_a, v_b = _velocity(closure.a, frame, twist), _velocity(closure.b, frame, twist)
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
    unit = constant(np.diag(np.where(layout.angular, 1.0, length)))
    for coupling in robot.couplings:
        row = np.zeros(layout.n_y)
        row[index[coupling.joint]] = 1.0
        for name, ratio in coupling.ratios:
            row[index[name]] = -ratio
        size = np.linalg.norm(row * np.where(layout.angular, 1.0, length))
        residual.append((ca.dot(constant(row[: len(index)]), c[: len(index)]) - coupling.offset) / size)
        velocity.append(ca.dot(constant(row), yd) / size)
        gamma.append(ca.SX(1, 1))
    G = ca.jacobian(ca.vertcat(*velocity), yd) @ unit
    G_passive, G_actuated = G[:, layout.passive.tolist()], G[:, layout.actuated.tolist()]
    newton = compile_program([c], [ca.vertcat(*residual), G_passive.T])
    motion = compile_program([c, yd], [G_actuated.T, ca.vertcat(*gamma)])
    pattern = np.array(ca.DM(G_passive.sparsity(), 1).full(), dtype=bool)
    return ClosureEquations(G.shape[0], length, newton, motion, pattern)
