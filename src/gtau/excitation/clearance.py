"""Distances between bodies and from a floor, with gradients by the configuration.

Convex hulls of meshes need coal; capsules and the floor do not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, combinations, product
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from scipy.spatial.transform import Rotation

from gtau.errors import GtauError, needing
from gtau.model.kinematics import Coordinates, frames
from gtau.model.program import Program, compile_program
from gtau.robots.robot import GROUND, Pose

FLOOR = "the floor"
"""Name of the :class:`Floor` among the bodies; no body has a name with a blank."""
FIXED = (GROUND, FLOOR)
Pair = tuple[str, str]
Poses = tuple[np.ndarray, np.ndarray]
"""Orientations (3, 3, N) and positions (3, N) in the base."""


@dataclass(frozen=True, eq=False)
class Capsule:
    """All points within ``radius`` m of a segment: ends (3,) in the frame of the body, or (3, N) in the base."""

    start: np.ndarray
    end: np.ndarray
    radius: float

    def placed(self, poses: Poses) -> Capsule:
        """Place the capsule in the base, with its body."""
        R, p = poses
        start, end = (p + np.einsum("ijn,j->in", R, point) for point in (self.start, self.end))
        return Capsule(start, end, self.radius)


@dataclass(frozen=True)
class Floor:
    """All points below ``height`` m along z of the base."""

    height: float

    def placed(self, _: Poses) -> Floor:
        """Return the floor, which has no body."""
        return self


@dataclass(frozen=True, eq=False)
class Hull:
    """A convex coal shape with orientation (3, 3) and position (3,) in the body's frame, or with :data:`Poses`."""

    convex: Any
    rotation: np.ndarray
    position: np.ndarray

    def placed(self, poses: Poses) -> Hull:
        """Place the hull in the base, with its body."""
        R, p = poses
        rotation = np.einsum("ijn,jk->ikn", R, self.rotation)
        return Hull(self.convex, rotation, p + np.einsum("ijn,j->in", R, self.position))


Shape = Capsule | Floor | Hull


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
    pairs: tuple[Pair, ...]

    def nearest(self, c: np.ndarray, pair: Pair) -> Nearest:
        """Find the nearest points of a pair of bodies at configurations (n_c, N)."""
        return self.all_nearest(c, [pair])[0]

    def all_nearest(self, c: np.ndarray, pairs: Sequence[Pair]) -> list[Nearest]:
        """Find the nearest points of some pairs of bodies, with one call for all capsules."""
        poses = {body: self.poses(body, c) for body in dict.fromkeys(chain(*pairs))}
        placed = {body: [shape.placed(poses[body]) for shape in self.shapes[body]] for body in poses}
        couples = [list(product(placed[first], placed[second])) for first, second in pairs]
        capsules = [(a, b) for a, b in chain(*couples) if isinstance(a, Capsule) and isinstance(b, Capsule)]
        between: dict[tuple[Shape, Shape], Nearest] = dict(zip(capsules, _between_capsules(capsules), strict=True))
        nearest, samples = [], np.arange(c.shape[1])
        for of_pair in couples:
            contacts = [between.get(couple) or _contacts(*couple) for couple in of_pair]
            distances = np.array([contact.distance for contact in contacts])
            which = np.argmin(distances, axis=0)
            vectors = np.array([(contact.normal, contact.a, contact.b) for contact in contacts])
            normal, a, b = vectors[which, :, :, samples].transpose(1, 2, 0)
            nearest.append(Nearest(distances[which, samples], normal, a, b))
        return nearest

    def slopes(self, c: np.ndarray, pair: Pair, nearest: Nearest) -> np.ndarray:
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
        c = ca.SX.sym("c", self.layout.n_c)
        point = ca.SX.sym("point", 3)
        weights = ca.SX.sym("weights", 3)
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
    if wrong := next((body for body in shapes if body not in (FLOOR, *bodies)), None):
        raise GtauError(f"limits.shapes names '{wrong}', which is no body; choose from {', '.join(bodies)}.")
    joined = [{joint.name, joint.antecedent} for joint in robot.joints] + [{*FIXED}]
    joined += [{closure.a.body, closure.b.body} for closure in robot.closures]
    shaped = [body for body in (GROUND, FLOOR, *robot.bodies) if shapes.get(body)]
    pairs = tuple(pair for pair in combinations(shaped, 2) if {*pair} not in joined)
    return Clearance(layout, least, shapes, pairs)


def _contacts(a: Shape, b: Shape) -> Nearest:
    """Compute the contacts of two placed shapes of which at most one is a capsule."""
    if isinstance(a, Hull) or isinstance(b, Hull):
        return _between_hulls(a, b)
    if isinstance(a, Floor):
        turned = _contacts(b, a)
        return Nearest(turned.distance, -turned.normal, turned.b, turned.a)
    assert isinstance(b, Floor)
    lowest = np.where(a.start[2] < a.end[2], a.start, a.end)
    down = np.broadcast_to([[0.0], [0.0], [-1.0]], lowest.shape)
    below = np.vstack([lowest[:2], np.full((1, lowest.shape[1]), b.height)])
    return Nearest(lowest[2] - a.radius - b.height, down, lowest + a.radius * down, below)


def _between_capsules(couples: Sequence[tuple[Capsule, Capsule]]) -> list[Nearest]:
    """Compute the contacts of all couples of placed capsules at once."""
    if not couples:
        return []
    ends = zip(*((a.start, a.end, b.start, b.end) for a, b in couples), strict=True)
    points = nearest_points(*(np.concatenate(end, axis=1) for end in ends))
    on_a, on_b = (point.reshape(3, len(couples), -1).swapaxes(0, 1) for point in points)
    apart = np.linalg.norm(on_b - on_a, axis=1)
    normals = (on_b - on_a) / np.maximum(apart, 1e-12)[:, None]
    return [
        Nearest(gap - a.radius - b.radius, normal, p + a.radius * normal, q - b.radius * normal)
        for (a, b), gap, normal, p, q in zip(couples, apart, normals, on_a, on_b, strict=True)
    ]


def nearest_points(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the nearest points (3, N) of the segments from ``a`` to ``b`` and from ``c`` to ``d``, (3, N) each.

    The point of the first line nearest to the second line, moved to its segment, leads to the point of the second
    segment, and this one back to the first segment.
    """
    u, v, w = b - a, d - c, c - a
    uu, vv, uv, uw, vw = (np.sum(x * y, axis=0) for x, y in ((u, u), (v, v), (u, v), (u, w), (v, w)))
    determinant = uu * vv - uv**2
    crossing = determinant > 1e-12 * uu * vv
    s = np.where(crossing, (vv * uw - uv * vw) / np.where(crossing, determinant, 1.0), 0.0)
    t = np.clip((uv * np.clip(s, 0.0, 1.0) - vw) / np.maximum(vv, 1e-300), 0.0, 1.0)
    s = np.clip((uv * t + uw) / np.maximum(uu, 1e-300), 0.0, 1.0)
    return a + s * u, c + t * v


def _between_hulls(a: Shape, b: Shape) -> Nearest:
    """Compute the contacts of two placed shapes of which at least one is a hull, sample by sample."""
    coal = _coal()
    samples = next(shape.position.shape[1] for shape in (a, b) if isinstance(shape, Hull))
    distance, (normal, on_a, on_b) = np.empty(samples), (np.empty((3, samples)) for _ in range(3))
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    for k in range(samples):
        result.clear()
        distance[k] = coal.distance(*_coal_shape(a, k), *_coal_shape(b, k), request, result)
        normal[:, k], on_a[:, k], on_b[:, k] = result.normal, result.getNearestPoint1(), result.getNearestPoint2()
    return Nearest(distance, normal, on_a, on_b)


def _coal_shape(shape: Shape, k: int) -> tuple[Any, Any]:
    """Return coal's shape and transform of a placed shape at a sample."""
    coal = _coal()
    if isinstance(shape, Hull):
        return shape.convex, coal.Transform3s(shape.rotation[:, :, k], shape.position[:, k])
    if isinstance(shape, Floor):
        return coal.Halfspace(np.array([0.0, 0.0, 1.0]), shape.height), coal.Transform3s()
    start, end = shape.start[:, k], shape.end[:, k]
    length = float(np.linalg.norm(end - start))
    if length == 0.0:
        return coal.Sphere(shape.radius), coal.Transform3s(np.eye(3), start)
    turn, _ = Rotation.align_vectors((end - start)[None], [[0.0, 0.0, 1.0]])
    return coal.Capsule(shape.radius, length), coal.Transform3s(turn.as_matrix(), (start + end) / 2)


def bounding_capsule(points: np.ndarray) -> Capsule:
    """Enclose points (K, 3) in the smallest capsule along one of their principal axes."""
    middle = (points.max(axis=0) + points.min(axis=0)) / 2
    axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    fits = [_along(points, middle, axis) for axis in axes]
    return min(fits, key=lambda fit: (np.linalg.norm(fit.end - fit.start) + 4 / 3 * fit.radius) * fit.radius**2)


def _along(points: np.ndarray, middle: np.ndarray, axis: np.ndarray) -> Capsule:
    """Enclose points (K, 3) in the smallest capsule along an ``axis`` (3,) through ``middle`` (3,)."""
    heights = (points - middle) @ axis
    sideways = np.linalg.norm(points - middle - np.outer(heights, axis), axis=1)
    radius = float(sideways.max())
    cap = np.sqrt(np.maximum(radius**2 - sideways**2, 0.0))
    low, high = (heights + cap).min(), (heights - cap).max()
    if low > high:
        low = high = (low + high) / 2
    return Capsule(middle + low * axis, middle + high * axis, radius)


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
    with needing("the convex hull of a mesh", "coal", "collision"):
        import coal
    return coal
