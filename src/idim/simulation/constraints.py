"""The closures of a robot as a simulator needs them: one symbolic function, differentiated by CasADi.

Their residual is written down once more, and its derivatives are CasADi's, so that a simulated robot shares no
equation of motion of the loops with the estimator (:mod:`idim.model.closures`).
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
import scipy.linalg

from idim.model.coordinates import Coordinates
from idim.model.kinematics import constant, frames
from idim.model.loops import Loops
from idim.robots.robot import ROTATIONS, TRANSLATIONS, Attachment


@dataclass(frozen=True)
class Constraints:
    """Independent closure equations ``phi(c) = 0``, as many as there are passive coordinates.

    ``position`` maps c to phi and to ``G = d(phi')/d(yd)`` of the passive and of the actuated coordinates;
    ``drift`` maps c and yd to the rest of ``phi'' = G ydd + drift``.
    """

    position: ca.Function
    drift: ca.Function


def configuration_rates(layout: Coordinates, c: ca.SX, yd: ca.SX) -> ca.SX:
    """Time derivative of the configuration c (n_c,) for velocities ``yd`` (n_y,)."""
    n_t = len(layout.robot.joints)
    rates = [yd[:n_t]]
    for slots in layout.platforms:
        v = dict(zip(slots.platform.dof, ca.vertsplit(yd[slots.rates]), strict=True))
        rates.append(ca.vertcat(*(v.get(dof, ca.SX(0)) for dof in TRANSLATIONS)))
        if slots.quaternion is not None:
            omega = ca.vertcat(*(v.get(dof, ca.SX(0)) for dof in ROTATIONS))
            w, vector = c[slots.quaternion.start], c[slots.quaternion][1:]
            rates.append(ca.vertcat(-ca.dot(omega, vector), w * omega + ca.cross(omega, vector)) / 2)
    return ca.vertcat(*rates)


def _residual(layout: Coordinates, c: ca.SX) -> ca.SX:
    robot, frame = layout.robot, frames(layout, c)

    def attached(end: Attachment) -> tuple[ca.SX, ca.SX]:
        body = frame[end.body]
        return body.R_0 @ constant(end.placement.rotation), body.p_0 + body.R_0 @ constant(end.placement.position)

    residual = []
    for closure in robot.closures:
        (R_a, p_a), (R_b, p_b) = attached(closure.a), attached(closure.b)
        residual.append(p_a - p_b)
        if closure.kind == "weld":
            R = R_b.T @ R_a
            residual.append(ca.vertcat(R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]) / 2)
    index = {joint.name: k for k, joint in enumerate(robot.joints)}
    for coupling in robot.couplings:
        moved = sum(ratio * c[index[name]] for name, ratio in coupling.ratios)
        residual.append(c[index[coupling.joint]] - moved - coupling.offset)
    return ca.densify(ca.vertcat(*residual))


def constraints(loops: Loops) -> Constraints:
    """Independent closure equations of a robot.

    Redundant rows, such as the rotations that the three welds of an Orthoglide share, are left out as found by
    QR with pivoting at home.
    """
    layout = loops.layout
    c, yd = ca.SX.sym("c", layout.n_c), ca.SX.sym("yd", layout.n_y)
    rates = configuration_rates(layout, c, yd)
    phi = _residual(layout, c)
    velocity = ca.jtimes(phi, c, rates)
    G = ca.jacobian(velocity, yd)
    passive, actuated = layout.passive.tolist(), layout.actuated.tolist()
    at_home = np.array(ca.Function("G", [c], [G[:, passive]])(loops.home))
    _, _, order = scipy.linalg.qr(at_home.T, pivoting=True, mode="economic")
    rows = np.sort(order[: len(passive)]).tolist()
    drift = ca.jtimes(velocity[rows], c, rates)
    return Constraints(
        ca.Function("position", [c], [phi[rows], G[rows, passive], G[rows, actuated]]),
        ca.Function("drift", [c, yd], [ca.densify(drift)]),
    )
