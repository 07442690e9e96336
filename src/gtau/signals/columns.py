"""Where a log holds what: its columns, their units, or a rate in the place of a time column."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    FiniteFloat,
    Tag,
    field_validator,
    model_validator,
)

from gtau.documents.yaml_document import Document, validate

PositionUnit = Literal["rad", "deg", "m", "mm"]
Positive = Annotated[FiniteFloat, Field(gt=0)]


def _text_or_group(value: Any) -> str:
    return "text" if isinstance(value, str) else "group"


class Keys(BaseModel):
    """A group of a file: what it does not know is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class SampleRate(Keys):
    """Sampling rate of a log without time column, Hz."""

    rate: Positive


class Signals(Keys):
    """Columns of a log: time, and the position and the current (or torque) of every actuated joint."""

    time: Annotated[Annotated[str, Tag("text")] | Annotated[SampleRate, Tag("group")], Discriminator(_text_or_group)]
    position: dict[str, str] = Field(min_length=1)
    current: dict[str, str] | None = None
    torque: dict[str, str] | None = None

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, in the order of the file."""
        return tuple(self.position)

    @property
    def kind(self) -> Literal["current", "torque"]:
        """What the command columns hold."""
        return "torque" if self.current is None else "current"

    @property
    def command(self) -> dict[str, str]:
        """Columns of the currents or torques by joint."""
        return (self.torque if self.current is None else self.current) or {}

    @field_validator("position", "current", "torque")
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
        if (self.current is None) == (self.torque is None):
            raise ValueError("give the columns of either 'current' or 'torque', one of the two")
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


class Units(Keys):
    """Units of the log's columns; SI where nothing is said."""

    time: Literal["s", "ms", "us", "ns"] | None = None
    position: (
        Annotated[
            Annotated[PositionUnit, Tag("text")] | Annotated[dict[str, PositionUnit], Tag("group")],
            Discriminator(_text_or_group),
        ]
        | None
    ) = None
    current: Literal["A", "mA"] | None = None
    torque: Literal["N m", "Nm", "N"] | None = None

    def of_position(self, joint: str) -> PositionUnit | None:
        """Position unit of a joint; None where nothing is said."""
        return self.position.get(joint) if isinstance(self.position, dict) else self.position


def as_signals(signals: Signals | Mapping[str, Any]) -> Signals:
    """Column map from a mapping as in the experiment file; raises GtauError."""
    return signals if isinstance(signals, Signals) else validate(Signals, document_of("signals", signals))


def as_units(units: Units | Mapping[str, Any] | None) -> Units:
    """Units from a mapping as in the experiment file; raises GtauError."""
    return units if isinstance(units, Units) else validate(Units, document_of("units", units or {}))


def document_of(name: str, data: Mapping[str, Any]) -> Document:
    """A mapping as if it had been read from a file called ``name``."""
    return Document(Path(name), dict(data), {})
