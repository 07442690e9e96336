"""SI units of parameters and torques."""

from __future__ import annotations

from gtau.robots.robot import Robot


def unit_of(kind: str, robot: Robot, joint: str) -> str:
    """Return the SI unit of a parameter of ``kind`` at a joint or platform."""
    if kind in ("xx", "xy", "xz", "yy", "yz", "zz"):
        return "kg m2"
    if kind in ("mx", "my", "mz"):
        return "kg m"
    if kind == "m":
        return "kg"
    turns = robot.joint(joint).kind == "revolute"
    if kind == "ia":
        return "kg m2" if turns else "kg"
    if kind == "fv":
        return "N m s/rad" if turns else "N s/m"
    return torque_unit(robot, joint)


def torque_unit(robot: Robot, joint: str) -> str:
    """Return N m for a revolute joint, N for a prismatic one."""
    return "N m" if robot.joint(joint).kind == "revolute" else "N"
