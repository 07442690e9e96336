"""Compose poses and frames, restore angles written short, and find legs of identical geometry."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from decimal import Decimal
from math import atan2, cos, pi, sin

import numpy as np

from gtau.documents.validation import some_of
from gtau.robots.robot import GROUND, Attachment, Closure, Mdh, Placement, Pose, Robot, Spring

ROUNDING = 1e-10  # exporters write pi/2 as 1.57079632679 and zero as 2.8e-17

NEARLY = 1e-6  # rad: angles in single precision
SHORT = 2e-3  # rad: 3.14 stands for pi
MEANT = 1e-3  # rad: with fewer decimals, 0.79 or 0.26 need not stand for a multiple of pi/12

SAME = 9  # decimals that two legs share, of lengths in m and of directions

DEGREES_ADVICE = "write deg(...) where these are degrees"

Frame = tuple[np.ndarray, np.ndarray]
"""Orientation (3, 3) and origin (3,) in m, in base axes."""


def rounded(number: float, unit: float = 1.0) -> float:
    """Round a number that equals a multiple of `unit` up to rounding."""
    multiple = round(number / unit) * unit
    return multiple if abs(number - multiple) < ROUNDING else float(number)


def rounded_pose(xyz: Iterable[float], rpy: Iterable[float]) -> Pose:
    """Make lengths below 1e-10 m, and angles as near to a multiple of pi/2, exact in a pose."""
    roll, pitch, yaw = (rounded(angle, pi / 2) for angle in rpy)
    x, y, z = (rounded(length) for length in xyz)
    return Pose((x, y, z), (roll, pitch, yaw))


def angles_of(rotation: np.ndarray) -> tuple[float, float, float]:
    """Compute roll, pitch and yaw, rad, of an orientation (3, 3)."""
    # Whatever the yaw where the angles are degenerate, the remainder then gives matching pitch and roll.
    yaw = atan2(rotation[1, 0], rotation[0, 0])
    c, s = cos(yaw), sin(yaw)
    pitch = atan2(-rotation[2, 0], c * rotation[0, 0] + s * rotation[1, 0])
    roll = atan2(s * rotation[0, 2] - c * rotation[1, 2], c * rotation[1, 1] - s * rotation[0, 1])
    return roll, pitch, yaw


def pose_of(rotation: np.ndarray, position: np.ndarray) -> Pose:
    """Make the pose of an orientation (3, 3) and a position (3,)."""
    return rounded_pose(position, angles_of(rotation))


def in_degrees(angle: float) -> bool:
    """Decide whether an angle, rad, was meant in degrees: more than a turn, and a multiple of five."""
    return abs(angle) > 2 * pi and abs(angle - 5 * round(angle / 5)) < 1e-9


def exact_angle(angle: float) -> float:
    """Return the multiple of pi/12 (15 degrees) that an angle in a file stands for, or the angle itself.

    Files give pi/2 with fewer digits (1.5708, 1.571, 1.57) or in single precision, pi/4 as 0.7854. An angle is taken
    for a multiple if it is within 1e-6 of it, or if it is that multiple rounded or cut off to its digits: two decimals
    for multiples of pi/2, three for the others. A calibrated angle differs by more.
    """
    multiple = round(angle / (pi / 12)) * (pi / 12)
    off, unit = abs(multiple) - abs(angle), smallest_unit([angle])
    quarter = round(angle / (pi / 12)) % 6 == 0
    cut = -unit / 2 <= off < unit and (abs(off) < SHORT if quarter else unit <= MEANT)
    return multiple if abs(off) < NEARLY or cut else float(angle)


def smallest_unit(numbers: Iterable[float]) -> float:
    """Return the unit of the last digit that the longest of numbers is written with, zeros not counted."""
    exponents = [int(Decimal(repr(float(number))).as_tuple().exponent) for number in numbers if number]
    return 10.0 ** min(exponents, default=0)


def exact_rotation(rotation: np.ndarray) -> np.ndarray:
    """Compute the rotation (3, 3) by the multiples of pi/12 that are nearest to roll, pitch and yaw of another."""
    return Pose(rpy=tuple(round(angle / (pi / 12)) * (pi / 12) for angle in angles_of(rotation))).rotation  # type: ignore[arg-type]


def written_pose(xyz: Iterable[float], rpy: Iterable[float]) -> tuple[Pose, float]:
    """Return the pose that a file gives, and the largest change (rad) of an angle in it (see :func:`exact_angle`)."""
    given = tuple(rpy)
    angles = tuple(map(exact_angle, given))
    return rounded_pose(xyz, angles), largest_change(given, angles)


def largest_change(given: Iterable[float], exact: Iterable[float]) -> float:
    """Return the largest difference of angles, zero if within double-precision rounding."""
    change = max((abs(a - b) for a, b in zip(given, exact, strict=True)), default=0.0)
    return change if change > ROUNDING else 0.0


def short_angles_note(changes: Mapping[str, float]) -> tuple[str, ...]:
    """Note the places of angles written short, with the largest change, rad; no note without such angles."""
    if not (listed := [f"'{name}'" for name, change in changes.items() if change]):
        return ()
    return (
        "rounded angles, such as 1.5708, were taken as the multiples of 15 degrees that they stand for, changed by up "
        f"to {max(changes.values()):.2g} rad: {some_of(listed, 6)}",
    )


def with_exact_angles(robot: Robot) -> Robot:
    """Take the angles of placements that are written short as exact, with a note (see :func:`exact_angle`)."""
    changes: dict[str, float] = {}

    def exact(name: str, placement: Placement) -> Placement:
        if isinstance(placement, Mdh):
            given: tuple[float, ...] = (placement.gamma, placement.alpha, placement.theta)
            gamma, alpha, theta = map(exact_angle, given)
            meant: Placement = replace(placement, gamma=gamma, alpha=alpha, theta=theta)
            change = largest_change(given, (gamma, alpha, theta))
        else:
            meant, change = written_pose(placement.xyz, placement.rpy)
        changes[name] = max(change, changes.get(name, 0.0))
        return meant if change else placement

    def end(at: Attachment) -> Attachment:
        return replace(at, placement=exact(at.body, at.placement))

    joints = tuple(replace(joint, placement=exact(joint.name, joint.placement)) for joint in robot.joints)
    closures = tuple(replace(closure, a=end(closure.a), b=end(closure.b)) for closure in robot.closures)
    notes = short_angles_note(changes)
    return replace(robot, joints=joints, closures=closures).noted(*notes) if notes else robot


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


def places_on(robot: Robot, body: str) -> list[np.ndarray]:
    """List the origins (3,), m, of the frames of joints and closures on a body, in its frame."""
    joints = [joint.placement.position for joint in robot.joints if joint.antecedent == body]
    ends = (end for closure in robot.closures for end in (closure.a, closure.b))
    return joints + [end.placement.position for end in ends if end.body == body]


def extent(robot: Robot, body: str) -> tuple[np.ndarray, float, bool]:
    """Bound a body's frames by a ball: centre (3,) and radius in m, in its frame, and whether the chain ends here.

    The frames are its own and those of the joints and closures on it; where there are none the chain ends.
    """
    points = places_on(robot, body)
    frames = np.array([np.zeros(3), *points])
    centre = (frames.min(axis=0) + frames.max(axis=0)) / 2
    return centre, float(np.linalg.norm(frames - centre, axis=1).max()), not points


def longest_placement(robot: Robot) -> float:
    """Return the largest distance (m) from a body's frame to that of a joint or closure on it; 1 without any."""
    lengths = [2 * extent(robot, body)[1] for body in robot.bodies]
    return max(lengths, default=0.0) or 1.0


def moved_ends(
    robot: Robot, moved: Callable[[Attachment], Attachment]
) -> tuple[tuple[Closure, ...], tuple[Spring, ...]]:
    """Move both ends of all closures and springs."""
    closures = tuple(replace(closure, a=moved(closure.a), b=moved(closure.b)) for closure in robot.closures)
    return closures, tuple(replace(spring, a=moved(spring.a), b=moved(spring.b)) for spring in robot.springs)


def attached(end: Attachment, frames: dict[str, Frame]) -> Frame:
    """Express the frame of a closure's end in the base."""
    R, p = frames[end.body]
    return R @ end.placement.rotation, p + R @ end.placement.position


def legs(robot: Robot) -> list[tuple[str, ...]]:
    """List the joints of every chain or tree that starts at the ground, or at a base that floats, in order."""
    root: dict[str, str] = {}
    chains: dict[str, list[str]] = {}
    for joint in robot.joints:
        root[joint.name] = joint.name if joint.antecedent in (GROUND, robot.floating) else root[joint.antecedent]
        chains.setdefault(root[joint.name], []).append(joint.name)
    return [tuple(names) for names in chains.values()]


def identical_legs(robot: Robot) -> list[list[tuple[str, ...]]]:
    """Group legs by their geometry, each seen in the frame of its own first link.

    Legs are identical if their joints have the same kinds, axes, parameters and placements, and the same closures
    and springs at the same places. Mounting pose, home and limits of a leg are ignored.
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
