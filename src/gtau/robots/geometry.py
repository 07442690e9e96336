"""Where everything is at a configuration: poses composed, frames of all bodies, errors of the closures."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from math import atan2, cos, pi, sin

import numpy as np

from gtau.robots.robot import GROUND, ROTATIONS, TRANSLATIONS, Attachment, Placement, Pose, Robot

ROUNDING = 1e-10  # exporters write pi/2 as 1.57079632679 and zero as 2.8e-17

Frame = tuple[np.ndarray, np.ndarray]
"""Orientation (3, 3) and origin (3,) in m, in base axes."""


def rounded(number: float, unit: float = 1.0) -> float:
    """The multiple of `unit` in place of a number that only rounding keeps from it."""
    multiple = round(number / unit) * unit
    return multiple if abs(number - multiple) < ROUNDING else float(number)


def rounded_pose(xyz: Iterable[float], rpy: Iterable[float]) -> Pose:
    """A pose whose lengths below 1e-10 m, and angles as near to a multiple of pi/2, are exact."""
    roll, pitch, yaw = (rounded(angle, pi / 2) for angle in rpy)
    x, y, z = (rounded(length) for length in xyz)
    return Pose((x, y, z), (roll, pitch, yaw))


def pose_of(rotation: np.ndarray, position: np.ndarray) -> Pose:
    """The pose of an orientation (3, 3) and a position (3,)."""
    # Whatever the yaw where the angles are degenerate, what is left over then gives matching pitch and roll.
    yaw = atan2(rotation[1, 0], rotation[0, 0])
    c, s = cos(yaw), sin(yaw)
    pitch = atan2(-rotation[2, 0], c * rotation[0, 0] + s * rotation[1, 0])
    roll = atan2(s * rotation[0, 2] - c * rotation[1, 2], c * rotation[1, 1] - s * rotation[0, 1])
    return rounded_pose(position, (roll, pitch, yaw))


def compose(first: Placement, second: Placement) -> Pose:
    """The pose `second`, given in the frame `first`, in the frame where `first` is given."""
    if first == Pose() and isinstance(second, Pose):
        return second
    return pose_of(first.rotation @ second.rotation, first.position + first.rotation @ second.position)


def turn(axis: np.ndarray, angle: float) -> np.ndarray:
    """Rotation (3, 3) by `angle` about the unit vector `axis` (3,) (Rodrigues)."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + sin(angle) * K + (1.0 - cos(angle)) * (K @ K)


def euler_angles(rotation: np.ndarray) -> np.ndarray:
    """Angles (3,) about x, then the y and z that turned with it, which make a rotation (3, 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(rotation).as_euler("XYZ"))


def rotation_vector(rotation: np.ndarray) -> np.ndarray:
    """Axis times angle (3,) of a rotation (3, 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(rotation).as_rotvec())


def characteristic_length(robot: Robot) -> float:
    """Mean length (m) of the robot's placements that have one: the scale between m and rad."""
    placements = [joint.placement for joint in robot.joints]
    placements += [end.placement for closure in robot.closures for end in (closure.a, closure.b)]
    lengths = [float(np.linalg.norm(placement.position)) for placement in placements]
    lengths = [length for length in lengths if length > 1e-9]
    return float(np.mean(lengths)) if lengths else 1.0


@dataclass(frozen=True)
class Configuration:
    """Joint coordinates (joints,) in rad or m, and the pose of every platform in the base."""

    q: np.ndarray
    platforms: tuple[Frame, ...]


def home_configuration(robot: Robot) -> Configuration:
    """The configuration that the robot's `home` gives."""
    return Configuration(
        np.array([joint.home for joint in robot.joints], dtype=float),
        tuple((platform.home.rotation, platform.home.position) for platform in robot.platforms),
    )


def at_home(robot: Robot, configuration: Configuration) -> Robot:
    """The robot whose home is `configuration`."""
    return replace(
        robot,
        joints=tuple(
            replace(joint, home=float(value)) for joint, value in zip(robot.joints, configuration.q, strict=True)
        ),
        platforms=tuple(
            replace(platform, home=pose_of(*frame))
            for platform, frame in zip(robot.platforms, configuration.platforms, strict=True)
        ),
    )


def frames(robot: Robot, configuration: Configuration) -> dict[str, Frame]:
    """Frame of every body in the base."""
    found: dict[str, Frame] = {GROUND: (np.eye(3), np.zeros(3))}
    for joint, value in zip(robot.joints, configuration.q, strict=True):
        R, p = found[joint.antecedent]
        R, p = R @ joint.placement.rotation, p + R @ joint.placement.position
        axis = np.array(joint.axis)
        found[joint.name] = (R @ turn(axis, value), p) if joint.kind == "revolute" else (R, p + value * (R @ axis))
    for platform, frame in zip(robot.platforms, configuration.platforms, strict=True):
        found[platform.name] = frame
    return found


def attached(end: Attachment, found: dict[str, Frame]) -> Frame:
    """The frame of a closure's end in the base."""
    R, p = found[end.body]
    return R @ end.placement.rotation, p + R @ end.placement.position


def loop_errors(robot: Robot, configuration: Configuration, length: float) -> tuple[np.ndarray, np.ndarray]:
    """How far closures and couplings are from holding, and its derivative with respect to small motions.

    Parameters
    ----------
    robot : Robot
    configuration : Configuration
    length : float
        Unit of lengths, m: rows and columns are pure numbers, rad or lengths over `length`.

    Returns
    -------
    error : ndarray
        (rows,): three rows a `connect`, six a `weld` (position, rotation vector), one a coupling.
    jacobian : ndarray
        (rows, joints + 6 a platform); a platform moves by x, y, z, rx, ry, rz in base axes, and has zero columns
        for what is none of its degrees of freedom.
    """
    found = frames(robot, configuration)
    columns = len(robot.joints) + 6 * len(robot.platforms)
    errors, rows = [np.zeros(0)], [np.zeros((0, columns))]
    for closure in robot.closures:
        (R_a, p_a), (R_b, p_b) = attached(closure.a, found), attached(closure.b, found)
        error, J = (p_a - p_b) / length, _motion(robot, closure.a.body, p_a, found, length)
        J = J - _motion(robot, closure.b.body, p_b, found, length)
        if closure.kind == "weld":
            errors.append(np.concatenate([error, rotation_vector(R_a @ R_b.T)]))
            rows.append(J)
        else:
            errors.append(error)
            rows.append(J[:3])
    names = [joint.name for joint in robot.joints]
    units = np.array([1.0 if joint.kind == "revolute" else length for joint in robot.joints])
    for coupling in robot.couplings:
        row = np.zeros(len(names))
        row[names.index(coupling.joint)] = 1.0
        for name, ratio in coupling.ratios:
            row[names.index(name)] = -ratio
        size = np.linalg.norm(row * units)
        errors.append(np.array([(row @ configuration.q - coupling.offset) / size]))
        rows.append(np.concatenate([row * units / size, np.zeros(columns - len(names))])[None, :])
    return np.concatenate(errors), np.vstack(rows)


def _motion(robot: Robot, body: str, point: np.ndarray, found: dict[str, Frame], length: float) -> np.ndarray:
    """Velocity of a point of a body and its angular velocity, (6, columns), lengths in units of `length`."""
    J = np.zeros((6, len(robot.joints) + 6 * len(robot.platforms)))
    for k, platform in enumerate(robot.platforms):
        if platform.name == body:
            first = len(robot.joints) + 6 * k
            arm = (point - found[body][1]) / length
            J[:3, first : first + 3] = J[3:, first + 3 : first + 6] = np.eye(3)
            J[:3, first + 3 : first + 6] = np.cross(np.eye(3), arm).T
            free = [dof in platform.dof for dof in TRANSLATIONS + ROTATIONS]
            J[:, first : first + 6] *= free
    index = {joint.name: k for k, joint in enumerate(robot.joints)}
    while body in index:
        joint = robot.joints[index[body]]
        R, p = found[body]
        axis = R @ np.array(joint.axis)
        if joint.kind == "revolute":
            J[:3, index[body]], J[3:, index[body]] = np.cross(axis, (point - p) / length), axis
        else:
            J[:3, index[body]] = axis
        body = joint.antecedent
    return J
