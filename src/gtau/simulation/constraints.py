"""The closures of a robot as a simulator needs them: as many independent equations as passive coordinates."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
import scipy.linalg

from gtau.model.closures import closure_expressions
from gtau.model.kinematics import frames
from gtau.model.loops import Loops


@dataclass(frozen=True)
class Constraints:
    """Independent closure equations ``phi(c) = 0``, as many as there are passive coordinates.

    ``position`` maps c to phi and to ``G = d(phi')/d(yd)`` of the passive and of the actuated coordinates;
    ``drift`` maps c and yd to gamma of ``G ydd + gamma = 0``.
    """

    position: ca.Function
    drift: ca.Function


def constraints(loops: Loops) -> Constraints:
    """Select independent closure equations of a robot.

    Redundant rows, such as the rotations that the three welds of an Orthoglide share, are left out as found by
    QR with pivoting at home. The rows are those in the axes of each closure's second body: a linkage whose plane turns
    with the robot keeps the same redundant rows there, but not in base axes.
    """
    layout = loops.layout
    c, yd = ca.SX.sym("c", layout.n_c), ca.SX.sym("yd", layout.n_y)
    turned = _axes_of_bodies(loops, c)
    phi, velocity, gamma = (turned @ each for each in closure_expressions(layout, c, yd))
    G = ca.jacobian(velocity, yd)
    passive, actuated = layout.passive.tolist(), layout.actuated.tolist()
    at_home = np.array(ca.Function("G", [c], [G[:, passive]])(loops.home))
    _, _, order = scipy.linalg.qr(at_home.T, pivoting=True, mode="economic")
    rows = np.sort(order[: len(passive)]).tolist()
    return Constraints(
        ca.Function("position", [c], [phi[rows], G[rows, passive], G[rows, actuated]]),
        ca.Function("drift", [c, yd], [ca.densify(gamma[rows])]),
    )


def _axes_of_bodies(loops: Loops, c: ca.SX) -> ca.SX:
    """Turn the closures' rows from base axes into those of each closure's second body."""
    frame, blocks = frames(loops.layout, c), []
    for closure in loops.layout.robot.closures:
        blocks += [frame[closure.b.body].R_0.T] * (2 if closure.kind == "weld" else 1)
    return ca.diagcat(*blocks, ca.SX.eye(loops.equations.rows - 3 * len(blocks)))
