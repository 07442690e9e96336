"""Default guards against collisions: shapes of bodies, read or guessed, a floor, and a speed of the tool."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise, product
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from gtau.documents.files import read_at_most
from gtau.documents.markup import numbers
from gtau.documents.validation import some_of
from gtau.errors import GtauError
from gtau.excitation.clearance import FIXED, FLOOR, Capsule, Clearance, Floor, Pair, Shape, bounding_capsule, clearance
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.singularities import random_motion
from gtau.robots.geometry import places_on
from gtau.robots.readers.source import Base
from gtau.robots.readers.urdf_tree import origin_of, read_urdf_tree
from gtau.robots.robot import GROUND, Joint, Robot

SLENDER = 0.04  # radius of a link of unknown shape over the arm's length: UR10e 0.07 m, Panda 0.06 m
STUBBY = 0.4  # largest radius over the length of the link
ROOM = 1.1  # distance of the resting arm from a guessed floor, over the clearance
STATES = 64  # random poses that show whether a distance can change
SAME = 1e-9  # m
STATE = "limits.shapes"
TOOL_SPEED = 1.5  # m/s; Universal Robots sets new arms to it
# m/s, by a word in a robot's name, as manuals state: 1.7 (Franka, limits of its control interface), 0.5 (Kinova, guide
# of the Gen3: 50 cm/s in Cartesian translation), 1 (Ufactory, user manual of the xArm: up to 1000 mm/s)
MAKERS = {"panda": 1.7, "gen3": 0.5, "xarm": 1.0}
LARGEST_MESH = 64 * 2**20  # bytes
RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])  # of an STL file
Shapes = Mapping[str, Sequence[Shape]]
Blob = tuple[np.ndarray, float]
"""Points (K, 3), m, and the radius of a ball about each; the convex hull of the balls encloses a shape."""


def guard(
    model: InverseDynamics, rest: np.ndarray, least: float, stated: Shapes | None, floor: float | str | None, file: Path
) -> tuple[Clearance | None, tuple[str, ...]]:
    """Keep bodies apart and off a floor, with ``stated`` shapes, shapes of the robot's file, or guessed shapes.

    Runs begin at ``rest`` (n_c, 1); ``least`` is the clearance in m, ``file`` the robot's file. If ``stated`` is None,
    bodies are only kept off the floor. ``floor`` is its height, m, None to guess it, or "none". Returns the bodies to
    keep apart, None if there are none, and sentences on them that name the keys to change.
    """
    floor_only, stated = stated is None, stated or {}
    guesses, how = _guesses(model.robot, stated, file)
    how = f"self-collision: not checked, as '{STATE}: none' says" if floor_only else how
    probe = _Probe(model, rest, least)
    shapes: Shapes = {**guesses, **stated}
    height, words = _floor(probe, shapes, floor)
    certain = {*stated}
    if isinstance(floor, float):
        shapes, thin = _above(probe, shapes, stated, floor)
        words += thin
        certain.add(FLOOR)
    kept_apart = probe.clearance(shapes, height)
    known = {GROUND, *guesses, *stated}
    pairs, overlapping = list[Pair](), list[Pair]()
    for pair in kept_apart.pairs:
        if FLOOR not in pair and (floor_only or not {*pair} <= known):
            continue
        distance, sure = probe.at_rest(kept_apart, pair), certain.issuperset(pair)
        if sure and distance < least:
            raise GtauError(
                f"{_named(pair)} are {distance:.3g} m apart at rest, less than limits.clearance of {least:g} m; give "
                f"them smaller shapes ({STATE}), or another 'rest'."
            )
        if sure or probe.changes(kept_apart, pair):
            (overlapping if distance < least else pairs).append(pair)
    notes = [words, how]
    if overlapping:
        named = "; ".join(map(_named, overlapping))
        notes.append(f"not checked, as guessed shapes overlap at rest: {named}; state {STATE}")
    if model.robot.tool not in stated and pairs:
        notes.append(f"tool, payload and cables have no shape; add them to '{model.robot.tool}' under {STATE}")
    return replace(kept_apart, pairs=tuple(pairs)) if pairs else None, tuple(notes)


@dataclass(frozen=True, eq=False)
class _Probe:
    """Distances of shapes at ``rest`` (n_c, 1), and whether they change among random poses."""

    model: InverseDynamics
    rest: np.ndarray
    least: float

    @cached_property
    def moving(self) -> np.ndarray:
        return random_motion(self.model, STATES, np.random.default_rng(0)).c

    def clearance(self, shapes: Shapes, height: float | None) -> Clearance:
        floor = {} if height is None else {FLOOR: [Floor(height)]}
        return clearance(self.model.layout, self.least, {**shapes, **floor})

    def at_rest(self, kept_apart: Clearance, pair: Pair) -> float:
        return float(kept_apart.nearest(self.rest, pair).distance[0])

    def changes(self, kept_apart: Clearance, pair: Pair) -> bool:
        return bool(np.ptp(kept_apart.nearest(self.moving, pair).distance) > SAME)


def speed_of_tool(robot: Robot, stated: float | None) -> tuple[float, str]:
    """Choose the largest speed of the tool's frame, m/s, and say why."""
    if stated is not None:
        return stated, f"tool: at most {stated:g} m/s, as stated"
    name = robot.name.lower()
    allowed = next((speed for word, speed in MAKERS.items() if word in name), None)
    why = f"which the maker of '{robot.name}' allows" if allowed else "the usual setting of arms beside people"
    fastest = allowed or TOOL_SPEED
    return fastest, f"tool: at most {fastest:g} m/s, {why}; state limits.tool_speed"


def _named(pair: Pair) -> str:
    return " and ".join(body if body == FLOOR else f"'{body}'" for body in pair)


def _guesses(robot: Robot, stated: Shapes, file: Path) -> tuple[dict[str, list[Capsule]], str]:
    """Guess shapes of bodies without a stated shape, and say how."""
    urdf = file.suffix.lower() == ".urdf" and file.is_file()
    in_file, ends, missing = _shapes_of(file) if urdf else ({}, {}, {})
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
    shaped = [body for body in bodies if body in drawn or body in lines]
    shapes = {body: [*drawn.get(body, ()), *lines.get(body, ())] for body in shaped}
    return shapes, f"self-collision: bodies are capsules, {', '.join(sources)}{meshes}; state {STATE}"


def _shapes_of(path: Path) -> tuple[dict[str, list[Blob]], dict[str, list[np.ndarray]], dict[str, int]]:
    """Read the collision shapes of a URDF, origins of links fixed to each body, and counts of meshes not read."""
    tree = read_urdf_tree(path, {}, Base())
    shapes: dict[str, list[Blob]] = {}
    ends: dict[str, list[np.ndarray]] = {}
    missing: dict[str, int] = {}
    for link in tree.root.findall("link"):
        at = tree.frames.get(link.get("name", ""))
        if at is None:
            continue
        ends.setdefault(at.body, []).append(at.placement.position)
        for collision in link.findall("collision"):
            if (geometry := collision.find("geometry")) is None:
                continue
            blob = next(filter(None, (_blob(shape, path) for shape in geometry)), None)
            if blob is None:
                missing[at.body] = missing.get(at.body, 0) + 1
                continue
            placement = at.at(origin_of(collision.find("origin"), "a collision shape")[0]).placement
            points = blob[0] @ placement.rotation.T + placement.position
            shapes.setdefault(at.body, []).append((np.asarray(points), blob[1]))
    return shapes, ends, missing


def _blob(shape: Element, path: Path) -> Blob | None:
    """Turn a box, sphere, cylinder, capsule or mesh into points and a radius; None for a missing mesh."""

    def number(key: str, count: int = 1) -> list[float]:
        return numbers(shape.get(key, ""), count, f"{key} of a {shape.tag} in <collision>")

    if shape.tag == "box":
        return np.array([*product((-0.5, 0.5), repeat=3)]) * number("size", 3), 0.0
    if shape.tag == "sphere":
        return np.zeros((1, 3)), number("radius")[0]
    if shape.tag in ("cylinder", "capsule"):
        return np.array([[0.0, 0.0, -0.5], [0.0, 0.0, 0.5]]) * number("length"), number("radius")[0]
    if shape.tag != "mesh":
        return None
    scale = numbers(shape.get("scale", "1 1 1"), 3, "scale of a mesh")
    for file in _places(shape.get("filename", ""), path):
        if file.is_file() and (points := _mesh_points(file)) is not None:
            return points * scale, 0.0
    return None


def _places(name: str, path: Path) -> Iterator[Path]:
    """List possible places of a mesh file: below the folders that contain the robot's file."""
    scheme, _, rest = name.rpartition("://")
    inside = rest.partition("/")[2]
    if scheme == "package":
        yield from (folder / part for folder in path.resolve().parents for part in (rest, inside))
    elif scheme in ("", "file"):
        yield path.parent / rest


def _mesh_points(path: Path) -> np.ndarray | None:
    """Read the corners (K, 3) of an STL or OBJ mesh; None for other formats or an empty mesh."""
    content = read_at_most(LARGEST_MESH, path, f"{path}: the mesh is larger than 64 MiB; give a simpler one.")
    if path.suffix.lower() == ".stl" and len(content) == 84 + RECORD.itemsize * int.from_bytes(
        content[80:84], "little"
    ):
        points = np.frombuffer(content[84:], RECORD)["corners"].reshape(-1, 3).astype(float)
    elif path.suffix.lower() in (".stl", ".obj"):
        words = (line.split() for line in content.decode("latin-1").splitlines())
        try:
            points = np.array([[*map(float, line[1:4])] for line in words if line and line[0] in ("v", "vertex")])
        except ValueError:
            raise GtauError(f"{path} is not a valid mesh: a corner is not three numbers; correct it.") from None
    else:
        return None
    return np.unique(points, axis=0) if points.ndim == 2 and len(points) and np.isfinite(points).all() else None


def _around(points: np.ndarray, radius: float) -> Capsule:
    inner = bounding_capsule(points)
    return replace(inner, radius=inner.radius + radius)


def _links(robot: Robot, ends: Mapping[str, Sequence[np.ndarray]]) -> dict[str, list[Capsule]]:
    """Guess capsules from the origin of every body to its followers, as thick as robot arms of that length."""
    far, before = {GROUND: 0.0}, {GROUND: GROUND}
    for joint in robot.joints:
        far[joint.name] = far[joint.antecedent] + float(np.linalg.norm(joint.placement.position))
        before[joint.name] = joint.antecedent
    thick, radii, capsules = SLENDER * max(far.values()), {GROUND: 0.0}, {}
    for body in far:
        paths = [_path(joint) for joint in robot.joints if joint.antecedent == body]
        if not paths and body != GROUND:
            paths = [[np.zeros(3), end] for end in ends.get(body, ())] or [[np.zeros(3)] * 2]
        length = max((float(np.linalg.norm(path[-1])) for path in paths), default=0.0)
        radii[body] = min(thick, STUBBY * length) if length > 1e-6 else radii[before[body]] or thick
        if radii[body] > 0.0:
            capsules[body] = [Capsule(start, end, radii[body]) for path in paths for start, end in pairwise(path)]
    return capsules


def _path(joint: Joint) -> list[np.ndarray]:
    """Lead from a body's origin to the next joint, across its axis and then along it, like arms with offsets."""
    end, direction = joint.placement.position, joint.placement.rotation @ np.array(joint.axis)
    corner = end - (end @ direction) * direction
    inner = [corner] if min(np.linalg.norm(corner), np.linalg.norm(end - corner)) > 1e-6 else []
    return [np.zeros(3), *inner, end]


def _floor(probe: _Probe, shapes: Shapes, floor: float | str | None) -> tuple[float | None, str]:
    """Choose the height of the floor (None without a floor), and say why."""
    state = "state 'limits: {floor: HEIGHT}' (m, along z of the base)"
    if isinstance(floor, str):
        return None, "floor: not checked, as 'limits: {floor: none}' says"
    if floor is not None:
        return floor, f"floor: {floor:zg} m along z of the base, as stated"
    above = probe.clearance(shapes, 0.0)
    pairs = [pair for pair in above.pairs if FLOOR in pair and probe.changes(above, pair)]
    if not pairs:
        return None, f"floor: none guessed, as no body that moves up or down has a shape; {state}"
    lowest = min(probe.at_rest(above, pair) for pair in pairs)
    origins = (above.poses(body, probe.rest)[1] for body in shapes if body not in FIXED)
    if min(float(origin[2, 0]) for origin in origins) < -1e-6:
        return None, f"floor: none guessed, as the resting arm reaches below z = 0 of the base; {state}"
    height = min(0.0, lowest - ROOM * probe.least)
    gravity = probe.model.robot.gravity
    down = gravity[2] < -0.99 * float(np.linalg.norm(gravity)) < 0
    plane = "" if down else ", the plane of its mounting: the position of the real floor is unknown"
    lower = " (the resting arm is closer to z = 0 than the clearance)" if height < 0 else ""
    return height, f"floor: guessed at z = {height:z.3g} m of the base{plane}{lower}; {state}"


def _above(probe: _Probe, shapes: Shapes, stated: Shapes, height: float) -> tuple[Shapes, str]:
    """Keep bodies without a shape off a stated floor as lines, and make guessed shapes that rest in it thinner."""
    robot, least = probe.model.robot, probe.least
    bare = [body for body in robot.bodies if body not in shapes]
    origin = np.zeros(3)
    lines = {body: [Capsule(origin, end, 0.0) for end in places_on(robot, body) or [origin]] for body in bare}
    lifted: dict[str, Sequence[Shape]] = {**shapes, **lines}
    thin, above = list[str](), probe.clearance(lifted, height)
    for pair in (pair for pair in above.pairs if FLOOR in pair and not {*pair} & {*stated}):
        distance = probe.at_rest(above, pair)
        if distance >= least or not probe.changes(above, pair):
            continue
        body, lack = pair[1], ROOM * least - distance
        # all guesses are capsules
        capsules = [shape for shape in lifted[body] if isinstance(shape, Capsule)]
        lifted[body] = [replace(shape, radius=max(shape.radius - lack, 0.0)) for shape in capsules]
        distance = probe.at_rest(probe.clearance({body: lifted[body]}, height), pair)
        if distance < least:
            raise GtauError(
                f"the line from joint to joint of '{body}' is {distance:.3g} m above the floor at rest (limits.floor: "
                f"{height:g}), less than limits.clearance of {least:g} m; correct floor or 'rest', or state {STATE}."
            )
        thin.append(f"'{body}'")
    quoted = some_of([f"'{body}'" for body in bare], 3)
    without = f"; lines from joint to joint without thickness stand for {quoted}" if bare else ""
    return lifted, without + (f"; {some_of(thin, 3)} taken thinner than guessed, to rest above it" if thin else "")
