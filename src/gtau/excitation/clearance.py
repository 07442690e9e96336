"""Distances between bodies and from a floor, and their derivatives with respect to the configuration.

Capsules and the floor need no library; convex hulls of meshes need coal.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, combinations, product
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from gtau.errors import GtauError, missing_extra
from gtau.model.interpreter.program import Program, compile_program
from gtau.model.kinematics import Coordinates, frames
from gtau.robots.robot import GROUND, Pose

FLOOR = "the floor"
"""Place of a :class:`Floor` among the bodies; no body has a name with a blank."""


@dataclass(frozen=True, eq=False)
class Capsule:
    """All points within ``radius`` m of the line between two points (3,) in the body's frame."""

    start: np.ndarray
    end: np.ndarray
    radius: float


@dataclass(frozen=True)
class Floor:
    """All points of the base's frame below ``height`` m along its z axis."""

    height: float


@dataclass(frozen=True, eq=False)
class Hull:
    """A convex shape of coal with its orientation (3, 3) and position (3,) in the body's frame."""

    convex: Any
    rotation: np.ndarray
    position: np.ndarray


FIXED = (GROUND, FLOOR)
Shape = Capsule | Floor | Hull
Placed = tuple[str, Shape]
"""A shape of a body."""
Poses = tuple[np.ndarray, np.ndarray]
"""Orientations (3, 3, N) and positions (3, N) in the base."""


@dataclass(frozen=True, eq=False)
class Nearest:
    """Signed distance (N,), m, of two bodies, nearest points and the normal from a to b (3, N), in the base."""

    distance: np.ndarray
    normal: np.ndarray
    a: np.ndarray
    b: np.ndarray


@dataclass(frozen=True, eq=False)
class Clearance:
    """Bodies with a required distance of ``least`` m; see :func:`clearance`."""

    layout: Coordinates
    least: float
    shapes: Mapping[str, Sequence[Shape]]
    pairs: tuple[tuple[str, str], ...]

    def nearest(self, c: np.ndarray, pair: tuple[str, str]) -> Nearest:
        """Find the nearest points of a pair of bodies at configurations (n_c, N)."""
        return self.all_nearest(c, [pair])[0]

    def all_nearest(self, c: np.ndarray, pairs: Sequence[tuple[str, str]]) -> list[Nearest]:
        """Find the nearest points of some pairs of bodies, all capsules in one go."""
        poses = {body: self.poses(body, c) for body in dict.fromkeys(chain(*pairs))}
        placed = {body: [(body, shape) for shape in self.shapes[body]] for body in poses}
        lines: dict[Placed, tuple[np.ndarray, np.ndarray, float]] = {
            (body, shape): (*_ends(poses[body], shape), shape.radius)
            for body, shape in chain(*placed.values())
            if isinstance(shape, Capsule)
        }
        couples = [list(product(placed[one], placed[other])) for one, other in pairs]
        between = _between_capsules([couple for couple in chain(*couples) if {*couple} <= lines.keys()], lines)
        every, samples = [], np.arange(c.shape[1])
        for pair, of_pair in zip(pairs, couples, strict=True):
            first, second = (poses[body] for body in pair)
            contacts = [between.get((a, b)) or _contacts(a[1], first, b[1], second) for a, b in of_pair]
            distances = np.array([contact.distance for contact in contacts])
            which = np.argmin(distances, axis=0)
            normal, a, b = (
                np.array([getattr(contact, name) for contact in contacts])[which, :, samples].T
                for name in ("normal", "a", "b")
            )
            every.append(Nearest(distances[which, samples], normal, a, b))
        return every

    def holds(self, c: np.ndarray) -> bool:
        """Decide whether all bodies keep their distance at configurations (n_c, N)."""
        return all(near.distance.min(initial=np.inf) >= self.least for near in self.all_nearest(c, self.pairs))

    def slopes(self, c: np.ndarray, pair: tuple[str, str], nearest: Nearest) -> np.ndarray:
        """Compute the derivatives (n_c, N) of the distance by c: the nearest points move with their bodies."""
        total = np.zeros_like(c)
        for body, point, sign in zip(pair, (nearest.a, nearest.b), (-1.0, 1.0), strict=True):
            if body not in FIXED:
                R, p = self.poses(body, c)
                on_body = np.einsum("jin,jn->in", R, point - p)
                total += self._programs[body][1](np.vstack([c, on_body, sign * nearest.normal]))
        return total

    def poses(self, body: str, c: np.ndarray) -> Poses:
        """Compute the orientations (3, 3, N) and positions (3, N) of a body in the base."""
        if body in FIXED:
            return np.repeat(np.eye(3)[:, :, None], c.shape[1], axis=2), np.zeros((3, c.shape[1]))
        values = self._programs[body][0](c)
        return values[:9].reshape(3, 3, -1).transpose(1, 0, 2), values[9:]

    @cached_property
    def _programs(self) -> dict[str, tuple[Program, Program]]:
        """Pose of each body by c, orientation by columns first, and slopes by c of a point's weighted coordinates."""
        c, point, weights = ca.SX.sym("c", self.layout.n_c), ca.SX.sym("point", 3), ca.SX.sym("weights", 3)
        programs = {}
        for body, frame in frames(self.layout, c).items():
            if body in self.shapes and body not in FIXED:
                pose = ca.vertcat(ca.densify(frame.R_0)[:], ca.densify(frame.p_0))
                slope = ca.gradient(ca.dot(weights, frame.p_0 + frame.R_0 @ point), c)
                programs[body] = compile_program([c], [pose]), compile_program([c, point, weights], [ca.densify(slope)])
        return programs


def clearance(layout: Coordinates, least: float, shapes: Mapping[str, Sequence[Shape]]) -> Clearance:
    """Build the clearance of the bodies with shapes, for pairs that no joint or closure joins."""
    robot = layout.robot
    known = (GROUND, *robot.bodies)
    for body in shapes:
        if body not in (FLOOR, *known):
            raise GtauError(f"limits.shapes names '{body}', which is no body; choose from {', '.join(known)}.")
    joined = {frozenset((joint.name, joint.antecedent)) for joint in robot.joints} | {frozenset(FIXED)}
    joined |= {frozenset((closure.a.body, closure.b.body)) for closure in robot.closures}
    order = [body for body in (GROUND, FLOOR, *robot.bodies) if shapes.get(body)]
    pairs = tuple(pair for pair in combinations(order, 2) if frozenset(pair) not in joined)
    return Clearance(layout, least, shapes, pairs)


def _placed(poses: Poses, point: np.ndarray) -> np.ndarray:
    R, p = poses
    return p + np.einsum("ijn,j->in", R, point)


def _ends(poses: Poses, capsule: Capsule) -> tuple[np.ndarray, np.ndarray]:
    return _placed(poses, capsule.start), _placed(poses, capsule.end)


def _contacts(one: Shape, first: Poses, other: Shape, second: Poses) -> Nearest:
    if isinstance(one, Hull) or isinstance(other, Hull):
        return _between_hulls(one, first, other, second)
    if isinstance(one, Floor):
        turned = _contacts(other, second, one, first)
        return Nearest(turned.distance, -turned.normal, turned.b, turned.a)
    assert isinstance(one, Capsule)
    assert isinstance(other, Floor)
    ends = _ends(first, one)
    lowest = np.where(ends[0][2] < ends[1][2], *ends)
    down = np.broadcast_to([[0.0], [0.0], [-1.0]], lowest.shape)
    below = np.vstack([lowest[:2], np.full((1, lowest.shape[1]), other.height)])
    return Nearest(lowest[2] - one.radius - other.height, down, lowest + one.radius * down, below)


def _between_capsules(
    pairs: Sequence[tuple[Placed, Placed]], lines: Mapping[Placed, tuple[np.ndarray, np.ndarray, float]]
) -> dict[tuple[Placed, Placed], Nearest]:
    """Compute the contacts of pairs of capsules side by side; ``lines`` are their ends (3, N) and radii."""
    if not pairs:
        return {}
    points = (np.concatenate([lines[pair[k]][end] for pair in pairs], axis=1) for k in (0, 1) for end in (0, 1))
    on_one, on_other = (point.reshape(3, len(pairs), -1).swapaxes(0, 1) for point in nearest_points(*points))
    apart = np.linalg.norm(on_other - on_one, axis=1)
    normal = (on_other - on_one) / np.maximum(apart, 1e-12)[:, None]
    return {
        (one, other): Nearest(gap - r - s, along, a + r * along, b - s * along)
        for (one, other), gap, along, a, b in zip(pairs, apart, normal, on_one, on_other, strict=True)
        for r, s in [(lines[one][2], lines[other][2])]
    }


def nearest_points(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the nearest points (3, N) of segments from ``a`` to ``b`` and from ``c`` to ``d``, (3, N) each.

    They are on the common perpendicular, if its feet are on both, or an end and its foot on the other segment.
    """
    along, across, between = b - a, d - c, c - a
    uu, vv, uv = np.sum(along**2, 0), np.sum(across**2, 0), np.sum(along * across, 0)
    at_u, at_v = np.sum(along * between, 0), np.sum(across * between, 0)
    determinant = uu * vv - uv**2
    crossing = determinant > 1e-12 * uu * vv
    safe = np.where(crossing, determinant, 1.0)
    one, none = np.ones_like(uu), np.zeros_like(uu)

    def foot(numerator: np.ndarray, square: np.ndarray) -> np.ndarray:
        return np.clip(numerator / np.maximum(square, 1e-300), 0.0, 1.0)

    s, t = (vv * at_u - uv * at_v) / safe, (uv * at_u - uu * at_v) / safe
    inside = crossing & (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
    candidates = np.array([
        (np.where(inside, s, 0.0), np.where(inside, t, foot(-at_v, vv))),
        (none, foot(-at_v, vv)),
        (one, foot(uv - at_v, vv)),
        (foot(at_u, uu), none),
        (foot(at_u + uv, uu), one),
    ])  # fmt: skip
    on_first = a + candidates[:, 0, None] * along
    on_second = c + candidates[:, 1, None] * across
    best = np.argmin(np.sum((on_second - on_first) ** 2, axis=1), axis=0)
    samples = np.arange(len(best))
    return on_first[best, :, samples].T, on_second[best, :, samples].T


def _between_hulls(one: Shape, first: Poses, other: Shape, second: Poses) -> Nearest:
    """Compute the contacts of two shapes of which one is a hull, sample by sample."""
    coal = _coal()
    (mine, R_1, p_1), (theirs, R_2, p_2) = _of_coal(one), _of_coal(other)
    samples = first[1].shape[1]
    distance, (normal, a, b) = np.empty(samples), (np.empty((3, samples)) for _ in range(3))
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    for k in range(samples):
        (R_a, p_a), (R_b, p_b) = ((R[:, :, k], p[:, k]) for R, p in (first, second))
        result.clear()
        distance[k] = coal.distance(
            mine, coal.Transform3s(R_a @ R_1, p_a + R_a @ p_1),
            theirs, coal.Transform3s(R_b @ R_2, p_b + R_b @ p_2), request, result,
        )  # fmt: skip
        normal[:, k], a[:, k], b[:, k] = result.normal, result.getNearestPoint1(), result.getNearestPoint2()
    return Nearest(distance, normal, a, b)


def _of_coal(shape: Shape) -> tuple[Any, np.ndarray, np.ndarray]:
    coal = _coal()
    if isinstance(shape, Hull):
        return shape.convex, shape.rotation, shape.position
    if isinstance(shape, Floor):
        return coal.Halfspace(np.array([0.0, 0.0, 1.0]), shape.height), np.eye(3), np.zeros(3)
    line, middle = shape.end - shape.start, (shape.end + shape.start) / 2
    length = float(np.linalg.norm(line))
    if length == 0.0:
        return coal.Sphere(shape.radius), np.eye(3), middle
    z = line / length
    x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
    x /= np.linalg.norm(x)
    return coal.Capsule(shape.radius, length), np.column_stack([x, np.cross(z, x), z]), middle


def capsule(start: Iterable[float], end: Iterable[float], radius: float) -> Capsule:
    """Make a cylinder with round ends about the line between two points, or a sphere where they coincide."""
    return Capsule(np.array([*start], dtype=float), np.array([*end], dtype=float), radius)


def bounding_capsule(points: np.ndarray) -> Capsule:
    """Enclose points (K, 3) in a capsule along one of their principal axes, the smallest of the three."""
    middle = (points.max(axis=0) + points.min(axis=0)) / 2
    axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    fits = [_along(points - middle, axis) for axis in axes]
    low, high, radius, axis = min(fits, key=lambda fit: (fit[1] - fit[0] + 4 / 3 * fit[2]) * fit[2] ** 2)
    return Capsule(middle + low * axis, middle + high * axis, radius)


def _along(points: np.ndarray, axis: np.ndarray) -> tuple[float, float, float, np.ndarray]:
    heights = points @ axis
    sideways = np.linalg.norm(points - np.outer(heights, axis), axis=1)
    radius = float(sideways.max())
    cap = np.sqrt(np.maximum(radius**2 - sideways**2, 0.0))
    low, high = float((heights + cap).min()), float((heights - cap).max())
    middle = (low + high) / 2
    return min(low, middle), max(high, middle), radius, axis


def hull(path: Path, scale: float, pose: Pose) -> Hull:
    """Build the convex hull of a mesh; raises GtauError where its file cannot be read."""
    coal = _coal()
    if not path.is_file():
        raise GtauError(f"there is no mesh '{path}'; correct the path under limits.shapes.")
    try:
        mesh = coal.MeshLoader().load(str(path), np.full(3, scale))
        mesh.buildConvexHull(False, "Qt")
    except (ValueError, RuntimeError) as error:
        raise GtauError(f"{path} cannot be read as a mesh ({str(error).splitlines()[0]}); correct it.") from None
    return Hull(mesh.convex, pose.rotation, pose.position)


def _coal() -> Any:
    try:
        import coal
    except ImportError:
        raise missing_extra("the convex hull of a mesh", "coal", "collision") from None
    return coal
