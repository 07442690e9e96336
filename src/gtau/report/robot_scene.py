"""Lay out a robot at home as points and lines on a page."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, radians, sin

import numpy as np

from gtau.model.home import close_home
from gtau.model.kinematics import coordinates, poses
from gtau.robots.geometry import Frame, attached
from gtau.robots.robot import GROUND, Attachment, Joint, Robot

COILS = 8  # turns of a spring
FLAT = 0.05  # a robot thinner than this share of its size is looked at from the front


@dataclass(frozen=True, eq=False)
class Scene:
    """A robot whose gravity points down the page, in m.

    ``view`` (2, 3) projects onto the page, ``found`` are the frames of all bodies, ``joints`` those that are drawn,
    ``lines`` bodies with a line (2, 3) of their link, ``rails`` (2, 3) the travel of prismatic joints, ``feet`` (3,)
    where joints stand on the base, and ``low`` and ``high`` (2,) the corners of the drawing.
    """

    robot: Robot
    upright: np.ndarray
    view: np.ndarray
    found: dict[str, Frame]
    joints: list[Joint]
    lines: list[tuple[str, np.ndarray]]
    rails: list[np.ndarray]
    feet: list[np.ndarray]
    low: np.ndarray
    high: np.ndarray

    @property
    def size(self) -> float:
        """The larger side of the drawing."""
        return float((self.high - self.low).max()) or 1.0

    @property
    def springs(self) -> list[np.ndarray]:
        """Springs between two points, as zigzags on the page, (points, 2) each."""
        ends = [[self.view @ attached(end, self.found)[1] for end in (each.a, each.b)] for each in self.robot.springs]
        return [zigzag(start, end, 0.025 * self.size) for start, end in ends]

    @property
    def closings(self) -> list[np.ndarray]:
        """Where loops are closed, (2,) each."""
        return [self.view @ attached(closure.a, self.found)[1] for closure in self.robot.closures]


def scene_of(robot: Robot) -> Scene:
    """Lay out a robot at home; raises GtauError where its loops close nowhere."""
    robot = close_home(robot)
    upright = upright_rotation(np.array(robot.gravity))
    layout = coordinates(robot)
    found = {name: (upright @ R, upright @ p) for name, (R, p) in poses(layout, layout.home).items()}
    shafts = {joint.name for joint in robot.joints if joint.parameters == "drive" and joint.antecedent == GROUND}
    joints = [joint for joint in robot.joints if joint.name not in shafts.union(robot.base)]
    lines = link_lines(robot, joints, found)
    rails = [rail_of(joint, found) for joint in joints if joint.kind == "prismatic"]
    feet = [foot_of(joint, found) for joint in joints if joint.antecedent == GROUND]
    ends = [attached(end, found)[1] for end in robot.ends]
    points = np.vstack([*(line for _, line in lines), *rails, *feet, *ends, *(frame[1] for frame in found.values())])
    view = view_plane(np.ptp(points, axis=0))
    corners = points @ view.T
    return Scene(
        robot, upright, view, found, joints, lines, rails, feet, corners.min(axis=0), corners.max(axis=0)
    )  # fmt: skip


def upright_rotation(gravity: np.ndarray) -> np.ndarray:
    """Compute the rotation (3, 3) after which gravity points along -z, with x where it was if that can be."""
    size = np.linalg.norm(gravity)
    up = -gravity / size if size else np.array([0.0, 0.0, 1.0])
    x = np.array([1.0, 0.0, 0.0]) if abs(up[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    x = x - (x @ up) * up
    x /= np.linalg.norm(x)
    return np.array([x, np.cross(up, x), up])


def view_plane(extent: np.ndarray) -> np.ndarray:
    """Choose the plane of the page, to the right and up, (2, 3), for a robot of that extent (3,)."""
    elevation, azimuth = 24.0, -58.0
    thin = int(np.argmin(extent))
    if extent[thin] < FLAT * extent.max():
        elevation, azimuth = ((18.0, -20.0), (18.0, -72.0), (62.0, -72.0))[thin]
    e, a = radians(elevation), radians(azimuth)
    return np.array([[-sin(a), cos(a), 0.0], [-cos(a) * sin(e), -sin(a) * sin(e), cos(e)]])


def link_lines(robot: Robot, joints: list[Joint], found: dict[str, Frame]) -> list[tuple[str, np.ndarray]]:
    """List bodies and lines (2, 3) from every joint to what its link carries."""
    lines = []
    for joint in joints:
        foot = foot_of(joint, found)
        if joint.antecedent != GROUND:
            lines.append((joint.antecedent, np.array([found[joint.antecedent][1], foot])))
        if joint.kind == "prismatic":
            lines.append((joint.name, np.array([foot, found[joint.name][1]])))
    platforms = {platform.name for platform in robot.platforms}
    for end in robot.ends:
        if end.body not in platforms | {GROUND}:
            lines.append((end.body, np.array([found[end.body][1], attached(end, found)[1]])))
    return [(body, line) for body, line in lines if np.linalg.norm(line[1] - line[0]) > 1e-6]


def zigzag(start: np.ndarray, end: np.ndarray, width: float) -> np.ndarray:
    """Draw a line (points, 2) between two points (2,) that looks like a coil, straight at both ends."""
    along = end - start
    length = max(float(np.linalg.norm(along)), 1e-12)
    across = width / length * np.array([-along[1], along[0]])
    shares = np.concatenate([[0.0, 0.2], np.linspace(0.25, 0.75, COILS), [0.8, 1.0]])
    sides = np.concatenate([[0.0, 0.0], (-1.0) ** np.arange(COILS), [0.0, 0.0]])
    return np.asarray(start + shares[:, None] * along + sides[:, None] * across)


def foot_of(joint: Joint, found: dict[str, Frame]) -> np.ndarray:
    """Locate where a joint stands on the link before it, (3,)."""
    R, p = found[joint.antecedent]
    foot: np.ndarray = p + R @ joint.placement.position
    return foot


def rail_of(joint: Joint, found: dict[str, Frame]) -> np.ndarray:
    """Return the path of a prismatic joint within its limits, (2, 3)."""
    R, p = found[joint.name]
    low, high = joint.limits.position or (joint.home, joint.home)
    return np.array([p + (end - joint.home) * (R @ np.array(joint.axis)) for end in (low, high)])


def platform_attachments(robot: Robot) -> list[Attachment]:
    """Locate where platforms are held."""
    platforms = {platform.name for platform in robot.platforms}
    return [end for closure in robot.closures for end in (closure.a, closure.b) if end.body in platforms]
