"""Assignment of log columns to signals and units."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    Discriminator,
    Field,
    FiniteFloat,
    Tag,
    field_validator,
    model_validator,
)

from gtau.documents.validation import Keys, Positive, validate
from gtau.documents.yaml_document import Document
from gtau.signals.body_columns import BaseColumns, BaseUnits, BodyWrench, PoseColumns, PoseUnits, WrenchUnits
from gtau.signals.channel import Channel, channels_of
from gtau.signals.column_names import expanded, time_unit
from gtau.signals.units import SHARES, Kind, checked_unit, is_angle, si_factor


def text_or_group(value: Any) -> str:
    """Discriminate, for pydantic, one text for all joints from a group of texts by joint."""
    return "text" if isinstance(value, str) else "group"


def _kind_of_time(value: Any) -> str:
    if isinstance(value, StampsOfEach) or (isinstance(value, dict) and value.keys() & {"position", "command"}):
        return "each"
    return "text" if isinstance(value, str) else "pair" if isinstance(value, (list, tuple)) else "group"


class SampleRate(Keys):
    """Sampling rate of a log without time column, Hz."""

    rate: Positive


TwoColumns = tuple[str, str]
"""Columns of the seconds and of the nanoseconds."""


class StampsOfEach(Keys):
    """Time columns of positions and commands logged with separate time stamps."""

    position: Annotated[Annotated[str, Tag("text")] | Annotated[TwoColumns, Tag("pair")], Discriminator(_kind_of_time)]
    command: Annotated[Annotated[str, Tag("text")] | Annotated[TwoColumns, Tag("pair")], Discriminator(_kind_of_time)]


class Calibration(Keys):
    """Relative standard deviations of readings: of each torque sensor, and of all wrenches together."""

    joint_torque: Annotated[FiniteFloat, Field(gt=0, lt=0.5)] | None = None
    wrenches: Annotated[FiniteFloat, Field(gt=0, lt=0.5)] | None = None

    def of(self, channel: Channel) -> float:
        """Return the relative standard deviation of a channel's readings, 0 where none is stated."""
        return getattr(self, channel.kind.calibration) or 0.0


EXACT = Calibration()
"""Sensors that read without an error of scale."""


class Signals(Keys):
    """Columns of a log: time, and the position and the current (or torque) of every actuated joint.

    ``motor_torque`` times ``gear_ratio`` is the joint torque. ``joint_torque`` are torque sensors on the link side of
    the gears, of all joints or some. A ``pose`` tests the robot's geometry, friction may depend on a ``temperature``.
    ``base`` is the pose of a floating base with its wrenches; ``wrenches`` are external wrenches on other bodies;
    ``calibration`` is the accuracy of the sensors. A ``preset`` fills in the columns of a manufacturer's log.
    """

    time: Annotated[
        Annotated[str, Tag("text")]
        | Annotated[TwoColumns, Tag("pair")]
        | Annotated[StampsOfEach, Tag("each")]
        | Annotated[SampleRate, Tag("group")],
        Discriminator(_kind_of_time),
    ]
    position: dict[str, str] = Field(min_length=1)
    current: dict[str, str] | None = None
    torque: dict[str, str] | None = None
    motor_torque: dict[str, str] | None = None
    gear_ratio: dict[str, FiniteFloat] | None = None
    joint_torque: dict[str, str] | None = None
    base: BaseColumns | None = None
    wrenches: tuple[BodyWrench, ...] = ()
    calibration: Calibration = EXACT
    preset: str | None = None
    pose: PoseColumns | None = None
    temperature: (
        Annotated[Annotated[str, Tag("text")] | Annotated[dict[str, str], Tag("group")], Discriminator(text_or_group)]
        | None
    ) = None

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, in the order of the file, after those of a floating base."""
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
    def sensors(self) -> tuple[str, ...]:
        """Joints with a torque sensor, in the order of the joints."""
        return tuple(joint for joint in self.position if joint in (self.joint_torque or {}))

    @property
    def measured(self) -> tuple[str, ...]:
        """Columns of the commands, then of the torque sensors, then of all wrenches."""
        sensed = self.joint_torque or {}
        return (
            *(self.command[joint] for joint in self.position),
            *(sensed[joint] for joint in self.sensors),
            *(column for each in self.all_wrenches for column in each.columns),
        )

    @property
    def all_wrenches(self) -> tuple[BodyWrench, ...]:
        """Wrenches on all bodies, those on a floating base last."""
        return (*self.wrenches, *(self.base.acting if self.base else ()))

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Channels measured by these columns, the rows of a floating base among them."""
        base = self.base.joints if self.base else ()
        return channels_of(self.joints, base, self.sensors, [each.frame for each in self.all_wrenches])

    @property
    def temperature_columns(self) -> dict[str, str]:
        """Columns of temperatures by joint, or of the time since start; empty where there are none."""
        if isinstance(self.temperature, str):
            return dict.fromkeys(self.position, self.temperature)
        return self.temperature or {}

    @property
    def time_columns(self) -> tuple[str, ...]:
        """Columns of the positions' time, one or two, or none."""
        return _columns_of_time(self.time.position if isinstance(self.time, StampsOfEach) else self.time)

    @property
    def command_time_columns(self) -> tuple[str, ...]:
        """Columns of the commands' time, one or two, if they have separate time stamps."""
        return _columns_of_time(self.time.command) if isinstance(self.time, StampsOfEach) else ()

    @model_validator(mode="before")
    @classmethod
    def _preset(cls, data: Any) -> Any:
        return expanded(data) if isinstance(data, dict) and data.get("preset") else data

    @field_validator("position", "current", "torque", "motor_torque", "joint_torque")
    @classmethod
    def _each_column_once(cls, columns: dict[str, str] | None) -> dict[str, str] | None:
        owners: dict[str, str] = {}
        for joint, column in (columns or {}).items():
            if column in owners:
                raise ValueError(
                    f"the column '{column}' is given for joints '{owners[column]}' and '{joint}'; "
                    "give every joint its own"
                )
            owners[column] = joint
        return columns

    @model_validator(mode="after")
    def _one_command_per_joint(self) -> Signals:
        if sum(each is not None for each in (self.current, self.torque, self.motor_torque)) != 1:
            raise ValueError(
                "give the columns of either 'current' or 'torque' (or of 'motor_torque', with a 'gear_ratio'), one of "
                "them"
            )
        missing = [joint for joint in self.position if joint not in self.command]
        extra = [joint for joint in self.command if joint not in self.position]
        if missing and extra:
            raise ValueError(
                f"joint '{missing[0]}' has a position but no {self.kind}, and '{extra[0]}' a {self.kind} but no "
                "position; give both the same joints, those of the robot's motors"
            )
        if missing:
            raise ValueError(f"joint '{missing[0]}' has a position but no {self.kind}; add its {self.kind} column")
        if extra:
            raise ValueError(f"joint '{extra[0]}' has a {self.kind} but no position; add its position column")
        return self

    @model_validator(mode="after")
    def _pose_of_a_fixed_base(self) -> Signals:
        if self.pose is not None and self.base is not None:
            raise ValueError(
                "'pose' tests the geometry of a fixed-base robot, but 'base' describes a floating one; remove 'pose'"
            )
        return self

    @model_validator(mode="after")
    def _each_wrench_of_its_own(self) -> Signals:
        others = [*self.command.values(), *(self.joint_torque or {}).values(), *(self.base.forces if self.base else ())]
        columns = [column for each in self.wrenches for column in each.columns]
        for column in columns:
            if columns.count(column) > 1 or column in others:
                raise ValueError(f"the column '{column}' under 'wrenches' is given twice; give each component its own")
        if self.base is not None and any(each.body == self.base.body for each in self.wrenches):
            raise ValueError(
                f"'wrenches' names the floating base '{self.base.body}'; describe wrenches on it under 'wrenches' of "
                f"'base'"
            )
        return self

    @model_validator(mode="after")
    def _calibration_of_sensors(self) -> Signals:
        measured = {"joint_torque": self.sensors, "wrenches": self.wrenches or (self.base and self.base.wrenches)}
        for kind, there in measured.items():
            if getattr(self.calibration, kind) is not None and not there:
                raise ValueError(f"'calibration' is given for '{kind}', which the signals lack; remove it")
        return self

    @model_validator(mode="after")
    def _sensors_of_joints(self) -> Signals:
        for joint, column in (self.joint_torque or {}).items():
            if joint not in self.position:
                raise ValueError(
                    f"'joint_torque' names the joint '{joint}', which has no position; correct the name, or remove the "
                    "sensor of a joint without motor"
                )
            if column in self.command.values():
                raise ValueError(
                    f"the column '{column}' is given both as a {self.kind} and as a joint_torque; 'joint_torque' is "
                    f"for sensors behind the gear, not for torques computed from motor currents"
                )
        return self

    @model_validator(mode="after")
    def _temperatures_of_joints(self) -> Signals:
        for joint in self.temperature_columns:
            if joint not in self.position:
                raise ValueError(f"'temperature' names the joint '{joint}', which has no position; correct the name")
        return self

    @model_validator(mode="after")
    def _ratios_of_motor_torques(self) -> Signals:
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
        for joint in ratios:
            if joint not in self.position:
                raise ValueError(f"'gear_ratio' names the joint '{joint}', which has no position; correct the name")
        return self


def _columns_of_time(time: Any) -> tuple[str, ...]:
    return () if isinstance(time, SampleRate) else (time,) if isinstance(time, str) else tuple(time)


def as_signals(signals: Signals | Mapping[str, Any]) -> Signals:
    """Read a column map from a mapping as in the experiment file; raises GtauError."""
    return signals if isinstance(signals, Signals) else validate(Signals, document_of("signals", signals))


def document_of(name: str, data: Mapping[str, Any]) -> Document:
    """Convert a mapping to the document read from a file called ``name``, with keys and integers as texts."""
    return Document(Path(name), _as_written(data), {})


def _as_written(data: Any) -> Any:
    if isinstance(data, Mapping):
        return {str(key): _as_written(value) for key, value in data.items()}
    return str(data) if isinstance(data, (int, np.integer)) and not isinstance(data, bool) else data


def _one_or_by_joint(kind: Kind) -> Any:
    text = Annotated[str, checked_unit(kind, shares=kind in ("current", "torque"))]
    return Annotated[
        Annotated[text, Tag("text")] | Annotated[dict[str, text], Tag("group")], Discriminator(text_or_group)
    ]


class Units(Keys):
    """Units of the log's columns, or the quantity per logged count (``0.0012 A``); SI by default.

    ``joint_torque`` is that of the torque sensors. ``rated`` are the rated currents (A) or torques (N m, N) of which
    ``%`` and ``‰`` are shares.
    """

    time: Annotated[str, checked_unit("time")] | None = None
    position: _one_or_by_joint("position") | None = None  # type: ignore[valid-type]
    current: _one_or_by_joint("current") | None = None  # type: ignore[valid-type]
    torque: _one_or_by_joint("torque") | None = None  # type: ignore[valid-type]
    joint_torque: _one_or_by_joint("torque") | None = None  # type: ignore[valid-type]
    rated: dict[str, Positive] = Field(default_factory=dict)
    base: BaseUnits = BaseUnits()
    pose: PoseUnits = PoseUnits()
    wrenches: WrenchUnits = WrenchUnits()
    temperature: Literal["degC", "K", "s", "min", "h"] = "degC"

    @model_validator(mode="after")
    def _rated_values_of_shares(self) -> Units:
        of_command = self.current if self.torque is None else self.torque
        units = of_command.values() if isinstance(of_command, dict) else [of_command]
        if self.rated and not any(unit in SHARES for unit in units):
            raise ValueError("'rated' is given, but no unit is '%' or '‰'; remove it, or give that unit")
        if not self.rated and any(unit in SHARES for unit in units):
            raise ValueError(
                "a unit is relative to the rated value, which is missing; add 'rated: {JOINT: ...}' in A (N m, N)"
            )
        return self

    def of_position(self, joint: str) -> str | None:
        """Return the position unit of a joint; None where nothing is stated."""
        return _of(self.position, joint)

    def measures_angle(self, joint: str) -> bool | None:
        """Decide whether a joint's position unit is an angle and not a length; None where nothing is stated."""
        unit = self.of_position(joint)
        return None if unit is None else is_angle(unit)

    def scale(self, signals: Signals) -> tuple[list[float], list[float], float]:
        """Compute factors to SI of the columns of positions and base pose, of all measured ones, and of the time.

        Raises
        ------
        GtauError
            A share of a rated value is logged, but the rated value is not given.
        """
        positions = [si_factor(self.of_position(joint) or "rad", "position") for joint in signals.position]
        positions += signals.base.scale(self.base) if signals.base else []
        commands = [self._of_command(joint, signals) for joint in signals.position]
        commands += [si_factor(_of(self.joint_torque, joint) or "N m", "torque") for joint in signals.sensors]
        commands += [factor for each in signals.all_wrenches for factor in self.wrenches.scale(each)]
        return positions, commands, si_factor(self.time or time_unit(signals.preset), "time")

    def _of_command(self, joint: str, signals: Signals) -> float:
        unit = _of(self.current if signals.kind == "current" else self.torque, joint)
        ratio = (signals.gear_ratio or {}).get(joint, 1.0)
        if unit is None:
            return ratio
        if unit not in SHARES:
            return ratio * si_factor(unit, signals.kind)
        if joint not in self.rated:
            raise document_of("units", {}).error(
                ("rated",), f"joint '{joint}' has no rated {signals.kind}, to which its column is relative; add it"
            )
        return ratio * SHARES[unit] * self.rated[joint]


def _of(units: str | dict[str, str] | None, joint: str) -> str | None:
    return units.get(joint) if isinstance(units, dict) else units


def as_units(units: Units | Mapping[str, Any] | None) -> Units:
    """Read units from a mapping as in the experiment file; raises GtauError."""
    return units if isinstance(units, Units) else validate(Units, document_of("units", {} if units is None else units))
