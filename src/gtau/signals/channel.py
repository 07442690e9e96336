"""Measured channels: signals in A, N m or N that the model predicts or takes as given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from gtau.robots.floating import WRENCH, WrenchFrame
from gtau.robots.robot import Robot

ChannelKind = Literal["motor", "sensor", "base", "wrench"]


@dataclass(frozen=True)
class Channel:
    """A motor, the torque sensor of a joint, a row of a floating base, or a component of a measured wrench.

    Attributes
    ----------
    name : str
        Suffix of the channel's own parameters (``off_2_sensor``).
    kind : str
        Kind of the channel.
    joint : str
        Joint whose torque it measures; for a wrench the body.
    row : int
        Row of the model with that torque (number of the joint); for a wrench the number of its component.
    """

    name: str
    kind: ChannelKind
    joint: str
    row: int

    @property
    def free(self) -> bool:
        """True where the gain may be unknown; signals in N m or N have gain 1."""
        return self.kind == "motor"


def channels_of_model(robot: Robot, sensors: Sequence[str]) -> tuple[Channel, ...]:
    """List the channels with model equations, (c,): actuated joints, then torque ``sensors``, given by joint."""
    joints = robot.actuated
    return (
        *(Channel(joint, "base" if joint in robot.base else "motor", joint, row) for row, joint in enumerate(joints)),
        *sensor_channels(joints, sensors),
    )


def sensor_channels(joints: Sequence[str], sensors: Sequence[str]) -> tuple[Channel, ...]:
    """List the channels of torque sensors, given by joint; ``joints`` are those of the rows of the model."""
    return tuple(Channel(f"{joint}_sensor", "sensor", joint, joints.index(joint)) for joint in sensors)


def wrench_channels(frames: Sequence[WrenchFrame]) -> tuple[Channel, ...]:
    """List the channels of measured wrenches, six each."""
    return tuple(
        Channel(f"{frame.body}_{component}", "wrench", frame.body, 6 * k + number)
        for k, frame in enumerate(frames)
        for number, component in enumerate(WRENCH)
    )
