"""Measured channels: signals in A, N m or N that the model predicts or takes as given.

What sets a kind of channel apart are the attributes of its :class:`ChannelKind`; other modules ask these.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
        found. Where it is on the ``link_side``, its columns and their units have this key too.
    modelled : bool
        True where it has equations: a row of the model explains it. Otherwise the model takes it as given.
    of_joint : bool
        True where it measures one joint of the user: such a signal never rests, and is clipped at a limit.
    link_side : bool
        True where it measures a joint's torque without the terms of its drive (rotor inertia, friction of motor and
        gear, offset of the current); it has an offset and bearing friction of its own.
    """

    name: str
    group: str
    calibration: str = ""
    modelled: bool = True
    of_joint: bool = True
    link_side: bool = False

    @property
    def unknown_gain(self) -> bool:
        """True where the gain may be unknown; signals in N m or N have gain 1."""
        return not self.calibration


MOTOR = ChannelKind("command", "commands")
BASE = ChannelKind("wrench", "commands", "wrenches", of_joint=False)
SENSOR = ChannelKind("torque sensor", "torque sensors", "joint_torque", link_side=True)
WRENCH_COMPONENT = ChannelKind("wrench", "wrenches", "wrenches", modelled=False, of_joint=False)

LINK_SIDE = (SENSOR,)
"""All kinds on the link side; their columns, units and calibration in files, and their channels follow from these."""


def link_side_kind(name: str) -> ChannelKind:
    """Return the kind on the link side that has this name."""
    for kind in LINK_SIDE:
        if kind.name == name:
            return kind
    raise ValueError(f"'{name}' is not a kind of sensor; write {' or '.join(kind.name for kind in LINK_SIDE)}")


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
    unit : str
        Of its values; ``N m`` stands for the unit of the joint's torque, which is N where the joint is prismatic.
    delay : float
        By which it lagged behind the positions in the log, s; it is compensated.
    std : float
        Relative standard deviation of its scale, 0 where none is stated.
    frame : WrenchFrame, optional
        Frame of a wrench.
    """

    name: str
    kind: ChannelKind
    joint: str
    row: int
    unit: str = "A"
    delay: float = 0.0
    std: float = 0.0
    frame: WrenchFrame | None = None


def channels_of(
    joints: Sequence[str],
    base: Sequence[str],
    sensors: Mapping[ChannelKind, Sequence[str]] | None = None,
    wrenches: Sequence[WrenchFrame] = (),
    unit: str = "A",
) -> tuple[Channel, ...]:
    """List the channels of a run, in the order of its columns.

    Parameters
    ----------
    joints, base : sequence of str
        Actuated joints, the rows of the model, and those of them that are the rows of a floating base.
    sensors : mapping
        Joints with a sensor on the link side, by its kind.
    wrenches : sequence of WrenchFrame
        Measured wrenches, six components each.
    unit : str
        Of the commands, ``A`` or ``N m``.
    """
    return (
        *(Channel(joint, BASE if joint in base else MOTOR, joint, row, unit) for row, joint in enumerate(joints)),
        *(
            Channel(f"{joint}_{kind.name.split()[-1]}", kind, joint, joints.index(joint), "N m")
            for kind, sensed in (sensors or {}).items()
            for joint in sensed
        ),
        *(
            Channel(f"{frame.body}_{component}", WRENCH_COMPONENT, frame.body, 6 * k + number, "N m", frame=frame)
            for k, frame in enumerate(wrenches)
            for number, component in enumerate(WRENCH)
        ),
    )
