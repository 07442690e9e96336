"""Measured channels: signals in A, N m or N that the model predicts or takes as given.

What sets a kind of channel apart are the attributes of its :class:`ChannelKind`; other modules ask these.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gtau.robots.floating import WRENCH, WrenchFrame


@dataclass(frozen=True)
class ChannelKind:
    """A kind of channel.

    Attributes
    ----------
    name : str
        In messages, beside the name of its joint or body.
    group : str
        All columns that a log updates together with those of this kind, in messages.
    calibration : str
        Its key under ``calibration`` of the signals, for the accuracy of its scale, ``""`` where the gain is to be
        found. Where it is ``behind_drive``, its columns and their units have this key too.
    modelled : bool
        True where it has equations: a row of the model explains it. Otherwise the model takes it as given.
    of_joint : bool
        True where it measures one joint of the user: such a signal never rests, and is clipped at a limit.
    behind_drive : bool
        True where it measures a joint's torque without the terms of its drive (rotor inertia, friction of motor and
        gear, offset of the current); it has an offset and bearing friction of its own.
    """

    name: str
    group: str
    calibration: str = ""
    modelled: bool = True
    of_joint: bool = True
    behind_drive: bool = False

    @property
    def unknown_gain(self) -> bool:
        """True where the gain may be unknown; signals in N m or N have gain 1."""
        return not self.calibration


MOTOR = ChannelKind("command", "commands")
BASE = ChannelKind("wrench", "commands", "wrenches", of_joint=False)
SENSOR = ChannelKind("torque sensor", "torque sensors", "joint_torque", behind_drive=True)
WRENCH_COMPONENT = ChannelKind("wrench", "wrenches", "wrenches", modelled=False, of_joint=False)

BEHIND_DRIVE = (SENSOR,)
"""All kinds that are ``behind_drive``."""


def sensor_kind(name: str) -> ChannelKind:
    """Return the kind behind the drive that has this name."""
    for kind in BEHIND_DRIVE:
        if kind.name == name:
            return kind
    raise ValueError(f"'{name}' is not a kind of sensor; write {' or '.join(each.name for each in BEHIND_DRIVE)}")


@dataclass(frozen=True)
class Channel:
    """A motor, the torque sensor of a joint, a row of a floating base, or a component of a measured wrench.

    Attributes
    ----------
    name : str
        Suffix of the channel's own parameters (``off_2_sensor``).
    kind : ChannelKind
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


def channels_of(
    joints: Sequence[str], base: Sequence[str], sensors: Sequence[str] = (), wrenches: Sequence[WrenchFrame] = ()
) -> tuple[Channel, ...]:
    """List the channels of a run, in the order of its columns.

    Parameters
    ----------
    joints, base : sequence of str
        Actuated joints, the rows of the model, and those of them that are the rows of a floating base.
    sensors : sequence of str
        Joints with a torque sensor.
    wrenches : sequence of WrenchFrame
        Measured wrenches, six components each.
    """
    return (
        *(Channel(joint, BASE if joint in base else MOTOR, joint, row) for row, joint in enumerate(joints)),
        *(Channel(f"{joint}_sensor", SENSOR, joint, joints.index(joint)) for joint in sensors),
        *(
            Channel(f"{frame.body}_{component}", WRENCH_COMPONENT, frame.body, 6 * k + number)
            for k, frame in enumerate(wrenches)
            for number, component in enumerate(WRENCH)
        ),
    )
