"""Close the loops of a robot at one configuration by Levenberg-Marquardt, and search for a home where they close."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from gtau.errors import GtauError
from gtau.model.closures import assembly_errors, closure_expressions
from gtau.model.kinematics import Coordinates
from gtau.robots.geometry import characteristic_length
from gtau.robots.robot import Joint

# Lengths are in characteristic lengths of the robot, angles in rad.
CLOSED = 1e-11  # largest error of a loop that is closed
STALLED = 15  # steps with little improvement, after which a start is abandoned


@dataclass(frozen=True, eq=False)
class LoopErrors:
    """The closures and couplings of a robot, to be evaluated one configuration at a time.

    ``looped`` are indices into yd of the coordinates that a closure or coupling depends on. ``function`` maps c (n_c,)
    to the errors (rows,), see :func:`assembly_errors`, and what their derivatives by the scaled coordinates
    (rows, n_y) are at a closed pose.
    """

    layout: Coordinates
    looped: np.ndarray
    function: Callable[..., Any]

    @cached_property
    def length(self) -> float:
        """Characteristic length of the robot, m."""
        return characteristic_length(self.layout.robot)

    @cached_property
    def unit(self) -> np.ndarray:
        """Size (n_y,) of one unit of a scaled coordinate, in rad or m."""
        return np.where(self.layout.angular, 1.0, self.length)

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
        """Find the loop with the largest closure error at ``c`` (n_c,), and that error."""
        robot, start, gaps = self.layout.robot, 0, []
        welds = sum(closure.kind == "weld" for closure in robot.closures)
        both = self(c)[0]
        error, flips = np.split(both, [both.size - welds])
        turned = iter(np.arccos(np.clip(1.0 - flips, -1.0, 1.0)))
        for number, closure in enumerate(robot.closures, start=1):
            rows = 6 if closure.kind == "weld" else 3
            distance, half = (float(np.linalg.norm(part)) for part in np.split(error[start : start + rows], [3]))
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
        """Compute the distance between the scaled coordinates (n_y,) of two configurations, modulo full turns."""
        layout, n_t = self.layout, len(self.layout.robot.joints)
        distance = np.zeros(layout.n_y)
        change = after[:n_t] - before[:n_t]
        turned = np.remainder(change + np.pi, 2 * np.pi) - np.pi
        distance[:n_t] = np.where(layout.angular[:n_t], turned, change) / self.unit[:n_t]
        for slots in layout.platforms:
            distance[slots.rates] = slots.displacement(before, after) / self.unit[slots.rates]
        return np.abs(distance)


def loop_errors(layout: Coordinates) -> LoopErrors:
    """Compile the errors of a robot's loops and their Jacobian from its closure equations."""
    c, yd = ca.SX.sym("c", layout.n_c), ca.SX.sym("yd", layout.n_y)
    errors, G = error_expressions(layout, c, yd)
    looped = np.unique(G.sparsity().get_triplet()[1]).astype(int)
    return LoopErrors(layout, looped, ca.Function("loops", [c], [ca.densify(errors), ca.densify(G)]))


def error_expressions(layout: Coordinates, c: ca.SX, yd: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Express the errors (rows,) of the loops at ``c`` and their scaled Jacobian (rows, n_y) at closed poses."""
    unit = np.where(layout.angular, 1.0, characteristic_length(layout.robot))
    _, velocity, _ = closure_expressions(layout, c, yd)
    G = ca.jacobian(velocity, yd) @ ca.diag(ca.DM(unit))
    errors, flips = assembly_errors(layout, c)
    return ca.vertcat(errors, flips), ca.vertcat(G, ca.SX(flips.numel(), layout.n_y))


def closed(errors: LoopErrors, c: np.ndarray, moving: np.ndarray) -> np.ndarray:
    """Minimise the loop errors by Levenberg-Marquardt, from a configuration ``c`` (n_c,).

    Only the coordinates ``moving``, indices into yd, move. The loops close at the configuration (n_c,) that is returned
    where the largest error is below ``CLOSED``.
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


def is_closed(errors: LoopErrors, c: np.ndarray, tolerance: float = CLOSED) -> bool:
    """Decide whether the loops close at ``c`` (n_c,)."""
    return bool(np.abs(errors(c)[0]).max(initial=0.0) < tolerance)


# Below, lengths are in characteristic lengths of the robot, angles in rad.
NEAR = 1e-3  # a home displaced by less than this by the solution is the intended one: no note
FAR = 1.0  # largest admissible error of a home given in the file
LIMITS = 1e-4  # rad or m: files round homes and limits, so one beyond a limit by less than this is within it
WELL_CONDITIONED = 30.0  # condition number of the scaled passive columns that the home search aims for
STEP = 0.1
STARTS = 40
MOTOR_DECIMALS = 6  # of the motors' positions in a home that was searched for: beyond them processors may differ


def nearest_closed(errors: LoopErrors, given: np.ndarray, tolerance: float = CLOSED) -> np.ndarray:
    """Find the closed configuration (n_c,) nearest to the one given, within the position limits if there is one."""
    held = closed(errors, given, errors.passive)
    near = not errors.layout.robot.file.home_given or errors.apart(given, held).max() < FAR
    if near and is_closed(errors, held, tolerance) and not _outside(errors, held):
        return _unwound(errors, given, held)
    best: tuple[tuple[bool, float], np.ndarray] | None = None
    rng, open_ones = np.random.default_rng(0), [held]
    for start in range(STARTS):
        there = closed(errors, _scattered(errors, given, rng) if start else given, errors.looped)
        if not is_closed(errors, there, tolerance):
            open_ones.append(there)
            continue
        there = _unwound(errors, given, there)
        rank = _outside(errors, there), float(np.linalg.norm(errors.apart(given, there)))
        if best is None or rank < best[0]:
            best = rank, there
        if start == 0 and not rank[0]:
            break
    if best is None:
        nearly = min(open_ones, key=lambda c: float(np.abs(errors(c)[0]).max()))
        raise GtauError(
            f"robot '{errors.layout.robot.name}': the loops do not close near the home configuration, nor in any "
            f"other pose tried, at best {errors.gap(nearly)}; check the placements of the closures and of the "
            "joints in the loops, and their units, or write a 'home' closer to the assembled robot."
        )
    return best[1]


def _unwound(errors: LoopErrors, given: np.ndarray, solved: np.ndarray) -> np.ndarray:
    """Remove full turns from a configuration, except for coupled joints, whose couplings would no longer hold."""
    coupled = {name for coupling in errors.layout.robot.couplings for name in (coupling.joint, *dict(coupling.ratios))}
    unwound = solved.copy()
    for k, joint in enumerate(errors.layout.robot.joints):
        if joint.turns and joint.name not in coupled:
            unwound[k] = given[k] + np.remainder(solved[k] - given[k] + np.pi, 2 * np.pi) - np.pi
    return unwound


def _scattered(errors: LoopErrors, given: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    c = given.copy()
    for k, joint in enumerate(errors.layout.robot.joints):
        if k in errors.looped:
            reach = np.pi if joint.turns else errors.length
            low, high = joint.limits.position or (-np.inf, np.inf)
            low, high = max(low, given[k] - reach), min(high, given[k] + reach)
            c[k] = rng.uniform(low, high) if low < high else given[k]
    return c


def _outside(errors: LoopErrors, c: np.ndarray) -> bool:
    """Decide whether a joint in a loop is beyond its position limits."""
    return any(limit_excess(errors.layout.robot.joints[k], c[k]) > LIMITS for k in _looped_joints(errors))


def _looped_joints(errors: LoopErrors) -> list[int]:
    return [int(k) for k in errors.looped if k < len(errors.layout.robot.joints)]


def limit_excess(joint: Joint, value: float) -> float:
    """Compute how far a coordinate is beyond its joint's position limits, rad or m."""
    low, high = joint.limits.position or (-np.inf, np.inf)
    return max(low - value, value - high, 0.0)


def well_conditioned(errors: LoopErrors, c: np.ndarray) -> np.ndarray:
    """Move a closed configuration (n_c,) step by step until it is well conditioned or stops improving.

    Steps are the displacements of single coordinates projected on the motions that keep the loops closed, which, other
    than a basis of these, do not depend on the processor; conditions are compared with three digits.
    """
    condition, size, limited = errors.condition(errors(c)[1]), STEP, _outside(errors, c)
    while condition > WELL_CONDITIONED and size > STEP / 10:
        best = float(f"{condition:.3g}"), c
        for direction in _directions(errors, c):
            for sign in (1.0, -1.0):
                tried = closed(errors, errors.moved(c, sign * size * direction), errors.looped)
                if is_closed(errors, tried) and _outside(errors, tried) <= limited:
                    there = float(f"{errors.condition(errors(tried)[1]):.3g}")
                    best = min(best, (there, tried), key=lambda candidate: candidate[0])
        size = size if best[0] < 0.99 * condition else size / 2
        condition, c = best
    return c


def with_round_motors(errors: LoopErrors, c: np.ndarray) -> np.ndarray:
    """Find the closed configuration (n_c,) near ``c`` with rounded motor positions, if there is one."""
    rounded = c.copy()
    rounded[errors.layout.actuated] = np.round(c[errors.layout.actuated], MOTOR_DECIMALS)
    solved = closed(errors, rounded, errors.passive)
    return solved if is_closed(errors, solved) and errors.apart(c, solved).max() < NEAR else c


def _directions(errors: LoopErrors, c: np.ndarray) -> list[np.ndarray]:
    """List displacements (n_y,) that keep the loops closed, their largest entries 1; motors' first."""
    _, G = errors(c)
    _, sigma, Vt = np.linalg.svd(G[:, errors.looped])
    null = Vt[int((sigma > 1e-7).sum()) :]
    projector = null.T @ null
    actuated = np.isin(errors.looped, errors.layout.actuated)
    directions: list[np.ndarray] = []
    for k in np.argsort(~actuated, kind="stable"):
        size = np.linalg.norm(projector[k])
        if size < 0.1 or any(
            abs(projector[k] @ direction) > 0.99 * size * np.linalg.norm(direction) for direction in directions
        ):
            continue
        directions.append(projector[k] / np.abs(projector[k]).max())
    steps = np.zeros((len(directions), errors.layout.n_y))
    steps[:, errors.looped] = np.reshape(directions, (len(directions), errors.looped.size))
    return list(steps)
