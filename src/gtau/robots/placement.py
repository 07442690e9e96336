"""Placements of frames, and the digits that a file writes their numbers with: angles cut short stand for exact ones."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from decimal import Decimal
from math import atan2, cos, floor, log10, pi, sin
from typing import NamedTuple

import numpy as np

from gtau.documents.validation import some_of

ROUNDING = 1e-10  # exporters write pi/2 as 1.57079632679 and zero as 2.8e-17

NEARLY = 1e-6  # rad: angles in single precision
SHORT = 2e-3  # rad: 3.14 stands for pi
MEANT = 1e-3  # rad: 0.79 or 0.26 need not stand for a multiple of pi/12
STEP = pi / 12  # of angles that may be written short

PRINTED = 5  # least significant digits that programs write; %g writes 6
COMPUTED = 14  # least significant digits of computed numbers; 1 of 1,000 has fewer
FEWEST = 3  # least decimals of rounded numbers, m or rad

DEGREES_ADVICE = "write deg(...) where these are degrees"


def _rotation(axis: int, angle: float) -> np.ndarray:
    """Compute the rotation (3, 3) about x, y or z: axis 0, 1 or 2."""
    (second, third), R = ((axis + 1) % 3, (axis + 2) % 3), np.eye(3)
    R[second, second] = R[third, third] = cos(angle)
    R[third, second] = sin(angle)
    R[second, third] = -R[third, second]
    return R


@dataclass(frozen=True)
class Mdh:
    """Khalil-Kleinfinger placement ``Rot(z,gamma) Trans(z,b) Rot(x,alpha) Trans(x,d) Rot(z,theta) Trans(z,r)``.

    Angles in rad, lengths in m. In a joint, ``theta`` (revolute) or ``r`` (prismatic) is the
    constant that the joint coordinate is added to.
    """

    gamma: float = 0.0
    b: float = 0.0
    alpha: float = 0.0
    d: float = 0.0
    theta: float = 0.0
    r: float = 0.0

    @property
    def rotation(self) -> np.ndarray:
        """Orientation of the placed frame, (3, 3)."""
        return _rotation(2, self.gamma) @ _rotation(0, self.alpha) @ _rotation(2, self.theta)

    @property
    def position(self) -> np.ndarray:
        """Origin of the placed frame, (3,) in m."""
        before = _rotation(2, self.gamma) @ _rotation(0, self.alpha)
        return np.array([0.0, 0.0, self.b]) + before @ np.array([self.d, 0.0, self.r])


@dataclass(frozen=True)
class Pose:
    """Placement by a translation (m), then fixed-axis roll, pitch and yaw (rad), as in URDF."""

    xyz: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def rotation(self) -> np.ndarray:
        """Orientation of the placed frame, (3, 3)."""
        roll, pitch, yaw = self.rpy
        return _rotation(2, yaw) @ _rotation(1, pitch) @ _rotation(0, roll)

    @property
    def position(self) -> np.ndarray:
        """Origin of the placed frame, (3,) in m."""
        return np.array(self.xyz)


Placement = Mdh | Pose

WRENCH = ("moment_x", "moment_y", "moment_z", "force_x", "force_y", "force_z")
"""Components of a wrench, N m and N."""


class WrenchFrame(NamedTuple):
    """Frame of a wrench: the body on which it acts, and whether axes and origin are the world's or the body's."""

    body: str
    in_world: bool = False


def compose(first: Placement, second: Placement) -> Pose:
    """Express the pose `second`, given in the frame `first`, in the frame where `first` is given."""
    if first == Pose() and isinstance(second, Pose):
        return second
    return pose_of(first.rotation @ second.rotation, first.position + first.rotation @ second.position)


def pose_of(rotation: np.ndarray, position: np.ndarray) -> Pose:
    """Make the pose of an orientation (3, 3) and a position (3,)."""
    return rounded_pose(position, angles_of(rotation))


def rounded_pose(xyz: Iterable[float], rpy: Iterable[float]) -> Pose:
    """Make a pose in which lengths below 1e-10 m, and angles as close to a multiple of pi/2, are exact."""
    roll, pitch, yaw = (rounded(angle, pi / 2) for angle in rpy)
    x, y, z = map(rounded, xyz)
    return Pose((x, y, z), (roll, pitch, yaw))


def rounded(number: float, unit: float = 1.0) -> float:
    """Round a number that equals a multiple of `unit` within rounding errors."""
    multiple = round(number / unit) * unit
    return multiple if abs(number - multiple) < ROUNDING else float(number)


def angles_of(rotation: np.ndarray) -> tuple[float, float, float]:
    """Compute roll, pitch and yaw, rad, of an orientation (3, 3)."""
    # Whatever the yaw where the angles are degenerate, the remainder then gives matching pitch and roll.
    yaw = atan2(rotation[1, 0], rotation[0, 0])
    c, s = cos(yaw), sin(yaw)
    pitch = atan2(-rotation[2, 0], c * rotation[0, 0] + s * rotation[1, 0])
    roll = atan2(s * rotation[0, 2] - c * rotation[1, 2], c * rotation[1, 1] - s * rotation[0, 1])
    return roll, pitch, yaw


def within_a_turn(angle: np.ndarray) -> np.ndarray:
    """Take full turns off angles: from -pi to pi, rad."""
    return np.remainder(angle + np.pi, 2 * np.pi) - np.pi


def turn(axis: np.ndarray, angle: float) -> np.ndarray:
    """Compute the rotation (3, 3) by `angle` about the unit vector `axis` (3,) (Rodrigues)."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + sin(angle) * K + (1.0 - cos(angle)) * (K @ K)


def euler_angles(rotation: np.ndarray) -> np.ndarray:
    """Compute the intrinsic angles (3,) about x, y and z of a rotation (3, 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(rotation).as_euler("XYZ"))


def in_degrees(angle: float) -> bool:
    """Decide whether an angle, rad, was meant in degrees: more than a turn, and a multiple of five."""
    return abs(angle) > 2 * pi and abs(angle - 5 * round(angle / 5)) < 1e-9


def exact_angle(angle: float) -> float:
    """Return the multiple of pi/12 (15 degrees) that an angle in a file stands for, or the angle itself.

    It stands for a multiple if it is within 1e-6, or if it is the multiple rounded or truncated to the digits written:
    at least two decimals for multiples of pi/2, three for others. Calibrated angles differ by more.
    """
    steps = round(angle / STEP)
    off, unit = abs(steps * STEP) - abs(angle), smallest_unit([angle])
    cut = -unit / 2 <= off < unit and (abs(off) < SHORT if steps % 6 == 0 else unit <= MEANT)
    return steps * STEP if abs(off) < NEARLY or cut else float(angle)


def exact_placement(placement: Placement) -> tuple[Placement, float]:
    """Replace rounded angles of a placement by the exact ones, and return the largest change, rad."""
    if isinstance(placement, Mdh):
        given: tuple[float, ...] = (placement.gamma, placement.alpha, placement.theta)
        gamma, alpha, theta = map(exact_angle, given)
        return replace(placement, gamma=gamma, alpha=alpha, theta=theta), largest_change(given, (gamma, alpha, theta))
    angles = tuple(map(exact_angle, placement.rpy))
    return rounded_pose(placement.xyz, angles), largest_change(placement.rpy, angles)


def largest_change(given: Iterable[float], exact: Iterable[float]) -> float:
    """Return the largest difference of angles, zero if within double-precision rounding."""
    change = max((abs(a - b) for a, b in zip(given, exact, strict=True)), default=0.0)
    return change if change > ROUNDING else 0.0


def short_angles_note(changes: Mapping[str, float]) -> tuple[str, ...]:
    """Note where rounded angles were replaced, with the largest change, rad; no note without changes."""
    if not (names := [f"'{name}'" for name, change in changes.items() if change]):
        return ()
    return (
        "rounded angles, such as 1.5708, were taken as the multiples of 15 degrees that they stand for, changed by up "
        f"to {max(changes.values()):.2g} rad: {some_of(names, 6)}",
    )


def smallest_unit(numbers: Iterable[float]) -> float:
    """Return the unit of the last digit of the longest number, without trailing zeros."""
    exponents = [int(Decimal(repr(float(number))).as_tuple().exponent) for number in numbers if number]
    return 10.0 ** min(exponents, default=0)


def _digits(number: float) -> tuple[int, int]:
    _, digits, exponent = Decimal(repr(float(number))).normalize().as_tuple()
    return len(digits), int(exponent)


def is_written(number: float) -> bool:
    """Return whether a number has as few digits as numbers written by hand."""
    return _digits(number)[0] < COMPUTED


@dataclass(frozen=True)
class Digits:
    """The digits of the longest number in a file."""

    decimals: int
    significant: int  # where they limit the precision
    turn: float = 0.0  # rad, where a reader computes placements

    def half_unit(self, number: float) -> float:
        """Return half a unit of the last digit of a number, 0 if the digits are unknown."""
        if not self.significant:
            return 0.0
        last = -self.decimals
        if number and self.significant >= PRINTED:
            last = max(last, floor(log10(abs(number))) + 1 - self.significant)
        return 0.5 * 10.0**last


def digits_of(numbers: Iterable[float]) -> Digits:
    """Find the digits of written numbers; computed numbers, and short ones such as 0.25, which are exact, show none."""
    digits = [_digits(number) for number in numbers if number != round(number) and is_written(number)]
    significant, exponents = zip(*digits, strict=True) if digits else ((0,), (0,))
    return Digits(-min(exponents), max(significant)) if -min(exponents) >= FEWEST else Digits(0, 0)
