"""Measured channels, signals in A, N m or N that the model predicts or takes as given, and side signals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gtau.robots.placement import WRENCH, WrenchFrame


@dataclass(frozen=True)
class ChannelKind:
    """A kind of channel; its attributes say what sets it apart.

    Messages call it ``name``, and all columns that a log updates together ``group``. ``calibration`` is its key under
    ``calibration`` of the signals, empty where the gain is unknown; on the ``link_side`` also that of its columns and
    units. ``modelled``: a row of the model explains it. ``measures_joint``: such a signal never rests, and is clipped
    at a limit. ``link_side``: it measures a joint's torque without the terms of its drive (rotor inertia, friction of
    motor and gear, offset of the current), and has an offset and bearing friction of its own.
    """

    name: str
    group: str
    calibration: str = ""
    modelled: bool = True
    measures_joint: bool = True
    link_side: bool = False

    @property
    def unknown_gain(self) -> bool:
        """True where the gain may be unknown; signals in N m or N have gain 1."""
        return not self.calibration


MOTOR = ChannelKind("command", "commands")
BASE = ChannelKind("wrench", "commands", "wrenches", measures_joint=False)
SENSOR = ChannelKind("torque sensor", "torque sensors", "joint_torque", link_side=True)
WRENCH_COMPONENT = ChannelKind("wrench", "wrenches", "wrenches", modelled=False, measures_joint=False)

LINK_SIDE = (SENSOR,)
"""All kinds on the link side; their columns, units and calibration in files, and their channels follow from these."""


def link_side_kind(name: str) -> ChannelKind:
    """Return the kind on the link side that has this name."""
    kinds = {kind.name: kind for kind in LINK_SIDE}
    if name not in kinds:
        raise ValueError(f"'{name}' is not a kind of sensor; write {' or '.join(kinds)}")
    return kinds[name]


@dataclass(frozen=True)
class SideSignal:
    """A signal logged beside positions and commands, in one column for all joints or in one for each.

    ``key`` names it in files and on a run; the first of the ``units`` is the default. A draft offers the columns whose
    names hold one of the ``words``, and says its ``effect``. Of a ``slow`` one means over parts of the log are kept; a
    ``position`` is a joint's, with its unit where none is stated.
    """

    key: str
    units: tuple[str, ...]
    words: frozenset[str]
    effect: str
    slow: bool = True
    position: bool = False


DEGREES = ("degC", "K", "s", "min", "h")  # or the time since the start
HEAT_WORDS = frozenset(["temp", "temps", "temperature", "temperatures", "温度", "溫度", "온도"])
GOAL = "goal less position, times a proportional gain, is the duty"  # its words are those of commands of positions
SUPPLY_CURRENT = "over duty it is the motor's current, in place of 'current'"
VOLTAGE = "beside currents it gives the drive gains without a payload"
VOLT_WORDS = frozenset(["voltage", "voltages", "volt", "volts", "电压", "電壓", "電圧", "전압"])
VOLT_BUSES = frozenset(["vbus", "vdc", "ubus"])
SUPPLY = VOLT_BUSES | {"supply", "bus", "ibus", "battery"}  # what feeds a drive, not its motor
VOLTS, SHARES, AMPERES = ("V", "mV"), ("1", "%", "‰"), ("A", "mA")
SI = {"mV": 1e-3, "%": 1e-2, "‰": 1e-3, "mA": 1e-3, "deg": np.pi / 180, "mm": 1e-3}
"""Factors of units of side signals, other than 1, to SI units."""

SIDE_SIGNALS = (
    SideSignal("temperature", DEGREES, HEAT_WORDS, "friction may depend on it"),
    SideSignal("voltage", VOLTS, VOLT_WORDS, VOLTAGE, slow=False),
    SideSignal("duty", SHARES, frozenset(["duty", "pwm"]), f"times supply_voltage, {VOLTAGE}", slow=False),
    SideSignal("supply_voltage", VOLTS, VOLT_WORDS | VOLT_BUSES, f"times duty, {VOLTAGE}", slow=False),
    SideSignal("supply_current", AMPERES, frozenset(["current", "ibus"]), SUPPLY_CURRENT, slow=False),
    SideSignal("goal", ("rad", "deg", "m", "mm"), frozenset(), GOAL, slow=False, position=True),
)
"""All side signals; their keys in files, their units, their columns in drafts and their place on a run follow."""


@dataclass(frozen=True, eq=False)
class SideValues:
    """Values of a side signal by joint, (K,) each, in ``unit``, at instants ``time`` (K,) in s."""

    time: np.ndarray
    by_joint: Mapping[str, np.ndarray]
    unit: str

    def at(self, joint: str, time: np.ndarray) -> np.ndarray:
        """Interpolate the values of a joint linearly at other instants (N,)."""
        return np.interp(time, self.time, self.by_joint[joint])

    def si(self, joint: str, time: np.ndarray) -> np.ndarray:
        """Interpolate them in SI units; the unit may be the quantity of a count, as in ``0.0065 A``."""
        size, _, unit = self.unit.rpartition(" ")
        return float(size or 1.0) * SI.get(unit, 1.0) * self.at(joint, time)


@dataclass(frozen=True)
class Channel:
    """A motor, the torque sensor of a joint, a row of a floating base, or a component of a measured wrench.

    ``name`` is the suffix of its own parameters (``off_2_sensor``), ``joint`` the joint or body, ``row`` the number of
    the joint, or of the component. The ``unit`` is ``A``, or ``N m`` for the unit of the joint's torque; ``delay`` (s)
    is by what it lagged behind the positions; ``std`` is the relative standard deviation of its scale, 0 where none is
    stated.
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
    """List the channels of a run: ``joints``, with ``base`` rows among them, ``sensors`` of joints, ``wrenches``."""
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
