"""Assignment of log columns to signals, and presets of common recorders."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, FiniteFloat, Tag, create_model, field_validator, model_validator

from gtau.documents.markup import own_table
from gtau.documents.validation import Keys, Positive, text_or_group
from gtau.signals.channel import LINK_SIDE, SIDE_SIGNALS, Channel, ChannelKind, SideSignal, channels_of
from gtau.signals.reading.body_columns import BaseColumns, BodyWrench, PoseColumns, refuse_repeated

# Hz; of drives that are logged. Logs polled at 10 Hz reach 9; logs of 5 kHz in ms look like 5 Hz in s.
LEAST_RATE, LARGEST_RATE = 6.0, 5e4

PRESETS: Mapping[str, Mapping[str, Any]] = own_table(__file__, "presets.yaml")


def expanded(signals: Mapping[str, Any]) -> dict[str, Any]:
    """Fill in the columns of a preset for the ``joints`` named; columns given by hand come first. Raises ValueError."""
    given = {key: value for key, value in signals.items() if key != "joints"}
    preset = PRESETS.get(str(signals["preset"]))
    if preset is None:
        raise ValueError(f"there is no preset '{signals['preset']}'; choose from {', '.join(PRESETS)}")
    wanted = preset.keys() & {"position", "current", "torque"} - given.keys()
    if given.keys() & {"current", "torque", "motor_torque"}:
        wanted &= {"position"}
    joints = signals.get("joints")
    if wanted and (not isinstance(joints, Sequence) or isinstance(joints, str) or not joints):
        raise ValueError(f"the preset '{signals['preset']}' needs the joints in their order; add 'joints: [..., ...]'")
    columns = {
        key: {str(joint): preset[key].format(k=k, n=k + 1, joint=joint) for k, joint in enumerate(joints or ())}
        for key in wanted
    }
    return {"time": preset["time"]} | columns | given


def _kind_of_time(value: Any) -> str:
    if isinstance(value, TwoClocks) or (isinstance(value, dict) and value.keys() & {"position", "command"}):
        return "clocks"
    if isinstance(value, (list, tuple)):
        return "pair"
    return text_or_group(value)


class SampleRate(Keys):
    """Sampling rate of a log without time column, Hz."""

    rate: Positive


Column = Annotated[str, Tag("text")]
TwoColumns = Annotated[tuple[str, str], Tag("pair")]  # of the seconds and of the nanoseconds
TimeColumns = Annotated[Column | TwoColumns, Discriminator(_kind_of_time)]


class TwoClocks(Keys):
    """Time columns of positions and commands logged with separate time stamps."""

    position: TimeColumns
    command: TimeColumns


def optional_keys(entries: Mapping[str, Any]) -> type[Keys]:
    """Make a group whose keys are None where left out."""
    fields: Any = {key: (entry | None, None) for key, entry in entries.items()}
    return create_model("OptionalKeys", __base__=Keys, **fields)


SENSORS = tuple(kind.calibration for kind in LINK_SIDE)
"""Keys of sensors on the link side."""
Share = Annotated[FiniteFloat, Field(gt=0, lt=0.5)]


class Calibration(optional_keys(dict.fromkeys(SENSORS, Share))):  # type: ignore[misc]
    """Relative standard deviations of readings: of each sensor on the link side, and of all wrenches together."""

    wrenches: Share | None = None


OneOrByJoint = Annotated[Column | Annotated[dict[str, str], Tag("group")], Discriminator(text_or_group)]
Optional = dict.fromkeys(SENSORS, dict[str, str]) | {signal.key: OneOrByJoint for signal in SIDE_SIGNALS}


class Signals(optional_keys(Optional)):  # type: ignore[misc]
    """Columns of a log: time, and the position and the current (or torque) of every actuated joint.

    ``motor_torque`` times ``gear_ratio`` is the joint torque. ``joint_torque`` are torque sensors on the link side of
    the gears, of all joints or some. A ``pose`` tests the robot's geometry. Side signals, such as ``temperature``, have
    their keys, too; ``supply_current``, with a ``duty``, may replace the current, and ``proportional_gain`` times the
    ``goal`` less the position is the duty, 1 at most. ``base`` is the pose of a floating base with its wrenches;
    ``wrenches`` are external wrenches on other bodies; ``calibration`` is the accuracy of the sensors. A ``preset``
    fills in the columns of a manufacturer's log.
    """

    time: Annotated[
        Column | TwoColumns | Annotated[TwoClocks, Tag("clocks")] | Annotated[SampleRate, Tag("group")],
        Discriminator(_kind_of_time),
    ]
    position: dict[str, str] = Field(min_length=1)
    current: dict[str, str] | None = None
    torque: dict[str, str] | None = None
    motor_torque: dict[str, str] | None = None
    gear_ratio: dict[str, FiniteFloat] | None = None
    base: BaseColumns | None = None
    wrenches: tuple[BodyWrench, ...] = ()
    calibration: Calibration = Calibration()
    preset: str | None = None
    pose: PoseColumns | None = None
    proportional_gain: dict[str, FiniteFloat] | None = None

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, in the order of the file, after the joints of a floating base."""
        return (*(self.base.joints if self.base else ()), *self.position)

    @property
    def kind(self) -> Literal["current", "torque"]:
        """Kind of the commands; motor torques count as torques."""
        return "torque" if self.current is None else "current"

    @property
    def command(self) -> dict[str, str]:
        """Columns of the currents or torques by joint."""
        return self.current or self.torque or self.motor_torque or {}

    @property
    def rate(self) -> float | None:
        """Sampling rate of a log without time column, Hz."""
        return self.time.rate if isinstance(self.time, SampleRate) else None

    @property
    def supplied(self) -> bool:
        """Whether the currents are of the motors' supply."""
        return self.current is not None and self.current == self.supply_current

    def sensors(self, kind: ChannelKind) -> dict[str, str]:
        """Return the columns of a kind of sensor on the link side by joint, in the order of the joints."""
        columns = getattr(self, kind.calibration) or {}
        return {joint: columns[joint] for joint in self.position if joint in columns}

    @property
    def modelled(self) -> tuple[str, ...]:
        """Columns of the commands, then of the sensors on the link side."""
        sensors = (column for kind in LINK_SIDE for column in self.sensors(kind).values())
        return (*(self.command[joint] for joint in self.position), *sensors)

    @property
    def measured(self) -> tuple[str, ...]:
        """Columns of the commands, then of the sensors on the link side, then of all wrenches."""
        return (*self.modelled, *(column for wrench in self.all_wrenches for column in wrench.columns))

    @property
    def all_wrenches(self) -> tuple[BodyWrench, ...]:
        """Wrenches on all bodies, on a floating base last."""
        return (*self.wrenches, *(self.base.acting if self.base else ()))

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Channels measured by these columns, the rows of a floating base among them."""
        base, unit = self.base.joints if self.base else (), "A" if self.kind == "current" else "N m"
        sensors = {kind: tuple(self.sensors(kind)) for kind in LINK_SIDE}
        channels = channels_of(self.joints, base, sensors, [wrench.frame for wrench in self.all_wrenches], unit)
        stds = dict(self.calibration)
        return tuple(replace(channel, std=stds.get(channel.kind.calibration) or 0.0) for channel in channels)

    def side_columns(self, signal: SideSignal) -> dict[str, str]:
        """Return the columns of a side signal by joint, empty where there are none."""
        columns = getattr(self, signal.key) or {}
        return dict.fromkeys(self.position, columns) if isinstance(columns, str) else columns

    @property
    def time_columns(self) -> tuple[str, ...]:
        """Columns of the positions' time, one or two, or none."""
        return _columns(self.time.position if isinstance(self.time, TwoClocks) else self.time)

    @property
    def command_time_columns(self) -> tuple[str, ...]:
        """Columns of the commands' time, one or two, if they have separate time stamps."""
        return _columns(self.time.command) if isinstance(self.time, TwoClocks) else ()

    @model_validator(mode="before")
    @classmethod
    def _preset(cls, data: Any) -> Any:
        data = expanded(data) if isinstance(data, dict) and data.get("preset") else data
        commands = {"current", "torque", "motor_torque"}
        if isinstance(data, dict) and isinstance(data.get("supply_current"), dict) and not commands & data.keys():
            return data | {"current": data["supply_current"]}
        return data

    @field_validator("position", "current", "torque", "motor_torque", *SENSORS)
    @classmethod
    def _each_column_once(cls, columns: dict[str, str] | None) -> dict[str, str] | None:
        owners: dict[str, str] = {}
        for joint, column in (columns or {}).items():
            if (owner := owners.setdefault(column, joint)) != joint:
                raise ValueError(
                    f"the column '{column}' is given for joints '{owner}' and '{joint}'; give every joint its own"
                )
        return columns

    @model_validator(mode="after")
    def _one_command_per_joint(self) -> Signals:
        kind, commands = self.kind, (self.current, self.torque, self.motor_torque)
        if commands.count(None) != 2:
            raise ValueError(
                "give the columns of either 'current' or 'torque' (or of 'motor_torque', with a 'gear_ratio'), one of "
                "them"
            )
        lacks = [f"'{joint}' has a position but no {kind}" for joint in self.position if joint not in self.command]
        has = [f"'{joint}' has a {kind} but no position" for joint in self.command if joint not in self.position]
        if lacks or has:
            one = ", and ".join((*lacks[:1], *has[:1]))
            raise ValueError(f"joint {one}; give both the same joints, the joints with motors")
        return self

    @model_validator(mode="after")
    def _bodies(self) -> Signals:
        base, measured = self.base, list(self.measured)
        if self.pose is not None and base is not None:
            raise ValueError(
                "'pose' tests the geometry of a fixed-base robot, but 'base' describes a floating one; remove 'pose'"
            )
        for wrench in self.wrenches:
            refuse_repeated(wrench.columns, measured, " under 'wrenches'")
        if base is not None and any(wrench.body == base.body for wrench in self.wrenches):
            raise ValueError(
                f"'wrenches' names the floating base '{base.body}'; describe wrenches on it under 'wrenches' of 'base'"
            )
        calibrated = {channel.kind.calibration for channel in self.channels[len(self.joints) :]}
        for key, accuracy in self.calibration:
            if accuracy is not None and key not in calibrated:
                raise ValueError(f"'calibration' is given for '{key}', which the signals lack; remove it")
        return self

    @model_validator(mode="after")
    def _side_signals_and_ratios(self) -> Signals:
        ratios = self.gear_ratio or {}
        if self.motor_torque is None and ratios:
            raise ValueError(
                "'gear_ratio' is given without 'motor_torque'; remove it, or name the torques 'motor_torque'"
            )
        for joint in self.motor_torque or {}:
            if not ratios.get(joint):
                raise ValueError(
                    f"joint '{joint}' has a motor torque but no gear ratio; add 'gear_ratio: {{{joint}: ...}}', motor "
                    "turns (or rad) for one turn (or m) of the joint, negative where they turn against each other"
                )
        gains = self.proportional_gain or {}
        if gains and not self.goal:
            raise ValueError("'proportional_gain' is given without 'goal'; add the columns of the goals, or remove it")
        if self.supplied and not (self.duty or gains):
            raise ValueError("'supply_current' needs a 'duty'; add its columns, or 'goal' and 'proportional_gain'")
        named: dict[str, Mapping[str, Any]] = {"gear_ratio": ratios, "proportional_gain": gains}
        named |= {name: getattr(self, name) or {} for name in SENSORS}
        named |= {signal.key: self.side_columns(signal) for signal in SIDE_SIGNALS}
        used = dict.fromkeys(self.position.values(), "position") | dict.fromkeys(self.command.values(), self.kind)
        for key, (joint, column) in ((key, pair) for key, columns in named.items() for pair in columns.items()):
            if joint not in self.position:
                raise ValueError(f"'{key}' names the joint '{joint}', which has no position; correct the name")
            if column in used and not (self.supplied and key == "supply_current"):
                both = f"the column '{column}' is given both as a {used[column]} and as a {key}"
                raise ValueError(f"{both}; give the column of the {key}, or remove '{key}'")
        return self


def _columns(time: str | tuple[str, str] | SampleRate) -> tuple[str, ...]:
    if isinstance(time, SampleRate):
        return ()
    return (time,) if isinstance(time, str) else time
