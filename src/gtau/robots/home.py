"""Putting a robot together: a home configuration in which its loops close."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gtau.errors import GtauError
from gtau.robots.geometry import (
    Configuration,
    at_home,
    characteristic_length,
    home_configuration,
    loop_errors,
    turn,
)
from gtau.robots.robot import Robot

CLOSED = 1e-11  # rad, or lengths over the characteristic length
WELL_CONDITIONED = 30.0  # of the passive columns: a home that is searched for is well away from singular poses
SINGULAR = 1e3
NEAR = 1e-3  # a solution as near as that to the home given is the one meant
STEP = 0.1  # rad, or lengths over the characteristic length
STARTS = 40
STALLED = 15  # steps that hardly help, and a start is given up


def close_home(robot: Robot) -> Robot:
    """Find a home in which the loops close, motors and all, for a robot whose file gives none that does.

    Levenberg-Marquardt over all coordinates, from the robot's home, and if that does not close within the position
    limits, from random starts, always the same, of whose solutions the one nearest to home is taken. Then it is moved
    within its assembly mode until it is well-conditioned. A home that closes already stays, unless it is singular.

    Parameters
    ----------
    robot : Robot
        Any robot; without closures and couplings it is returned as it is.

    Returns
    -------
    Robot
        With a note where home was moved.

    Raises
    ------
    GtauError
        The loops close nowhere.
    """
    if not (robot.closures or robot.couplings):
        return robot
    length = characteristic_length(robot)
    given = home_configuration(robot)
    best: tuple[tuple[bool, float], Configuration] | None = None
    rng = np.random.default_rng(0)
    for start in range(STARTS):
        found = _closed(robot, _scattered(robot, given, length, rng) if start else given, length)
        if found is None:
            continue
        found = Configuration(given.q + _moved(robot, given, found), found.platforms)  # no full turns
        rank = _outside(robot, found), _distance(robot, given, found, length)
        if best is None or rank < best[0]:
            best = rank, found
        if start == 0 and not rank[0]:
            break
    if best is None:
        raise GtauError(
            f"robot '{robot.name}': its loops do not close in any pose that was tried; check the placements of the "
            "closures and of the joints in the loops, and their units."
        )
    (_, distance), found = best
    nearest, condition = found, _condition(robot, loop_errors(robot, found, length)[1])
    if distance > NEAR or condition > SINGULAR:
        found = _conditioned(robot, found, length)
    solved = at_home(robot, found)
    if _distance(robot, given, found, length) < NEAR:
        return solved
    note = f"home was solved so that the loops close, with {_actuated(robot, found)}"
    if found is not nearest:
        better = _condition(robot, loop_errors(robot, found, length)[1])
        note += (
            f" (the nearest pose that closes, with {_actuated(robot, nearest)}, is closer to a singularity: condition "
            f"number {condition:.3g} instead of {better:.3g})"
        )
    note += "; where the robot is assembled in another way, save it as a robot file and write another 'home' there"
    return replace(solved, notes=(*solved.notes, note))


def _actuated(robot: Robot, configuration: Configuration) -> str:
    pairs = zip(robot.joints, configuration.q, strict=True)
    return ", ".join(f"{joint.name} = {value:.4g}" for joint, value in pairs if joint.actuated)


def _closed(robot: Robot, configuration: Configuration, length: float) -> Configuration | None:
    """The loops closed by Levenberg-Marquardt, or None where that fails."""
    damping, stalled = 1e-3, 0
    error, J = loop_errors(robot, configuration, length)
    for _ in range(200):
        size = np.linalg.norm(error)
        if np.abs(error).max(initial=0.0) < 1e-15:
            break
        U, sigma, Vt = np.linalg.svd(J, full_matrices=False)
        level = damping * size  # fades as the loops close: Newton's method in the end
        share = np.where(sigma > 1e-9, sigma / (sigma**2 + level), 0.0)
        tried = _stepped(robot, configuration, -Vt.T @ (share * (U.T @ error)), length)
        error_there, J_there = loop_errors(robot, tried, length)
        there = np.linalg.norm(error_there)
        stalled = stalled + 1 if there > 0.99 * size else 0
        if stalled == STALLED:
            break
        if there < size:
            configuration, error, J = tried, error_there, J_there
            damping = max(damping / 3, 1e-12)
        elif damping > 1e3 or size < CLOSED:
            break
        else:
            damping *= 4
    return configuration if np.abs(error).max(initial=0.0) < CLOSED else None


def _stepped(robot: Robot, configuration: Configuration, step: np.ndarray, length: float) -> Configuration:
    n = len(robot.joints)
    step = step / max(1.0, np.abs(step).max())
    units = np.array([1.0 if joint.kind == "revolute" else length for joint in robot.joints])
    platforms = []
    for k, (R, p) in enumerate(configuration.platforms):
        move = step[n + 6 * k : n + 6 * k + 6]
        angle = float(np.linalg.norm(move[3:]))
        platforms.append((turn(move[3:] / angle, angle) @ R if angle else R, p + length * move[:3]))
    return Configuration(configuration.q + units * step[:n], tuple(platforms))


def _scattered(robot: Robot, given: Configuration, length: float, rng: np.random.Generator) -> Configuration:
    q = []
    for joint, value in zip(robot.joints, given.q, strict=True):
        reach = np.pi if joint.kind == "revolute" else length
        low, high = joint.limits.position or (value - reach, value + reach)
        q.append(rng.uniform(max(low, value - reach), min(high, value + reach)) if low < high else value)
    return Configuration(np.array(q), given.platforms)


def _moved(robot: Robot, given: Configuration, found: Configuration) -> np.ndarray:
    """How far every joint has moved, full turns left out."""
    revolute = np.array([joint.kind == "revolute" for joint in robot.joints])
    moved = found.q - given.q
    return np.where(revolute, np.remainder(moved + np.pi, 2 * np.pi) - np.pi, moved)


def _distance(robot: Robot, given: Configuration, found: Configuration, length: float) -> float:
    revolute = np.array([joint.kind == "revolute" for joint in robot.joints])
    moved = np.where(revolute, 1.0, 1.0 / length) * _moved(robot, given, found)
    platforms = [(p - p_0) / length for (_, p), (_, p_0) in zip(found.platforms, given.platforms, strict=True)]
    return float(np.linalg.norm(np.concatenate([moved, *platforms])))


def _outside(robot: Robot, found: Configuration) -> bool:
    return any(
        joint.limits.position is not None and not joint.limits.position[0] <= value <= joint.limits.position[1]
        for joint, value in zip(robot.joints, found.q, strict=True)
    )


def _condition(robot: Robot, J: np.ndarray) -> float:
    """Condition number of the passive columns."""
    actuated = [k for k, joint in enumerate(robot.joints) if joint.actuated]
    passive = np.delete(J, actuated, axis=1)
    sigma = np.linalg.svd(passive[:, np.any(passive, axis=0)], compute_uv=False)
    return float(sigma[0] / max(sigma[-1], 1e-12)) if sigma.size else 1.0


def _conditioned(robot: Robot, found: Configuration, length: float) -> Configuration:
    """Move a closed configuration step by step until it is well-conditioned, or as far as that gets better."""
    _, J = loop_errors(robot, found, length)
    condition, size = _condition(robot, J), STEP
    while condition > WELL_CONDITIONED and size > STEP / 10:
        used = np.any(J, axis=0)
        _, sigma, Vt = np.linalg.svd(J[:, used])
        free = np.zeros((used.sum() - int((sigma > 1e-7).sum()), J.shape[1]))
        free[:, used] = Vt[used.sum() - len(free) :]
        best = condition, found, J
        for step in (sign * size * direction / np.abs(direction).max() for direction in free for sign in (1, -1)):
            tried = _closed(robot, _stepped(robot, found, step, length), length)
            if tried is None or _outside(robot, tried) > _outside(robot, found):
                continue
            _, J_there = loop_errors(robot, tried, length)
            if _condition(robot, J_there) < best[0]:
                best = _condition(robot, J_there), tried, J_there
        size = size if best[0] < 0.99 * condition else size / 2
        condition, found, J = best
    return found
