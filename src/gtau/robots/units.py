"""SI units of parameters and torques, and detection of angles in degrees."""

from __future__ import annotations

from math import pi

from gtau.robots.robot import DAMPING, PRELOAD, STIFFNESS, Robot

DEGREES_ADVICE = "write deg(...) where these are degrees"


def in_degrees(angle: float) -> bool:
    """Decide whether an angle, rad, was meant in degrees: more than a turn, and a multiple of five."""
    return abs(angle) > 2 * pi and abs(angle - 5 * round(angle / 5)) < 1e-9


def unit_of(kind: str, robot: Robot, joint: str) -> str:
    """Return the SI unit of a parameter of ``kind`` at a joint, a platform or a spring."""
    if any(spring.name == joint for spring in robot.springs):
        return {PRELOAD: "N", STIFFNESS: "N/m", DAMPING: "N s/m"}[kind]
    if kind in ("xx", "xy", "xz", "yy", "yz", "zz"):
        return "kg m2"
    if kind in ("mx", "my", "mz"):
        return "kg m"
    if kind == "m":
        return "kg"
    turns = robot.joint(joint).turns
    if kind == "ia":
        return "kg m2" if turns else "kg"
    if kind == STIFFNESS:
        return "N m/rad" if turns else "N/m"
    if kind == "fv":
        return "N m s/rad" if turns else "N s/m"
    return torque_unit(robot, joint)


def position_unit(robot: Robot, joint: str) -> str:
    """Return the unit of a joint's position, rad or m."""
    return robot.joint(joint).unit


def command_unit(robot: Robot, joint: str, kind: str) -> str:
    """Return the unit of a joint's logged command: A for the ``current`` of a motor, else that of its torque."""
    return "A" if kind == "current" and joint in robot.motors else torque_unit(robot, joint)


def torque_unit(robot: Robot, joint: str) -> str:
    """Return N m for a revolute joint, N for a prismatic one."""
    return "N m" if robot.joint(joint).turns else "N"


def gain_unit(robot: Robot, joint: str, kind: str) -> str:
    """Return the unit of a gain: N m/A or N/A of a ``current``; 1 of torques, the true one over the one reported."""
    return f"{torque_unit(robot, joint)}/A" if kind == "current" else "1"
