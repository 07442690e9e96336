"""Torque sensors between gear and link: further rows of the same regressor, whose gain is known to be 1.

What a sensor of joint j measures is the torque of row j of the model without what belongs to its drive: rotor inertia,
friction of motor and gear, and the offset of the current. It has an offset of its own and, where the data ask for it,
friction of its bearing. The links' parameters are the same, so they carry the sensor's scale to all drive gains.
"""

from __future__ import annotations

from collections.abc import Sequence

from gtau.errors import GtauError
from gtau.robots.robot import Robot
from gtau.signals.run import Run

BEARING = ("fv", "fs")  # friction that a sensor's bearing may have of its own


def sensor_name(joint: str) -> str:
    """Name of a joint's torque sensor, behind the kind in the names of its own parameters (``off_2_sensor``)."""
    return f"{joint}_sensor"


def bearing_terms(sensors: Sequence[str]) -> tuple[str, ...]:
    """List all friction terms of the bearings of all ``sensors``, given by joint."""
    return tuple(f"{kind}_{sensor_name(joint)}" for joint in sensors for kind in BEARING)


def joint_behind(body: str, robot: Robot) -> str:
    """Return the joint of a sensor, or the joint or platform that a parameter's name ends in."""
    return body if body in robot.bodies else body.removesuffix("_sensor")


def sensors_of(robot: Robot, runs: Sequence[Run]) -> tuple[str, ...]:
    """List the joints with a torque sensor, the same in all runs, in the order of the robot's motors.

    Raises
    ------
    GtauError
        Where runs differ in their sensors, or a motor drives a sensor's joint through a coupling.
    """
    sensors = runs[0].sensors
    for run in runs:
        if run.sensors != sensors:
            listed = [", ".join(each.sensors) or "none" for each in (runs[0], run)]
            raise GtauError(
                f"runs '{runs[0].name}' and '{run.name}' have torque sensors at other joints ({listed[0]}; "
                f"{listed[1]}); give 'joint_torque' for the same joints in all runs."
            )
    coupled = {name for each in robot.couplings for name in (each.joint, *dict(each.ratios))}
    for joint in sensors:
        if joint in coupled:
            raise GtauError(
                f"joint '{joint}' has a torque sensor, but couplings of robot '{robot.name}' share it between motors, "
                "so that no motor's torque is that of the joint; remove it from 'joint_torque'."
            )
        if f"{joint}_sensor" in robot.bodies:
            raise GtauError(f"joint '{joint}_sensor' has the name of a torque sensor of '{joint}'; rename the joint.")
    return sensors
