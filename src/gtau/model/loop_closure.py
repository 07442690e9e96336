"""Close the loops of a robot at one configuration: their errors, and Levenberg-Marquardt on them."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from gtau.model.closures import assembly_errors, closure_expressions
from gtau.model.coordinates import Coordinates
from gtau.robots.geometry import characteristic_length

# Lengths are counted in characteristic lengths of the robot, angles in rad.
CLOSED = 1e-11  # largest error of a loop that is closed
STALLED = 15  # steps that hardly help, after which a start is given up


@dataclass(frozen=True, eq=False)
class LoopErrors:
    """The closures and couplings of a robot, to be evaluated one configuration at a time.

    Attributes
    ----------
    layout : Coordinates
        Of the robot.
    length : float
        Its characteristic length, m.
    unit : ndarray
        (n_y,): what one unit of a scaled coordinate is, in rad or m.
    looped : ndarray
        Indices into yd of the coordinates that a closure or coupling depends on.
    function : casadi.Function
        From c (n_c,) to the errors (rows,), see :func:`assembly_errors`, and what their derivatives by the scaled
        coordinates (rows, n_y) are at a closed pose.
    """

    layout: Coordinates
    length: float
    unit: np.ndarray
    looped: np.ndarray
    function: ca.Function

    def __call__(self, c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Evaluate errors (rows,) and scaled Jacobian (rows, n_y) at ``c`` (n_c,)."""
        error, G = self.function(c)
        return error.full().ravel(), G.full()

    @property
    def passive(self) -> np.ndarray:
        """Indices into yd of the passive coordinates in loops."""
        return np.intersect1d(self.looped, self.layout.passive)

    def moved(self, c: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Move the configuration ``c`` (n_c,) by a scaled displacement (n_y,)."""
        return self.layout.retract(c[:, None], (step * self.unit)[:, None])[:, 0]

    def condition(self, G: np.ndarray) -> float:
        """Compute the condition number of the scaled columns of the passive coordinates in loops."""
        sigma = np.linalg.svd(G[:, self.passive], compute_uv=False)
        return float(sigma[0] / max(sigma[-1], 1e-12)) if sigma.size else 1.0

    def gap(self, c: np.ndarray) -> str:
        """Find the loop that is furthest from closing at ``c`` (n_c,), and its error."""
        robot, start, gaps = self.layout.robot, 0, []
        welds = sum(closure.kind == "weld" for closure in robot.closures)
        both = self(c)[0]
        error, flips = np.split(both, [both.size - welds])
        turned = iter(np.arccos(np.clip(1.0 - flips, -1.0, 1.0)))
        for number, closure in enumerate(robot.closures, start=1):
            rows = 6 if closure.kind == "weld" else 3
            distance, half = (float(np.linalg.norm(each)) for each in np.split(error[start : start + rows], [3]))
            angle = max(half, float(next(turned))) if rows == 6 else 0.0
            parts = (distance, f"{1e3 * distance * self.length:.3g} mm"), (angle, f"{np.degrees(angle):.3g} degrees")
            size = " and ".join(text for part, text in parts if part > 1e-3 * max(distance, angle))
            name = f"closure {number} ('{closure.a.body}' to '{closure.b.body}') stays open by {size}"
            gaps.append((max(distance, angle), name))
            start += rows
        for coupling, value in zip(robot.couplings, error[start:], strict=True):
            gaps.append((abs(float(value)), f"the coupling of '{coupling.joint}' is not met"))
        return max(gaps)[1]

    def apart(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Compute the distance between the scaled coordinates (n_y,) of two configurations, full turns left out."""
        layout, n_t = self.layout, len(self.layout.robot.joints)
        found = np.zeros(layout.n_y)
        change = after[:n_t] - before[:n_t]
        turned = np.remainder(change + np.pi, 2 * np.pi) - np.pi
        found[:n_t] = np.where(layout.angular[:n_t], turned, change) / self.unit[:n_t]
        for slots in layout.platforms:
            found[slots.rates] = slots.displacement(before, after) / self.unit[slots.rates]
        return np.abs(found)


def loop_errors(layout: Coordinates) -> LoopErrors:
    """Compile the errors of a robot's loops and their Jacobian from its closure equations."""
    length = characteristic_length(layout.robot)
    unit = np.where(layout.angular, 1.0, length)
    c, yd = ca.SX.sym("c", layout.n_c), ca.SX.sym("yd", layout.n_y)
    _, velocity, _ = closure_expressions(layout, c, yd)
    G = ca.jacobian(velocity, yd) @ ca.diag(ca.DM(unit))
    looped = np.unique(G.sparsity().get_triplet()[1]).astype(int)
    errors, flips = assembly_errors(layout, c)
    rows = ca.vertcat(G, ca.SX(flips.numel(), layout.n_y))
    function = ca.Function("loops", [c], [ca.densify(ca.vertcat(errors, flips)), ca.densify(rows)])
    return LoopErrors(layout, length, unit, looped, function)


def closed(errors: LoopErrors, c: np.ndarray, moving: np.ndarray) -> np.ndarray:
    """Close the loops by Levenberg-Marquardt, as well as that goes.

    Parameters
    ----------
    errors : LoopErrors
        From :func:`loop_errors`.
    c : ndarray
        Configuration (n_c,) to begin from.
    moving : ndarray
        Indices into yd of the coordinates that may move.

    Returns
    -------
    ndarray
        Configuration (n_c,); the loops close there where the largest error is below ``CLOSED``.
    """
    damping, stalled = 1e-3, 0
    error, G = errors(c)
    for _ in range(200):
        size = np.linalg.norm(error)
        if np.abs(error).max(initial=0.0) < 1e-15:
            break
        U, sigma, Vt = np.linalg.svd(G[:, moving], full_matrices=False)
        level = damping * size  # fades as the loops close: Newton's method in the end
        share = np.where(sigma > 1e-9, sigma / (sigma**2 + level), 0.0)
        step = np.zeros(G.shape[1])
        step[moving] = -Vt.T @ (share * (U.T @ error))
        tried = errors.moved(c, step / max(1.0, np.abs(step).max()))
        error_there, G_there = errors(tried)
        there = np.linalg.norm(error_there)
        stalled = stalled + 1 if there > 0.99 * size else 0
        if stalled == STALLED:
            break
        if there < size:
            c, error, G = tried, error_there, G_there
            damping = max(damping / 3, 1e-12)
        elif damping > 1e3 or size < CLOSED:
            break
        else:
            damping *= 4
    return c


def is_closed(errors: LoopErrors, c: np.ndarray) -> bool:
    """Decide whether the loops close at ``c`` (n_c,)."""
    return bool(np.abs(errors(c)[0]).max(initial=0.0) < CLOSED)
