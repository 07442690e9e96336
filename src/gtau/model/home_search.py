"""The closed configuration that is to be home: the nearest to the one given, away from singular poses."""

from __future__ import annotations

import numpy as np

from gtau.errors import GtauError
from gtau.model.loop_closure import LoopErrors, closed, is_closed
from gtau.robots.robot import Joint

# Lengths in what follows are counted in characteristic lengths of the robot, angles in rad.
NEAR = 1e-3  # a home that the solution leaves by less than this is the one meant: no note
FAR = 1.0  # what a home that the file gives may be wrong by
LIMITS = 1e-4  # rad or m: files round homes and limits, so one beyond a limit by less than this is within it
WELL_CONDITIONED = 30.0  # of the scaled passive columns, where a home that is searched for is moved to
STEP = 0.1
STARTS = 40
MOTOR_DECIMALS = 6  # of the motors' positions in a home that was searched for: beyond them processors may differ


def nearest_closed(errors: LoopErrors, given: np.ndarray) -> np.ndarray:
    """Find the closed configuration (n_c,) nearest to the one given, within the position limits if there is one."""
    held = closed(errors, given, errors.passive)
    near = not errors.layout.robot.home_given or errors.apart(given, held).max() < FAR
    if near and is_closed(errors, held) and not _outside(errors, held):
        return _unwound(errors, given, held)
    best: tuple[tuple[bool, float], np.ndarray] | None = None
    rng, open_ones = np.random.default_rng(0), [held]
    for start in range(STARTS):
        found = closed(errors, _scattered(errors, given, rng) if start else given, errors.looped)
        if not is_closed(errors, found):
            open_ones.append(found)
            continue
        found = _unwound(errors, given, found)
        rank = _outside(errors, found), float(np.linalg.norm(errors.apart(given, found)))
        if best is None or rank < best[0]:
            best = rank, found
        if start == 0 and not rank[0]:
            break
    if best is None:
        nearly = min(open_ones, key=lambda c: float(np.abs(errors(c)[0]).max()))
        raise GtauError(
            f"robot '{errors.layout.robot.name}': the loops do not close near the home configuration, nor in any other "
            f"pose that was tried, at best {errors.gap(nearly)}; check the placements of the closures and of the "
            "joints in the loops, and their units, or write a 'home' closer to the assembled robot."
        )
    return best[1]


def _unwound(errors: LoopErrors, given: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Remove full turns from a configuration, which the couplings do not forgive."""
    coupled = {name for each in errors.layout.robot.couplings for name in (each.joint, *dict(each.ratios))}
    unwound = found.copy()
    for k, joint in enumerate(errors.layout.robot.joints):
        if joint.kind == "revolute" and joint.name not in coupled:
            unwound[k] = given[k] + np.remainder(found[k] - given[k] + np.pi, 2 * np.pi) - np.pi
    return unwound


def _scattered(errors: LoopErrors, given: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    c = given.copy()
    for k, joint in enumerate(errors.layout.robot.joints):
        if k in errors.looped:
            reach = np.pi if joint.kind == "revolute" else errors.length
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
    """Move a closed configuration (n_c,) step by step until it is well-conditioned, or as far as that gets better.

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
                    best = min(best, (there, tried), key=lambda each: each[0])
        size = size if best[0] < 0.99 * condition else size / 2
        condition, c = best
    return c


def with_round_motors(errors: LoopErrors, c: np.ndarray) -> np.ndarray:
    """Find the closed configuration (n_c,) next to ``c`` whose motors stand at rounded positions, if there is one."""
    rounded = c.copy()
    rounded[errors.layout.actuated] = np.round(c[errors.layout.actuated], MOTOR_DECIMALS)
    found = closed(errors, rounded, errors.passive)
    return found if is_closed(errors, found) and errors.apart(c, found).max() < NEAR else c


def _directions(errors: LoopErrors, c: np.ndarray) -> list[np.ndarray]:
    """List displacements (n_y,) that keep the loops closed, their largest entries 1; motors' first."""
    _, G = errors(c)
    _, sigma, Vt = np.linalg.svd(G[:, errors.looped])
    null = Vt[int((sigma > 1e-7).sum()) :]
    projector = null.T @ null
    actuated = np.isin(errors.looped, errors.layout.actuated)
    found: list[np.ndarray] = []
    for k in np.argsort(~actuated, kind="stable"):
        size = np.linalg.norm(projector[k])
        if size < 0.1 or any(abs(projector[k] @ each) > 0.99 * size * np.linalg.norm(each) for each in found):
            continue
        found.append(projector[k] / np.abs(projector[k]).max())
    steps = np.zeros((len(found), errors.layout.n_y))
    steps[:, errors.looped] = np.reshape(found, (len(found), errors.looped.size))
    return list(steps)
