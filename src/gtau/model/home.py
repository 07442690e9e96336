"""Load a robot, and solve for the home in which its loops close; a note says what was moved from the file's home."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gtau.documents.markup import Document
from gtau.documents.validation import MAPPING, NAMES, some_of, takes, validate
from gtau.errors import GtauError, errors_at
from gtau.model.kinematics import Coordinates
from gtau.model.loop_closure import (
    FAR,
    LIMITS,
    NEAR,
    LoopErrors,
    closed,
    is_closed,
    limit_excess,
    loop_errors,
    nearest_closed,
    well_conditioned,
    with_round_motors,
)
from gtau.model.rounded_loops import DRAWN, with_exact_loops
from gtau.robots.placement import pose_of
from gtau.robots.readers.read import read_robot
from gtau.robots.readers.source import RobotSource
from gtau.robots.robot import Pose, Robot

# Below, lengths are in characteristic lengths of the robot, angles in rad.
KEPT = 1e-9  # a home displaced by less than this by the solution is kept as written
POOR = 100.0  # a home found by the search and worse than this is moved further away from singular poses
SINGULAR = 1e3  # any home is: the model accepts no pose beyond it
DECIMALS = 12  # of a solved home: beyond them processors may differ
NAMED = 4  # coordinates that a note lists


@takes(
    source=("the name or path of a robot", (str, Path, Robot, RobotSource)),
    base=("fixed, floating or a mapping such as {'rpy': [0, 0, 0]}", (str, Mapping)),
    joints=NAMES,
    held=MAPPING,
    limits=MAPPING,
    xacro=MAPPING,
    packages=NAMES,
)
def load_robot(
    source: str | Path | Robot | RobotSource,
    base: str | Mapping[str, Sequence[float | str]] | None = None,
    joints: Sequence[str] = (),
    held: Mapping[str, float] | None = None,
    limits: Mapping[str, Mapping[str, Any]] | None = None,
    xacro: Mapping[str, Any] | None = None,
    packages: Sequence[str] = (),
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
        move freely, by six joints without motors (see :mod:`gtau.robots.geometry`).
    joints : sequence of str, optional
        Patterns (``FL_*``) of the joints that move; the others are held. All move if left out.
    held : mapping of str to float, optional
        Positions of joints that are held, rad or m; those not named are held at home.
    limits : mapping, optional
        Limits that replace limits of the file, by joint: ``{"elbow": {"velocity": 3.1, "effort": 150}}``, SI units.
    xacro : mapping, optional
        Arguments of a xacro file: ``{"ur_type": "ur10e"}``.
    packages : sequence of str, optional
        Folders that hold the packages that a xacro file names.

    Returns
    -------
    Robot
        Its ``notes`` list anomalies in the file, decisions of the reader, and the displacement of home.

    Raises
    ------
    GtauError
        The robot does not exist, its file is invalid, or its loops close nowhere.

    Examples
    --------
    >>> gtau.load_robot("five-bar").actuated
    ('left', 'right')
    """
    if isinstance(source, Robot):
        return source
    if not isinstance(source, RobotSource):
        options: dict[str, Any] = {"file": str(source), "base": base, "joints": tuple(joints)}
        options |= {"held": dict(held or {}), "limits": dict(limits or {}), "xacro": dict(xacro or {})}
        options["packages"] = tuple(packages)
        source = validate(RobotSource, Document("load_robot", options))
    robot = read_robot(source)
    with errors_at(source.file):
        return close_home(robot)


def close_home(robot: Robot) -> Robot:
    """Solve for a home configuration in which the loops of a robot close, with a note on what was moved.

    With the motors held at home, the passive coordinates are moved. If the loops do not close near there within the
    position limits, all coordinates in loops are moved, from home and then from random starts, always the same, and the
    solution nearest to home is taken, at any distance if the file gives no home. A solution close to a singularity is
    moved within its assembly mode until it is well-conditioned. Coordinates in no loop stay, but within limits.
    """
    if not (robot.closures or robot.couplings):
        return _within_limits(robot, set())
    errors = loop_errors(Coordinates(robot))
    robot = _within_limits(robot, set(errors.looped.tolist()))
    layout = Coordinates(robot)
    errors, given = replace(errors, layout=layout), layout.home
    if not errors.looped.size:
        return robot
    nearest = _roughly_closed(errors, given)
    if (exact := with_exact_loops(robot, errors, nearest)) is not robot:
        return close_home(exact)
    nearest = nearest if is_closed(errors, nearest) else nearest_closed(errors, given)
    far = errors.apart(given, nearest).max()
    if robot.file.home_given and far > FAR:
        raise GtauError(
            f"robot '{robot.name}': the loops close only far from the home configuration in the file, with "
            f"{_displacements(errors, given, nearest)}; correct the placements, or write a 'home' closer to the "
            "assembled robot."
        )
    singular = errors.condition(nearest) > (SINGULAR if far < NEAR else POOR)
    home = well_conditioned(errors, nearest) if singular else nearest
    moved = errors.apart(given, home).max()
    if moved < KEPT and is_closed(errors, closed(errors, given, errors.passive)):
        return robot.with_file(home_given=True)
    if moved > NEAR:
        home = with_round_motors(errors, home)
    solved = _at(robot, layout, home)
    if moved < NEAR:
        return solved
    note = f"home was solved so that the loops close: {_displacements(errors, given, home)}"
    if singular:
        pose = ", ".join(f"{layout.names[k]} = {nearest[k]:.4g}" for k in layout.actuated)
        note += (
            f" (the nearest pose that closes, with {pose}, is closer to a singularity: condition number "
            f"{errors.condition(nearest):.3g} instead of {errors.condition(home):.3g})"
        )
    note += "; if the robot is assembled in another way, save it as a robot file and write another 'home' there"
    return solved.noted(note)


def _roughly_closed(errors: LoopErrors, given: np.ndarray) -> np.ndarray:
    """Find the closed configuration (n_c,) nearest to the one given, or one closed up to the digits of the file."""
    held = closed(errors, given, errors.passive)
    if is_closed(errors, held, DRAWN) and not is_closed(errors, held):
        return held
    try:
        return nearest_closed(errors, given)
    except GtauError:
        return nearest_closed(errors, given, DRAWN)


def _within_limits(robot: Robot, looped: set[int]) -> Robot:
    """Move the homes of joints in no loop within their limits, with a note on those moved."""
    joints, moved = list(robot.joints), []
    for k, joint in enumerate(robot.joints):
        if k not in looped and joint.limits.position is not None and limit_excess(joint, joint.home) > LIMITS:
            nearest = float(np.clip(joint.home, *joint.limits.position))
            joints[k] = replace(joint, home=nearest)
            moved.append(f"'{joint.name}' from {joint.home:.4g} to {nearest:.4g} {joint.unit}")
    if not moved:
        return robot
    note = f"home lay outside the position limits and was moved to the nearest one: joint {', '.join(moved)}"
    return replace(robot, joints=tuple(joints)).noted(note)


def _at(robot: Robot, layout: Coordinates, c: np.ndarray) -> Robot:
    """Return the robot with home at ``c`` (n_c,), rounded to digits that do not depend on the processor."""
    c = np.round(c, DECIMALS) + 0.0
    platforms = []
    for slots in layout.platforms:
        pose = pose_of(slots.rotation(c), c[slots.position])
        roll, pitch, yaw = (round(angle, DECIMALS) + 0.0 for angle in pose.rpy)
        platforms.append(replace(slots.platform, home=Pose(pose.xyz, (roll, pitch, yaw))))
    homes = zip(robot.joints, c[: len(robot.joints)].tolist(), strict=True)
    joints = tuple(replace(joint, home=value) for joint, value in homes)
    return replace(robot, joints=joints, platforms=tuple(platforms)).with_file(home_given=True)


def _displacements(errors: LoopErrors, given: np.ndarray, home: np.ndarray) -> str:
    layout, apart = errors.layout, errors.apart(given, home)
    parts = []
    for k, joint in enumerate(layout.robot.joints):
        text = f"joint '{joint.name}' from {given[k]:.4g} to {home[k]:.4g} {joint.unit}"
        parts.append((not joint.actuated, -apart[k], text))
    for slots in layout.platforms:
        change = slots.displacement(given, home)
        angular = layout.angular[slots.rates]
        shift, turn = (float(np.linalg.norm(change[which])) for which in (~angular, angular))
        sizes = [f"{1e3 * shift:.4g} mm"] * (shift > NEAR * layout.length)
        sizes += [f"{np.degrees(turn):.4g} degrees"] * (turn > NEAR)
        parts.append((False, -apart[slots.rates].max(), f"platform '{slots.platform.name}' by {' and '.join(sizes)}"))
    return some_of([text for _, size, text in sorted(parts) if -size > NEAR], NAMED)
