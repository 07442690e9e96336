"""Robots made by hand that several tests share, no two alike, under a gravity that no axis hides."""

from __future__ import annotations

from math import asin, atan2, cos, hypot, pi, sin

import numpy as np

from gtau.model.home import load_robot
from gtau.robots.robot import Attachment, Closure, Joint, Mdh, Platform, Pose, Robot

OBLIQUE = (1.2, -3.4, -8.9)
TILTED = (0.4, -0.7, 0.3)  # roll, pitch, yaw of a plane that is no base plane


def seven_r() -> Robot:
    """A serial arm: five Khalil-Kleinfinger joints, two with skew axes, as a URDF file has them."""
    return Robot(
        "seven-r",
        (
            Joint("1", "ground", "revolute", Mdh(gamma=0.3, b=0.2, alpha=0.1, r=0.3)),
            Joint("2", "1", "revolute", Mdh(alpha=-pi / 2, d=0.1, theta=0.3)),
            Joint("3", "2", "revolute", Pose((0.1, -0.2, 0.3), (0.4, -0.8, 1.1)), (0.6, 0.0, 0.8)),
            Joint("4", "3", "revolute", Mdh(alpha=pi / 2, d=-0.3, r=0.05)),
            Joint("5", "4", "revolute", Mdh(gamma=-0.4, b=0.1, alpha=0.8, d=0.25, theta=-1.0, r=0.15)),
            Joint("6", "5", "revolute", Pose((0.0, 0.2, 0.1), (-0.3, 0.2, 0.9)), (0.0, -1.0, 0.0)),
            Joint("7", "6", "revolute", Mdh(alpha=-pi / 2, r=0.12)),
        ),
        gravity=OBLIQUE,
    )


def tree() -> Robot:
    """Two trunks, one with two branches; slides along z, along -x and along a skew axis."""
    return Robot(
        "tree",
        (
            Joint("a", "ground", "prismatic", Mdh(gamma=0.3, b=0.1, alpha=0.7, d=0.2, theta=-0.4, r=0.5)),
            Joint("b", "a", "revolute", Mdh(alpha=-pi / 2, d=0.3, theta=0.2)),
            Joint("c", "b", "prismatic", Pose((0.1, -0.2, 0.3), (0.4, -0.8, 1.1)), (0.6, 0.0, 0.8)),
            Joint("d", "a", "revolute", Pose((0.0, 0.4, 0.1), (-0.3, 0.2, 0.9)), (0.0, 0.8, -0.6)),
            Joint("e", "d", "prismatic", Pose((0.2, 0.0, -0.1), (0.5, 0.2, -0.9)), (-1.0, 0.0, 0.0)),
            Joint("f", "ground", "revolute", Mdh(alpha=0.4, d=-0.6)),
            Joint("g", "c", "revolute", Mdh(alpha=0.9, r=0.2)),
        ),
        gravity=OBLIQUE,
    )


def triangle(a: float, b: float, c: float) -> float:
    """Angle between the sides ``a`` and ``b``, opposite ``c``."""
    return float(np.arccos((a * a + b * b - c * c) / (2 * a * b)))


def four_bar(
    crank: float = 0.3, coupler: float = 0.7, rocker: float = 0.5, base: float = 0.6, home: float = pi / 2
) -> Robot:
    """Crank 1, coupler 2 and rocker 3 in a tilted plane, rocker to the right of the diagonal."""
    diagonal = complex(base - crank * cos(home), -crank * sin(home))  # from the crank's tip to the rocker's foot
    at_tip = float(np.angle(diagonal)) + triangle(coupler, abs(diagonal), rocker)
    at_foot = float(np.angle(-diagonal)) - triangle(rocker, abs(diagonal), coupler)
    foot = Pose(tuple(Pose(rpy=TILTED).rotation @ np.array([base, 0.0, 0.1])), TILTED)
    return Robot(
        "four-bar",
        (
            Joint("1", "ground", "revolute", Pose(rpy=TILTED), home=home),
            Joint("2", "1", "revolute", Mdh(d=crank, r=0.1), actuated=False, home=at_tip - home),
            Joint("3", "ground", "revolute", foot, actuated=False, home=at_foot),
        ),
        closures=(Closure("connect", Attachment("2", Pose((coupler, 0, 0))), Attachment("3", Pose((rocker, 0, 0)))),),
        gravity=OBLIQUE,
    )


def slider_crank(crank: float = 0.2, rod: float = 0.5) -> Robot:
    """Crank 1 and rod 2 drive the passive slider 3 along (0.6, 0.8, 0), which the rod's end meets by a weld's hinge."""
    home, along = 0.4, atan2(0.8, 0.6)
    lean = asin(crank * sin(home - along) / rod)  # of the rod from the slider's line
    reach = crank * cos(home - along) + rod * cos(lean)
    return Robot(
        "slider-crank",
        (
            Joint("1", "ground", "revolute", Pose(rpy=TILTED), home=home),
            Joint("2", "1", "revolute", Mdh(d=crank), actuated=False, home=along - lean - home),
            Joint("3", "ground", "prismatic", Pose(rpy=TILTED), (0.6, 0.8, 0.0), actuated=False, home=reach),
            Joint("4", "3", "revolute", Pose(), actuated=False, home=along - lean),
        ),
        closures=(Closure("weld", Attachment("2", Pose((rod, 0, 0))), Attachment("4")),),
        gravity=OBLIQUE,
    )


def palletizer() -> Robot:
    """A loop that rides on a turret and carries a wrist: joints 0, 1 and 4 are driven, 2 and 3 follow."""
    loop = four_bar()
    before = {"ground": "0", "1": "1", "2": "2", "3": "3"}
    riding = tuple(
        Joint(each.name, before[each.antecedent], each.kind, each.placement, each.axis, each.actuated, each.home)
        for each in loop.joints
    )
    turret = Joint("0", "ground", "revolute", Mdh(b=0.4, alpha=0.2, d=0.1))
    wrist = Joint("4", "2", "revolute", Pose((0.8, 0.1, 0.0), (1.0, 0.5, 0.2)), (0.0, 0.6, 0.8), home=0.3)
    return Robot("palletizer", (turret, *riding, wrist), closures=loop.closures, gravity=OBLIQUE)


def planar_3rrr() -> Robot:
    """Three planar legs, each welded through a third revolute to a platform with x, y and rz."""
    joints, closures = [], []
    for leg in range(3):
        angle = 2 * pi * leg / 3
        foot, corner = 0.8 * np.exp(1j * angle), 0.2 * np.exp(1j * (angle - 0.4))
        reach = corner - foot
        bend = triangle(0.45, abs(reach), 0.4)
        knee = pi - triangle(0.45, 0.4, abs(reach))
        first = float(np.angle(reach)) - bend
        joints += [
            Joint(f"1{leg}", "ground", "revolute", Pose((foot.real, foot.imag, 0.1 * leg)), home=first),
            Joint(f"2{leg}", f"1{leg}", "revolute", Mdh(d=0.45), actuated=False, home=knee),
            Joint(f"3{leg}", f"2{leg}", "revolute", Mdh(d=0.4), actuated=False, home=-first - knee),
        ]
        closures.append(
            Closure("weld", Attachment(f"3{leg}"), Attachment("P", Pose((corner.real, corner.imag, 0.1 * leg))))
        )
    return Robot("3-RRR", tuple(joints), (Platform("P", ("x", "y", "rz")),), tuple(closures), gravity=OBLIQUE)


def tripteron() -> Robot:
    """Three slides along the base axes, each with three parallel revolutes, welded to a platform with x, y and z."""
    joints, closures = [], []
    turns = [(0.0, 0.0, 0.0), (pi / 2, 0.0, pi / 2), (-pi / 2, -pi / 2, 0.0)]  # cyclic exchanges of the axes
    for leg, rpy in enumerate(turns, start=1):
        first, second = 0.5, -1.3
        joints += [
            Joint(f"{leg}1", "ground", "prismatic", Pose(rpy=rpy)),
            Joint(f"{leg}2", f"{leg}1", "revolute", actuated=False, home=first),
            Joint(f"{leg}3", f"{leg}2", "revolute", Mdh(d=0.4), actuated=False, home=second),
            Joint(f"{leg}4", f"{leg}3", "revolute", Mdh(d=0.3), actuated=False, home=-first - second),
        ]
        reach = np.array(
            [0.4 * cos(first) + 0.3 * cos(first + second), 0.4 * sin(first) + 0.3 * sin(first + second), 0]
        )
        arm = tuple(Pose(rpy=rpy).rotation @ reach)
        closures.append(Closure("weld", Attachment(f"{leg}4"), Attachment("P", Pose(arm, rpy))))
    return Robot("tripteron", tuple(joints), (Platform("P", ("x", "y", "z")),), tuple(closures), gravity=OBLIQUE)


def hexapod() -> Robot:
    """Six legs of a universal joint and a driven slide along x, a tilted platform with all six freedoms."""
    joints, closures = [], []
    home = Pose((0.05, -0.03, 0.9), (0.1, -0.15, 0.2))
    for leg in range(6):
        low = 2 * pi * (leg // 2) / 3 + (0.2 if leg % 2 else -0.2)
        high = 2 * pi * (leg // 2) / 3 + (0.8 if leg % 2 else -0.8)
        foot, corner = np.array([cos(low), sin(low), 0.0]), 0.6 * np.array([cos(high), sin(high), 0.1])
        x, y, z = home.position + home.rotation @ corner - foot
        joints += [
            Joint(f"1{leg}", "ground", "revolute", Pose(tuple(foot)), (0, 0, 1.0), False, atan2(y, x)),
            Joint(f"2{leg}", f"1{leg}", "revolute", Pose(), (0, -1.0, 0), False, atan2(z, hypot(x, y))),
            Joint(f"3{leg}", f"2{leg}", "prismatic", axis=(1.0, 0, 0), home=float(np.linalg.norm([x, y, z]))),
        ]
        closures.append(Closure("connect", Attachment(f"3{leg}"), Attachment("P", Pose(tuple(corner)))))
    platform = Platform("P", ("x", "y", "z", "rx", "ry", "rz"), home)
    return Robot("hexapod", tuple(joints), (platform,), tuple(closures), gravity=OBLIQUE)


def two_platforms() -> Robot:
    """A four-bar about z whose coupler is a platform A, and a platform B of six freedoms welded to A."""
    loop = four_bar()
    home, tip_to_coupler, rocker = (joint.home for joint in loop.joints)
    angle = home + tip_to_coupler
    grip = Pose((0.2, 0.3, -0.1), (0.7, -0.2, 0.4))
    A = Pose((0.3 * cos(home), 0.3 * sin(home), 0.0), (0.0, 0.0, angle))
    x, y, z = A.position + A.rotation @ grip.position
    return Robot(
        "two platforms",
        (
            Joint("1", "ground", "revolute", home=home),
            Joint("2", "ground", "revolute", Pose((0.6, 0, 0)), actuated=False, home=rocker),
        ),
        (
            Platform("A", ("x", "y", "rz"), A),
            Platform("B", ("x", "y", "z", "rx", "ry", "rz"), Pose((x, y, z), (0.7, -0.2, 0.4 + angle))),
        ),
        (
            Closure("connect", Attachment("1", Pose((0.3, 0, 0))), Attachment("A")),
            Closure("connect", Attachment("A", Pose((0.7, 0, 0))), Attachment("2", Pose((0.5, 0, 0)))),
            Closure("weld", Attachment("B"), Attachment("A", grip)),
        ),
        gravity=OBLIQUE,
    )


SERIAL = (seven_r(), tree(), load_robot("ur10e"))
CLOSED = (
    four_bar(),
    slider_crank(),
    palletizer(),
    planar_3rrr(),
    tripteron(),
    hexapod(),
    two_platforms(),
    load_robot("five-bar"),
    load_robot("orthoglide"),
)
ROBOTS = SERIAL + CLOSED


def home(robot: Robot) -> np.ndarray:
    """Home of the actuated joints, (n,)."""
    return np.array([joint.home for joint in robot.joints if joint.actuated])


def random_samples(robot: Robot, rng: np.random.Generator, samples: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions about home (anywhere, without closures), velocities and accelerations, each (samples, n)."""
    span = 0.06 if robot.closures else 2.0
    q = home(robot) + span * rng.uniform(-1, 1, (samples, len(robot.actuated)))
    qd, qdd = rng.normal(size=(2, *q.shape))
    return q, qd, 3.0 * qdd


def trajectory(robot: Robot, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, velocity and acceleration along a smooth path around home, each (N, n)."""
    k = np.arange(len(robot.actuated))
    span, rate, phase = (0.06 if robot.closures else 1.0), 1.0 + 0.3 * k, 0.7 * k
    angle = times[:, None] * rate + phase
    q = home(robot) + span * np.sin(angle)
    return q, span * rate * np.cos(angle), -span * rate**2 * np.sin(angle)
