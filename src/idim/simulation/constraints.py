"""The closures of a robot as a simulator needs them: as many independent equations as passive coordinates."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
import scipy.linalg

from idim.model.closures import closure_expressions
from idim.model.loops import Loops


@dataclass(frozen=True)
class Constraints:
    """Independent closure equations ``phi(c) = 0``, as many as there are passive coordinates.

    ``position`` maps c to phi and to ``G = d(phi')/d(yd)`` of the passive and of the actuated coordinates;
    ``drift`` maps c and yd to gamma of ``G ydd + gamma = 0``.
    """

    position: ca.Function
    drift: ca.Function


def constraints(loops: Loops) -> Constraints:
    """Independent closure equations of a robot.

    Redundant rows, such as the rotations that the three welds of an Orthoglide share, are left out as found by
    QR with pivoting at home.
    """
    layout = loops.layout
    c, yd = ca.SX.sym("c", layout.n_c), ca.SX.sym("yd", layout.n_y)
    phi, velocity, gamma = closure_expressions(layout, c, yd)
    G = ca.jacobian(velocity, yd)
    passive, actuated = layout.passive.tolist(), layout.actuated.tolist()
    at_home = np.array(ca.Function("G", [c], [G[:, passive]])(loops.home))
    _, _, order = scipy.linalg.qr(at_home.T, pivoting=True, mode="economic")
    rows = np.sort(order[: len(passive)]).tolist()
    return Constraints(
        ca.Function("position", [c], [phi[rows], G[rows, passive], G[rows, actuated]]),
        ca.Function("drift", [c, yd], [ca.densify(gamma[rows])]),
    )
