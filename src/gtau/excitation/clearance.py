"""Distances between bodies that must not touch, by coal, and their slopes by the configuration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, product
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from gtau.errors import GtauError, missing_extra
from gtau.model.interpreter.program import Program, compile_program
from gtau.model.kinematics import Coordinates, frames
from gtau.robots.robot import GROUND, Pose, Robot

Shape = tuple[Any, np.ndarray, np.ndarray]
"""A convex shape of coal, and its orientation (3, 3) and position (3,) in the body's frame."""


@dataclass(frozen=True, eq=False)
class Nearest:
    """Of two bodies and N samples: signed ``distance`` (N,), m, negative where they overlap, along ``normal`` (3, N).

    ``a`` and ``b`` (3, N) are the nearest points, in the frames of the bodies; the normal, in the base, points from the
    first body to the second.
    """

    distance: np.ndarray
    normal: np.ndarray
    a: np.ndarray
    b: np.ndarray


@dataclass(frozen=True, eq=False)
class Clearance:
    """Bodies that keep a distance of ``least`` m from each other; see :func:`clearance`."""

    layout: Coordinates
    least: float
    shapes: Mapping[str, Sequence[Shape]]
    pairs: tuple[tuple[str, str], ...]

    def nearest(self, c: np.ndarray, pair: tuple[str, str]) -> Nearest:
        """Find the nearest points of a pair of bodies at configurations (n_c, N)."""
        import coal

        samples = c.shape[1]
        first, second = (self._poses(body, c) for body in pair)
        best = np.full(samples, np.inf)
        normal, a, b = (np.zeros((3, samples)) for _ in range(3))
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        for (one, R_1, p_1), (other, R_2, p_2) in product(self.shapes[pair[0]], self.shapes[pair[1]]):
            for k in range(samples):
                (R_a, p_a), (R_b, p_b) = ((each[0][:, :, k], each[1][:, k]) for each in (first, second))
                result.clear()
                distance = coal.distance(
                    one, coal.Transform3s(R_a @ R_1, p_a + R_a @ p_1),
                    other, coal.Transform3s(R_b @ R_2, p_b + R_b @ p_2), request, result,
                )  # fmt: skip
                if distance < best[k]:
                    best[k], normal[:, k] = distance, result.normal
                    a[:, k] = R_a.T @ (result.getNearestPoint1() - p_a)
                    b[:, k] = R_b.T @ (result.getNearestPoint2() - p_b)
        return Nearest(best, normal, a, b)

    def holds(self, c: np.ndarray) -> bool:
        """Decide whether all bodies keep their distance at configurations (n_c, N)."""
        return all(self.nearest(c, pair).distance.min(initial=np.inf) >= self.least for pair in self.pairs)

    def slopes(self, c: np.ndarray, pair: tuple[str, str], nearest: Nearest) -> np.ndarray:
        """Compute the slopes (n_c, N) of the distance by c: the nearest points move with their bodies."""
        total = np.zeros_like(c)
        for body, point, sign in zip(pair, (nearest.a, nearest.b), (-1.0, 1.0), strict=True):
            if body != GROUND:
                total += self._programs[body][1](np.vstack([c, point, sign * nearest.normal]))
        return total

    def _poses(self, body: str, c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute the orientations (3, 3, N) and positions (3, N) of a body in the base."""
        if body == GROUND:
            return np.repeat(np.eye(3)[:, :, None], c.shape[1], axis=2), np.zeros((3, c.shape[1]))
        values = self._programs[body][0](c)
        return values[:9].reshape(3, 3, -1).transpose(1, 0, 2), values[9:]

    @cached_property
    def _programs(self) -> dict[str, tuple[Program, Program]]:
        """Pose of each body by c, orientation by columns first, and slopes by c of a point's weighted coordinates."""
        c, point, weights = ca.SX.sym("c", self.layout.n_c), ca.SX.sym("point", 3), ca.SX.sym("weights", 3)
        found = {}
        for body, frame in frames(self.layout, c).items():
            if body in self.shapes and body != GROUND:
                pose = ca.vertcat(ca.densify(frame.R_0)[:], ca.densify(frame.p_0))
                slope = ca.gradient(ca.dot(weights, frame.p_0 + frame.R_0 @ point), c)
                found[body] = compile_program([c], [pose]), compile_program([c, point, weights], [ca.densify(slope)])
        return found


def clearance(layout: Coordinates, least: float, shapes: Mapping[str, Sequence[Shape]]) -> Clearance:
    """Build the clearance of the bodies with shapes, for pairs that no joint or closure joins.

    Raises
    ------
    GtauError
        There is no such body.
    """
    robot = layout.robot
    known = (GROUND, *robot.bodies)
    for body in shapes:
        if body not in known:
            raise GtauError(f"limits.shapes names '{body}', which is no body; choose from {', '.join(known)}.")
    joined = _joined(robot)
    pairs = tuple(pair for pair in combinations(shapes, 2) if frozenset(pair) not in joined)
    return Clearance(layout, least, shapes, pairs)


def _joined(robot: Robot) -> set[frozenset[str]]:
    joints = {frozenset((joint.name, joint.antecedent)) for joint in robot.joints}
    return joints | {frozenset((closure.a.body, closure.b.body)) for closure in robot.closures}


def capsule(start: Sequence[float], end: Sequence[float], radius: float) -> Shape:
    """Build a cylinder with round ends about the line between two points, or a sphere where they coincide."""
    coal = _coal()
    line, middle = np.subtract(end, start), np.add(end, start) / 2
    length = float(np.linalg.norm(line))
    if length == 0.0:
        return coal.Sphere(radius), np.eye(3), middle
    z = line / length
    x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
    x /= np.linalg.norm(x)
    return coal.Capsule(radius, length), np.column_stack([x, np.cross(z, x), z]), middle


def hull(path: Path, scale: float, pose: Pose) -> Shape:
    """Build the convex hull of a mesh; raises GtauError where its file cannot be read."""
    coal = _coal()
    if not path.is_file():
        raise GtauError(f"there is no mesh '{path}'; correct the path under limits.shapes.")
    try:
        mesh = coal.MeshLoader().load(str(path), np.full(3, scale))
        mesh.buildConvexHull(False, "Qt")
    except (ValueError, RuntimeError) as error:
        raise GtauError(f"{path} cannot be read as a mesh ({str(error).splitlines()[0]}); correct it.") from None
    return mesh.convex, pose.rotation, pose.position


def _coal() -> Any:
    try:
        import coal
    except ImportError:
        raise missing_extra("a clearance between bodies", "coal", "collision") from None
    return coal
