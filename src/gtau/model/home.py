"""Closing a robot's home: the configuration in which its loops hold, from the model's own closure equations.

Readers take home from a file as it stands there, if it stands there at all. Here it is solved, by Levenberg-Marquardt,
and whatever moves by more than rounding is said in a note of the robot.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from gtau.documents.validation import validate
from gtau.documents.yaml_document import Document
from gtau.errors import GtauError
from gtau.model.coordinates import Coordinates, coordinates
from gtau.model.loop_closure import LoopErrors, closed, is_closed, loop_errors
from gtau.robots.geometry import pose_of
from gtau.robots.readers.read import read_robot
from gtau.robots.readers.source import RobotSource
from gtau.robots.robot import Joint, Pose, Robot

# Lengths in what follows are counted in characteristic lengths of the robot, angles in rad.
KEPT = 1e-9  # a home that the solution leaves by less than this stays as it is written
NEAR = 1e-3  # a home that the solution leaves by less than this is the one meant: no note
FAR = 1.0  # what a home that the file gives may be wrong by
LIMITS = 1e-4  # rad or m: files round homes and limits, so one beyond a limit by less than this is within it
WELL_CONDITIONED = 30.0  # of the scaled passive columns, where a home that is searched for is moved to
POOR = 100.0  # a home that was searched for and is worse than this is moved on, away from singular poses
SINGULAR = 1e3  # any home is: the model accepts no pose beyond it
STEP = 0.1
STARTS = 40
MOTOR_DECIMALS = 6  # of the motors' positions in a home that was searched for: beyond them processors may differ,
DECIMALS = 12  # and beyond these in what the closures make of them
NAMED = 4  # coordinates that a note lists


def load_robot(
    source: str | Path | Robot | RobotSource,
    base: str | Mapping[str, Sequence[float | str]] | None = None,
    joints: Sequence[str] = (),
    held: Mapping[str, float] | None = None,
) -> Robot:
    """Load a robot, or a part of one, and close its loops.

    Parameters
    ----------
    source : str, Path, Robot or RobotSource
        A name of the catalog or the path of a file, see :func:`gtau.robots.readers.read.read_robot`; a robot is
        returned as it is, and with a ``RobotSource`` all that follows is left out.
    base : "fixed", "floating" or mapping, optional
        ``"fixed"`` fixes a floating base where the file has it; ``{"rpy": [roll, pitch, yaw]}``, rad, fixes it turned
        so in a world whose z axis points up, or mounts a robot so that is fixed already; ``"floating"`` lets the base
        move freely, by six joints without motors (see :mod:`gtau.robots.floating`).
    joints : sequence of str, optional
        Patterns (``FL_*``) of the joints that move; the others are held. All move if left out.
    held : mapping of str to float, optional
        Positions of joints that are held, rad or m; those not named are held at home.

    Returns
    -------
    Robot
        Its ``notes`` say what a reader found odd or decided, and how far home was moved to close the loops.

    Raises
    ------
    GtauError
        There is no such robot, its file is not accepted, or its loops close nowhere.
    """
    if isinstance(source, Robot):
        return source
    if isinstance(source, RobotSource):
        found, name = source, source.file
    else:
        options = {"file": str(source), "base": base, "joints": tuple(joints), "held": dict(held or {})}
        found, name = validate(RobotSource, Document(Path("load_robot"), options, {})), str(source)
    robot = read_robot(found)
    try:
        return close_home(robot)
    except GtauError as error:
        raise GtauError(f"{name}: {error}") from None


def close_home(robot: Robot) -> Robot:
    """Solve for a home configuration in which the loops of a robot close.

    With the motors held at home, the passive coordinates are moved. If the loops do not close near there within the
    position limits, all coordinates in loops are moved, from home and then from random starts, always the same, and
    the solution nearest to home is taken, at any distance if the file gives no home. A solution close to a singularity
    is moved within its assembly mode until it is well-conditioned. Coordinates in no loop stay, but within limits.

    Parameters
    ----------
    robot : Robot
        Any robot; one without closures and couplings keeps its home, within its limits.

    Returns
    -------
    Robot
        With a note on what was moved and by how much.

    Raises
    ------
    GtauError
        The loops close nowhere, or only far from the home that the file gives.
    """
    errors = loop_errors(coordinates(robot))
    robot = _within_limits(robot, set(errors.looped.tolist()))
    layout = coordinates(robot)
    errors, given = replace(errors, layout=layout), layout.home
    if not errors.looped.size:
        return robot
    nearest = _nearest(errors, given)
    if robot.home_given and errors.apart(given, nearest).max() > FAR:
        raise GtauError(
            f"robot '{robot.name}': the loops close only far from the home configuration in the file, with "
            f"{_displacements(errors, given, nearest)}; correct the placements, or write a 'home' closer to the "
            "assembled robot."
        )
    found, least = nearest, SINGULAR if errors.apart(given, nearest).max() < NEAR else POOR
    singular = errors.condition(errors(nearest)[1]) > least
    if singular:
        found = _conditioned(errors, nearest)
    moved = errors.apart(given, found)
    if moved.max() < KEPT:
        return replace(robot, home_given=True)
    if moved.max() > NEAR:
        found = _with_round_motors(errors, found)
    solved = _at(robot, layout, found)
    if moved.max() < NEAR:
        return solved
    note = f"home was solved so that the loops close: {_displacements(errors, given, found)}"
    if singular:
        worse, better = (errors.condition(errors(c)[1]) for c in (nearest, found))
        note += (
            f" (the nearest pose that closes, with {_motors(layout, nearest)}, is closer to a singularity: condition "
            f"number {worse:.3g} instead of {better:.3g})"
        )
    note += "; if the robot is assembled in another way, save it as a robot file and write another 'home' there"
    return replace(solved, notes=(*solved.notes, note))


def _nearest(errors: LoopErrors, given: np.ndarray) -> np.ndarray:
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
    return any(_excess(errors.layout.robot.joints[k], c[k]) > LIMITS for k in _looped_joints(errors))


def _looped_joints(errors: LoopErrors) -> list[int]:
    return [int(k) for k in errors.looped if k < len(errors.layout.robot.joints)]


def _excess(joint: Joint, value: float) -> float:
    """Compute how far a coordinate is beyond its joint's position limits, rad or m."""
    low, high = joint.limits.position or (-np.inf, np.inf)
    return max(low - value, value - high, 0.0)


def _within_limits(robot: Robot, looped: set[int]) -> Robot:
    """Move the homes of joints in no loop within their limits, with a note on those moved."""
    joints, moved = list(robot.joints), []
    for k, joint in enumerate(robot.joints):
        if k not in looped and joint.limits.position is not None and _excess(joint, joint.home) > LIMITS:
            nearest = float(np.clip(joint.home, *joint.limits.position))
            joints[k] = replace(joint, home=nearest)
            moved.append(f"'{joint.name}' from {joint.home:.4g} to {nearest:.4g} {_unit(joint)}")
    if not moved:
        return robot
    note = f"home lay outside the position limits and was moved to the nearest one: joint {', '.join(moved)}"
    return replace(robot, joints=tuple(joints), notes=(*robot.notes, note))


def _conditioned(errors: LoopErrors, c: np.ndarray) -> np.ndarray:
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


def _with_round_motors(errors: LoopErrors, c: np.ndarray) -> np.ndarray:
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


def _at(robot: Robot, layout: Coordinates, c: np.ndarray) -> Robot:
    """Return the robot with home at ``c`` (n_c,), up to what the processor's rounding leaves alone."""
    c = np.round(c, DECIMALS) + 0.0
    platforms = []
    for slots in layout.platforms:
        rotation = slots.rotation(c)
        pose = pose_of(rotation, c[slots.position])
        roll, pitch, yaw = (round(angle, DECIMALS) + 0.0 for angle in pose.rpy)
        platforms.append(replace(slots.platform, home=Pose(pose.xyz, (roll, pitch, yaw))))
    joints = zip(robot.joints, c[: len(robot.joints)].tolist(), strict=True)
    return replace(
        robot,
        joints=tuple(replace(joint, home=value) for joint, value in joints),
        platforms=tuple(platforms),
        home_given=True,
    )


def _displacements(errors: LoopErrors, given: np.ndarray, found: np.ndarray) -> str:
    """List what moved, and by how much, the largest displacements first."""
    layout, apart = errors.layout, errors.apart(given, found)
    parts = []
    for k, joint in enumerate(layout.robot.joints):
        text = f"joint '{joint.name}' from {given[k]:.4g} to {found[k]:.4g} {_unit(joint)}"
        parts.append((bool(not joint.actuated), -apart[k], text))
    for slots in layout.platforms:
        change = slots.displacement(given, found)
        angular = layout.angular[slots.rates]
        shift, turn = (float(np.linalg.norm(change[which])) for which in (~angular, angular))
        sizes = [f"{1e3 * shift:.4g} mm"] * (shift > NEAR * errors.length)
        sizes += [f"{np.degrees(turn):.4g} degrees"] * (turn > NEAR)
        parts.append((False, -apart[slots.rates].max(), f"platform '{slots.platform.name}' by {' and '.join(sizes)}"))
    parts = sorted(part for part in parts if -part[1] > NEAR)
    named = [text for _, _, text in parts[:NAMED]]
    return ", ".join(named) + (f" and {len(parts) - NAMED} more" if len(parts) > NAMED else "")


def _motors(layout: Coordinates, c: np.ndarray) -> str:
    return ", ".join(f"{layout.names[k]} = {c[k]:.4g}" for k in layout.actuated)


def _unit(joint: Joint) -> str:
    return "rad" if joint.kind == "revolute" else "m"
