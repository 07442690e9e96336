"""Distances between bodies and from a floor, with gradients by the configuration.

Convex hulls of meshes need coal; capsules and the floor do not.
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
from gtau.model.kinematics import Coordinates, frames
from gtau.model.program import Program, compile_program
from gtau.robots.robot import GROUND, Pose

FLOOR = "the floor"
"""Name of the :class:`Floor` among the bodies; no body has a name with a blank."""


@dataclass(frozen=True, eq=False)
class Capsule:
    """All points within ``radius`` m of a segment between two points (3,) of the body's frame."""

    start: np.ndarray
    end: np.ndarray
    radius: float


@dataclass(frozen=True)
class Floor:
    """All points below ``height`` m along z of the base."""

    height: float


@dataclass(frozen=True, eq=False)
class Hull:
    """A convex coal shape with its orientation (3, 3) and position (3,) in the body's frame."""

    convex: Any
    rotation: np.ndarray
    position: np.ndarray


FIXED = (GROUND, FLOOR)
Shape = Capsule | Floor | Hull
Placed = tuple[str, Shape]
"""A body and its shape."""
Poses = tuple[np.ndarray, np.ndarray]
"""Orientations (3, 3, N) and positions (3, N) in the base."""


@dataclass(frozen=True, eq=False)
class Nearest:
    """Signed distance (N,), m, of two bodies, nearest points a and b, and normal from a to b (3, N), in the base."""

    distance: np.ndarray
    normal: np.ndarray
    a: np.ndarray
    b: np.ndarray


@dataclass(frozen=True, eq=False)
class Clearance:
    """Pairs of bodies to keep ``least`` m apart; see :func:`clearance`."""

    layout: Coordinates
    least: float
    shapes: Mapping[str, Sequence[Shape]]
    pairs: tuple[tuple[str, str], ...]

    def nearest(self, c: np.ndarray, pair: tuple[str, str]) -> Nearest:
        """Find the nearest points of a pair of bodies at configurations (n_c, N)."""
        return self.all_nearest(c, [pair])[0]

    def all_nearest(self, c: np.ndarray, pairs: Sequence[tuple[str, str]]) -> list[Nearest]:
        """Find the nearest points of some pairs of bodies, with one call for all capsules."""
        poses = {body: self.poses(body, c) for body in dict.fromkeys(chain(*pairs))}
        placed = {body: [(body, shape) for shape in self.shapes[body]] for body in poses}
        lines: dict[Placed, tuple[np.ndarray, np.ndarray, float]] = {
            (body, shape): (*_ends(poses[body], shape), shape.radius)
            for body, shape in chain(*placed.values())
            if isinstance(shape, Capsule)
        }
        couples_by_pair = [list(product(placed[a], placed[b])) for a, b in pairs]
        between = _between_capsules([couple for couple in chain(*couples_by_pair) if {*couple} <= lines.keys()], lines)
        nearest, samples = [], np.arange(c.shape[1])
        for pair, couples in zip(pairs, couples_by_pair, strict=True):
            first, second = (poses[body] for body in pair)
            contacts = [between.get((a, b)) or _contacts(a[1], first, b[1], second) for a, b in couples]
            distances = np.array([contact.distance for contact in contacts])
            which = np.argmin(distances, axis=0)
            normal, a, b = (
                np.array([getattr(contact, name) for contact in contacts])[which, :, samples].T
                for name in ("normal", "a", "b")
            )
            nearest.append(Nearest(distances[which, samples], normal, a, b))
        return nearest

    def holds(self, c: np.ndarray) -> bool:
        """Whether all pairs keep their distance at configurations (n_c, N)."""
        return all(near.distance.min(initial=np.inf) >= self.least for near in self.all_nearest(c, self.pairs))

    def slopes(self, c: np.ndarray, pair: tuple[str, str], nearest: Nearest) -> np.ndarray:
        """Compute the gradient (n_c, N) of the distance by c; the nearest points move with their bodies."""
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
        """Pose of every body (orientation in column order), and the gradient by c of a point's weighted coordinates."""
        c, point, weights = ca.SX.sym("c", self.layout.n_c), ca.SX.sym("point", 3), ca.SX.sym("weights", 3)
        programs = {}
        for body, frame in frames(self.layout, c).items():
            if body in self.shapes and body not in FIXED:
                pose = ca.vertcat(ca.densify(frame.R_0)[:], ca.densify(frame.p_0))
                slope = ca.gradient(ca.dot(weights, frame.p_0 + frame.R_0 @ point), c)
                programs[body] = compile_program([c], [pose]), compile_program([c, point, weights], [ca.densify(slope)])
        return programs


def clearance(layout: Coordinates, least: float, shapes: Mapping[str, Sequence[Shape]]) -> Clearance:
    """Build the clearance of bodies with shapes, for all pairs without a common joint or closure."""
    robot = layout.robot
    bodies = (GROUND, *robot.bodies)
    for body in shapes:
        if body not in (FLOOR, *bodies):
            raise GtauError(f"limits.shapes names '{body}', which is no body; choose from {', '.join(bodies)}.")
    joined = {frozenset((joint.name, joint.antecedent)) for joint in robot.joints} | {frozenset(FIXED)}
    joined |= {frozenset((closure.a.body, closure.b.body)) for closure in robot.closures}
    shaped = [body for body in (GROUND, FLOOR, *robot.bodies) if shapes.get(body)]
    pairs = tuple(pair for pair in combinations(shaped, 2) if frozenset(pair) not in joined)
    return Clearance(layout, least, shapes, pairs)


def _placed(poses: Poses, point: np.ndarray) -> np.ndarray:
    R, p = poses
    return p + np.einsum("ijn,j->in", R, point)


def _ends(poses: Poses, capsule: Capsule) -> tuple[np.ndarray, np.ndarray]:
    return _placed(poses, capsule.start), _placed(poses, capsule.end)


def _contacts(a: Shape, first: Poses, b: Shape, second: Poses) -> Nearest:
    """Compute the contacts of two shapes of which at most one is a capsule."""
    if isinstance(a, Hull) or isinstance(b, Hull):
        return _between_hulls(a, first, b, second)
    if isinstance(a, Floor):
        turned = _contacts(b, second, a, first)
        return Nearest(turned.distance, -turned.normal, turned.b, turned.a)
    assert isinstance(b, Floor)
    ends = _ends(first, a)
    lowest = np.where(ends[0][2] < ends[1][2], *ends)
    down = np.broadcast_to([[0.0], [0.0], [-1.0]], lowest.shape)
    below = np.vstack([lowest[:2], np.full((1, lowest.shape[1]), b.height)])
    return Nearest(lowest[2] - a.radius - b.height, down, lowest + a.radius * down, below)


def _between_capsules(
    pairs: Sequence[tuple[Placed, Placed]], lines: Mapping[Placed, tuple[np.ndarray, np.ndarray, float]]
) -> dict[tuple[Placed, Placed], Nearest]:
    """Compute the contacts of all pairs of capsules at once; ``lines`` are their ends (3, N) and radii."""
    if not pairs:
        return {}
    points = (np.concatenate([lines[pair[k]][end] for pair in pairs], axis=1) for k in (0, 1) for end in (0, 1))
    on_a, on_b = (point.reshape(3, len(pairs), -1).swapaxes(0, 1) for point in nearest_points(*points))
    apart = np.linalg.norm(on_b - on_a, axis=1)
    normal = (on_b - on_a) / np.maximum(apart, 1e-12)[:, None]
    return {
        pair: Nearest(gap - r - s, along, a + r * along, b - s * along)
        for pair, gap, along, a, b in zip(pairs, apart, normal, on_a, on_b, strict=True)
        for r, s in [(lines[pair[0]][2], lines[pair[1]][2])]
    }


def nearest_points(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the nearest points (3, N) of the segments from ``a`` to ``b`` and from ``c`` to ``d``, (3, N) each.

    They are the feet of the common perpendicular if both are inside, or else an end and its foot on the other segment.
    """
    along, across, between = b - a, d - c, c - a
    uu, vv, uv = np.sum(along**2, 0), np.sum(across**2, 0), np.sum(along * across, 0)
    at_u, at_v = np.sum(along * between, 0), np.sum(across * between, 0)
    determinant = uu * vv - uv**2
    crossing = determinant > 1e-12 * uu * vv
    safe = np.where(crossing, determinant, 1.0)
    one, zero = np.ones_like(uu), np.zeros_like(uu)

    def foot(numerator: np.ndarray, square: np.ndarray) -> np.ndarray:
        return np.clip(numerator / np.maximum(square, 1e-300), 0.0, 1.0)

    s, t = (vv * at_u - uv * at_v) / safe, (uv * at_u - uu * at_v) / safe
    inside = crossing & (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
    candidates = np.array([
        (np.where(inside, s, 0.0), np.where(inside, t, foot(-at_v, vv))),
        (zero, foot(-at_v, vv)),
        (one, foot(uv - at_v, vv)),
        (foot(at_u, uu), zero),
        (foot(at_u + uv, uu), one),
    ])  # fmt: skip
    on_first = a + candidates[:, 0, None] * along
    on_second = c + candidates[:, 1, None] * across
    best = np.argmin(np.sum((on_second - on_first) ** 2, axis=1), axis=0)
    samples = np.arange(len(best))
    return on_first[best, :, samples].T, on_second[best, :, samples].T


def _between_hulls(a: Shape, first: Poses, b: Shape, second: Poses) -> Nearest:
    """Compute the contacts of two shapes of which at least one is a hull, sample by sample."""
    coal = _coal()
    (shape_1, R_1, p_1), (shape_2, R_2, p_2) = _coal_shape(a), _coal_shape(b)
    samples = first[1].shape[1]
    distance, (normal, on_a, on_b) = np.empty(samples), (np.empty((3, samples)) for _ in range(3))
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    for k in range(samples):
        (R_a, p_a), (R_b, p_b) = ((R[:, :, k], p[:, k]) for R, p in (first, second))
        result.clear()
        distance[k] = coal.distance(
            shape_1, coal.Transform3s(R_a @ R_1, p_a + R_a @ p_1),
            shape_2, coal.Transform3s(R_b @ R_2, p_b + R_b @ p_2), request, result,
        )  # fmt: skip
        normal[:, k], on_a[:, k], on_b[:, k] = result.normal, result.getNearestPoint1(), result.getNearestPoint2()
    return Nearest(distance, normal, on_a, on_b)


def _coal_shape(shape: Shape) -> tuple[Any, np.ndarray, np.ndarray]:
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
    """Make a cylinder with round ends about a segment, or a sphere if its ends coincide."""
    return Capsule(np.array([*start], dtype=float), np.array([*end], dtype=float), radius)


def bounding_capsule(points: np.ndarray) -> Capsule:
    """Enclose points (K, 3) in the smallest capsule along one of their principal axes."""
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
    """Build the convex hull of a mesh; raises GtauError if its file cannot be read."""
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
