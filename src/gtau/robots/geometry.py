"""Compose poses and frames, read angles written short, and find legs of the same geometry."""

from __future__ import annotations

from collections.abc import Iterable
from math import atan2, cos, pi, sin

import numpy as np

from gtau.robots.robot import GROUND, Attachment, Placement, Pose, Robot

ROUNDING = 1e-10  # exporters write pi/2 as 1.57079632679 and zero as 2.8e-17

NEARLY = 1e-6  # rad: angles in single precision
SHORT = 2e-3  # rad: 3.14 stands for pi

SAME = 9  # decimals that two legs share, of lengths in m and of directions

Frame = tuple[np.ndarray, np.ndarray]
"""Orientation (3, 3) and origin (3,) in m, in base axes."""


def rounded(number: float, unit: float = 1.0) -> float:
    """Round a number that only rounding keeps from a multiple of `unit`."""
    multiple = round(number / unit) * unit
    return multiple if abs(number - multiple) < ROUNDING else float(number)


def rounded_pose(xyz: Iterable[float], rpy: Iterable[float]) -> Pose:
    """Make lengths below 1e-10 m, and angles as near to a multiple of pi/2, exact in a pose."""
    roll, pitch, yaw = (rounded(angle, pi / 2) for angle in rpy)
    x, y, z = (rounded(length) for length in xyz)
    return Pose((x, y, z), (roll, pitch, yaw))


def angles_of(rotation: np.ndarray) -> tuple[float, float, float]:
    """Compute roll, pitch and yaw, rad, of an orientation (3, 3)."""
    # Whatever the yaw where the angles are degenerate, what is left over then gives matching pitch and roll.
    yaw = atan2(rotation[1, 0], rotation[0, 0])
    c, s = cos(yaw), sin(yaw)
    pitch = atan2(-rotation[2, 0], c * rotation[0, 0] + s * rotation[1, 0])
    roll = atan2(s * rotation[0, 2] - c * rotation[1, 2], c * rotation[1, 1] - s * rotation[0, 1])
    return roll, pitch, yaw


def pose_of(rotation: np.ndarray, position: np.ndarray) -> Pose:
    """Make the pose of an orientation (3, 3) and a position (3,)."""
    return rounded_pose(position, angles_of(rotation))


def exact_angle(angle: float) -> float:
    """Return the multiple of pi/2 that an angle in a file stands for, or the angle itself.

    Files give pi/2 with fewer digits (1.5708, 1.571, 1.57) or in single precision. An angle is taken for a multiple if
    it is within 1e-6 of it, or one in the last of its digits and 2e-3 rad: a calibrated angle differs by more.
    """
    multiple = round(angle / (pi / 2)) * (pi / 2)
    digits = repr(float(angle)).partition(".")[2]
    unit = 0.0 if "e" in digits else min(10.0 ** -len(digits), SHORT)
    return multiple if abs(angle - multiple) < max(NEARLY, unit) else float(angle)


def written_pose(xyz: Iterable[float], rpy: Iterable[float]) -> tuple[Pose, bool]:
    """Return the pose that a file gives, and whether an angle in it was written short (see :func:`exact_angle`)."""
    given = tuple(rpy)
    angles = tuple(map(exact_angle, given))
    short = any(abs(angle - exact) > ROUNDING for angle, exact in zip(given, angles, strict=True))
    return rounded_pose(xyz, angles), short


def short_angles_note(names: Iterable[str]) -> tuple[str, ...]:
    """Note the joints whose angles a file writes short; none where there are no such."""
    if not (listed := list(names)):
        return ()
    shown = ", ".join(f"'{name}'" for name in listed[:6]) + (f" and {len(listed) - 6} more" if len(listed) > 6 else "")
    return (f"rounded angles, such as 1.5708, were taken as multiples of pi/2: joint {shown}",)


def compose(first: Placement, second: Placement) -> Pose:
    """Express the pose `second`, given in the frame `first`, in the frame where `first` is given."""
    if first == Pose() and isinstance(second, Pose):
        return second
    return pose_of(first.rotation @ second.rotation, first.position + first.rotation @ second.position)


def turn(axis: np.ndarray, angle: float) -> np.ndarray:
    """Compute the rotation (3, 3) by `angle` about the unit vector `axis` (3,) (Rodrigues)."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + sin(angle) * K + (1.0 - cos(angle)) * (K @ K)


def euler_angles(rotation: np.ndarray) -> np.ndarray:
    """Compute the angles (3,) about x, then the y and z that turned with it, which make a rotation (3, 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(rotation).as_euler("XYZ"))


def characteristic_length(robot: Robot) -> float:
    """Compute the mean length (m) of the robot's placements that have one: the scale between m and rad."""
    placements = [joint.placement for joint in robot.joints]
    placements += [end.placement for closure in robot.closures for end in (closure.a, closure.b)]
    lengths = [float(np.linalg.norm(placement.position)) for placement in placements]
    lengths = [length for length in lengths if length > 1e-9]
    return float(np.mean(lengths)) if lengths else 1.0


def extent(robot: Robot, body: str) -> tuple[np.ndarray, float, bool]:
    """Bound a body's frames by a ball: centre (3,) and radius in m, in its frame, and whether the chain ends here.

    The frames are its own and those of the joints and closures on it; where there are none the chain ends.
    """
    points = [joint.placement.position for joint in robot.joints if joint.antecedent == body]
    points += [end.placement.position for each in robot.closures for end in (each.a, each.b) if end.body == body]
    frames = np.array([np.zeros(3), *points])
    centre = (frames.min(axis=0) + frames.max(axis=0)) / 2
    return centre, float(np.linalg.norm(frames - centre, axis=1).max()), not points


def longest_placement(robot: Robot) -> float:
    """Return the largest distance (m) from a body's frame to that of a joint or closure on it; 1 without any."""
    lengths = [2 * extent(robot, body)[1] for body in robot.bodies]
    return max(lengths, default=0.0) or 1.0


def attached(end: Attachment, found: dict[str, Frame]) -> Frame:
    """Express the frame of a closure's end in the base."""
    R, p = found[end.body]
    return R @ end.placement.rotation, p + R @ end.placement.position


def legs(robot: Robot) -> list[tuple[str, ...]]:
    """List the joints of every chain or tree that starts at the ground, or at a base that floats, in order."""
    root: dict[str, str] = {}
    found: dict[str, list[str]] = {}
    for joint in robot.joints:
        root[joint.name] = joint.name if joint.antecedent in (GROUND, robot.floating) else root[joint.antecedent]
        found.setdefault(root[joint.name], []).append(joint.name)
    return [tuple(names) for names in found.values()]


def identical_legs(robot: Robot) -> list[list[tuple[str, ...]]]:
    """Group legs by their geometry, each seen in the frame of its own first link.

    Legs are alike whose joints have the same kinds, axes, parameters and placements, and are tied by the same closures
    and springs at the same places. Where a leg stands, its home and its limits do not count.
    """
    groups: dict[tuple, list[tuple[str, ...]]] = {}
    for leg in legs(robot):
        joints = [robot.joint(name) for name in leg]
        tree = tuple(
            (
                joint.kind,
                joint.actuated,
                joint.parameters,
                joint.spring,
                _numbers(np.array(joint.axis)),
                leg.index(joint.antecedent) if k else -1,
                _placement(joint.placement) if k else (),
            )
            for k, joint in enumerate(joints)
        )
        ends = ((closure.kind, end) for closure in robot.closures for end in (closure.a, closure.b) if end.body in leg)
        tied = sorted((kind, leg.index(end.body), _placement(end.placement)) for kind, end in ends)
        coupled = sorted(
            (name == coupling.joint, leg.index(name), ratio)
            for coupling in robot.couplings
            for name, ratio in ((coupling.joint, 1.0), *coupling.ratios)
            if name in leg
        )
        sprung = sorted(
            (spring.parameters, leg.index(end.body), _placement(end.placement))
            for spring in robot.springs
            for end in (spring.a, spring.b)
            if end.body in leg
        )
        groups.setdefault((tree, tuple(tied), tuple(coupled), tuple(sprung)), []).append(leg)
    return list(groups.values())


def _placement(placement: Placement) -> tuple[float, ...]:
    return _numbers(placement.rotation) + _numbers(placement.position)


def _numbers(array: np.ndarray) -> tuple[float, ...]:
    return tuple((np.round(array, SAME) + 0.0).ravel().tolist())
