"""Default guards against collisions: guessed shapes of bodies, a floor, and a speed of the tool."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from gtau.documents.validation import some_of
from gtau.errors import GtauError
from gtau.excitation.clearance import (
    FIXED,
    FLOOR,
    Capsule,
    Clearance,
    Floor,
    Shape,
    bounding_capsule,
    capsule,
    clearance,
)
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.singularities import random_motion
from gtau.robots.geometry import places_on
from gtau.robots.readers.links import urdf_shapes
from gtau.robots.robot import GROUND, Joint, Robot

SLENDER = 0.04  # radius of a link of unknown shape over the arm's length: UR10e 0.07 m, Panda 0.06 m, like their tubes
STUBBY = 0.4  # largest radius over the length of the link
ROOM = 1.1  # distance of the resting arm from a guessed floor, over the clearance
STATES = 64  # random poses that show whether a distance can change
SAME = 1e-9  # m
STATE = "limits.shapes"
TOOL_SPEED = 1.5  # m/s, to which Universal Robots sets new arms; a first motion took a UR5's tool to 3.8 m/s
# m/s, by a word in a robot's name, as manuals state: 1.7 (Franka, limits of its control interface), 0.5 (Kinova, guide
# of the Gen3: 50 cm/s in Cartesian translation), 1 (Ufactory, user manual of the xArm: up to 1000 mm/s)
MAKERS = {"panda": 1.7, "gen3": 0.5, "xarm": 1.0}


@dataclass(frozen=True, eq=False)
class Guarded:
    """Bodies to keep apart (None if there are none), and sentences on them that name the keys to change."""

    clearance: Clearance | None
    notes: tuple[str, ...]


def guard(
    model: InverseDynamics,
    rest: np.ndarray,
    least: float,
    stated: Mapping[str, Sequence[Shape]] | None,
    floor: float | str | None,
    file: Path,
) -> Guarded:
    """Keep bodies apart and off a floor, with ``stated`` shapes, shapes of the robot's file, or guessed shapes.

    Runs begin at ``rest`` (n_c, 1); ``least`` is the clearance in m, ``file`` the robot's file. If ``stated`` is None,
    bodies are only kept off the floor. ``floor`` is its height, m, None to guess it, or "none".
    """
    floor_only, stated = stated is None, stated or {}
    guesses, how = _guesses(model.robot, stated, file)
    how = f"self-collision: not checked, as '{STATE}: none' says" if floor_only else how
    shapes: dict[str, Sequence[Shape]] = {**guesses, **stated}
    height, words = _floor(model, shapes, rest, least, floor)
    if isinstance(floor, float):
        shapes, thin = _above(model, shapes, stated, rest, least, floor)
        words += thin
    kept_apart = clearance(model.layout, least, shapes if height is None else {**shapes, FLOOR: [Floor(height)]})
    certain = {*stated, *([FLOOR] if isinstance(floor, float) else [])}
    pairs, overlapping = list[tuple[str, str]](), list[tuple[str, str]]()
    moving = random_motion(model, STATES, np.random.default_rng(0)).c if guesses or certain else rest
    for pair in kept_apart.pairs:
        if FLOOR not in pair and (floor_only or not {*pair} <= {GROUND, *guesses, *stated}):
            continue
        distance = float(kept_apart.nearest(rest, pair).distance[0])
        if distance < least and certain.issuperset(pair):
            raise GtauError(
                f"{_named(pair)} are {distance:.3g} m apart at rest, less than limits.clearance of {least:g} m; give "
                f"them smaller shapes ({STATE}), or another 'rest'."
            )
        if certain.issuperset(pair) or np.ptp(kept_apart.nearest(moving, pair).distance) > SAME:
            (overlapping if distance < least else pairs).append(pair)
    notes = [words, how]
    if overlapping:
        named = "; ".join(map(_named, overlapping))
        notes.append(f"not checked, as guessed shapes overlap at rest: {named}; state {STATE}")
    if model.robot.tool not in stated and pairs:
        notes.append(f"tool, payload and cables have no shape; add them to '{model.robot.tool}' under {STATE}")
    return Guarded(replace(kept_apart, pairs=tuple(pairs)) if pairs else None, tuple(notes))


def speed_of_tool(robot: Robot, stated: float | None) -> tuple[float, str]:
    """Choose the largest speed of the tool's frame, m/s, and say why."""
    if stated is not None:
        return stated, f"tool: at most {stated:g} m/s, as stated"
    name = robot.name.lower()
    allowed = next((speed for word, speed in MAKERS.items() if word in name), None)
    why = "the usual setting of arms beside people" if allowed is None else f"which the maker of '{robot.name}' allows"
    fastest = allowed or TOOL_SPEED
    return fastest, f"tool: at most {fastest:g} m/s, {why}; state limits.tool_speed"


def _named(pair: tuple[str, str]) -> str:
    return " and ".join(body if body == FLOOR else f"'{body}'" for body in pair)


def _guesses(robot: Robot, stated: Mapping[str, Sequence[Shape]], file: Path) -> tuple[dict[str, list[Capsule]], str]:
    """Guess shapes of bodies without a stated shape, and say how."""
    in_file, ends, missing = urdf_shapes(file) if file.suffix.lower() == ".urdf" and file.is_file() else ({}, {}, {})
    bodies = [body for body in (GROUND, *robot.bodies) if body not in stated]
    drawn = {body: [_around(*shape) for shape in in_file[body]] for body in bodies if body in in_file}
    links = {} if robot.closures else _links(robot, ends)
    lines = {body: links[body] for body in bodies if body in links and (body not in drawn or body in missing)}
    unread = sum(missing.values())
    meshes = f"; {unread} meshes of the file were not found or are neither STL nor OBJ" if unread else ""
    if robot.closures and not drawn:
        checked = f"only bodies under {STATE} are checked" if stated else "self-collision: not checked"
        how = f"links of closed loops cross, and their thickness is unknown{meshes}; state {STATE}"
        return {}, f"{checked}: {how}"
    kinds: dict[str, Mapping[str, Any]] = {
        "stated": stated,
        "about the robot file's shapes": drawn,
        "guessed about lines from joint to joint": lines,
    }
    sources = [f"{words} for {some_of(list(named), 3)}" for words, named in kinds.items() if named]
    if not sources:
        return {}, f"self-collision: not checked, as the robot file has no shapes and no lengths; state {STATE}"
    shapes = {body: [*drawn.get(body, ()), *lines.get(body, ())] for body in bodies if body in {**drawn, **lines}}
    return shapes, f"self-collision: bodies are capsules, {', '.join(sources)}{meshes}; state {STATE}"


def _around(points: np.ndarray, radius: float) -> Capsule:
    inner = bounding_capsule(points)
    return replace(inner, radius=inner.radius + radius)


def _links(robot: Robot, ends: Mapping[str, Sequence[np.ndarray]]) -> dict[str, list[Capsule]]:
    """Guess capsules from the origin of every body to its followers, as thick as robot arms of that length."""
    far = {GROUND: 0.0}
    for joint in robot.joints:
        far[joint.name] = far[joint.antecedent] + float(np.linalg.norm(joint.placement.position))
    thick, radii, capsules = SLENDER * max(far.values()), {GROUND: 0.0}, {}
    for body in (GROUND, *(joint.name for joint in robot.joints)):
        paths = [_path(joint) for joint in robot.joints if joint.antecedent == body]
        if not paths and body != GROUND:
            paths = [[np.zeros(3), end] for end in ends.get(body, ())] or [[np.zeros(3)] * 2]
        length = max((float(np.linalg.norm(path[-1])) for path in paths), default=0.0)
        before = next((radii[joint.antecedent] for joint in robot.joints if joint.name == body), 0.0)
        radii[body] = min(thick, STUBBY * length) if length > 1e-6 else before or thick
        if radii[body] > 0.0:
            capsules[body] = [capsule(start, end, radii[body]) for path in paths for start, end in pairwise(path)]
    return capsules


def _path(joint: Joint) -> list[np.ndarray]:
    """Lead from a body's origin to the next joint, across its axis and then along it, like arms with offsets."""
    end, direction = joint.placement.position, joint.placement.rotation @ np.array(joint.axis)
    corner = end - (end @ direction) * direction
    inner = [corner] if min(np.linalg.norm(corner), np.linalg.norm(end - corner)) > 1e-6 else []
    return [np.zeros(3), *inner, end]


def _floor(
    model: InverseDynamics,
    shapes: Mapping[str, Sequence[Shape]],
    rest: np.ndarray,
    least: float,
    floor: float | str | None,
) -> tuple[float | None, str]:
    """Choose the height of the floor (None without a floor), and say why."""
    state = "state 'limits: {floor: HEIGHT}' (m, along z of the base)"
    if isinstance(floor, str):
        return None, "floor: not checked, as 'limits: {floor: none}' says"
    if floor is not None:
        return floor, f"floor: {floor:zg} m along z of the base, as stated"
    probe = clearance(model.layout, least, {**shapes, FLOOR: [Floor(0.0)]})
    moving = random_motion(model, STATES, np.random.default_rng(0)).c
    pairs = [pair for pair in probe.pairs if FLOOR in pair and np.ptp(probe.nearest(moving, pair).distance) > SAME]
    if not pairs:
        return None, f"floor: none guessed, as no body that moves up or down has a shape; {state}"
    lowest = min(float(probe.nearest(rest, pair).distance[0]) for pair in pairs)
    origins = min(float(pose[1][2, 0]) for pose in (probe.poses(body, rest) for body in shapes if body not in FIXED))
    if origins < -1e-6:
        return None, f"floor: none guessed, as the resting arm reaches below z = 0 of the base; {state}"
    height = min(0.0, lowest - ROOM * least)
    down = model.robot.gravity[2] < -0.99 * float(np.linalg.norm(model.robot.gravity)) < 0
    plane = "" if down else ", the plane of its mounting: the position of the real floor is unknown"
    lower = " (the resting arm is closer to z = 0 than the clearance)" if height < 0 else ""
    return height, f"floor: guessed at z = {height:z.3g} m of the base{plane}{lower}; {state}"


def _above(
    model: InverseDynamics,
    shapes: Mapping[str, Sequence[Shape]],
    stated: Collection[str],
    rest: np.ndarray,
    least: float,
    height: float,
) -> tuple[dict[str, Sequence[Shape]], str]:
    """Keep bodies without a shape off a stated floor as lines, and make guessed shapes that rest in it thinner."""
    bare = {body: places_on(model.robot, body) or [np.zeros(3)] for body in model.robot.bodies if body not in shapes}
    shapes = {**shapes, **{body: [capsule(np.zeros(3), end, 0.0) for end in ends] for body, ends in bare.items()}}
    probe = clearance(model.layout, least, {**shapes, FLOOR: [Floor(height)]})
    moving, thin = random_motion(model, STATES, np.random.default_rng(0)).c, []
    for pair in (pair for pair in probe.pairs if FLOOR in pair and not {*pair} & {*stated}):
        distance = float(probe.nearest(rest, pair).distance[0])
        if distance >= least or np.ptp(probe.nearest(moving, pair).distance) <= SAME:
            continue
        body, lack = pair[1], ROOM * least - distance
        capsules = [shape for shape in shapes[body] if isinstance(shape, Capsule)]  # all guesses are capsules
        shapes[body] = [replace(shape, radius=max(shape.radius - lack, 0.0)) for shape in capsules]
        thinner = clearance(model.layout, least, {body: shapes[body], FLOOR: [Floor(height)]})
        if (distance := float(thinner.nearest(rest, pair).distance[0])) < least:
            raise GtauError(
                f"the line from joint to joint of '{body}' is {distance:.3g} m above the floor at rest (limits.floor: "
                f"{height:g}), less than limits.clearance of {least:g} m; correct floor or 'rest', or state {STATE}."
            )
        thin.append(f"'{body}'")
    quoted = some_of([f"'{body}'" for body in bare], 3)
    without = f"; lines from joint to joint without thickness stand for {quoted}" if bare else ""
    return shapes, without + (f"; {some_of(thin, 3)} taken thinner than guessed, to rest above it" if thin else "")
