"""Units of a log's columns."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    Discriminator,
    Field,
    Tag,
    model_validator,
)

from gtau.documents.validation import Keys, Positive, validate
from gtau.signals.base_columns import BaseUnits
from gtau.signals.columns import Signals, document_of, text_or_group
from gtau.signals.pose_columns import PoseUnits
from gtau.signals.presets import time_unit
from gtau.signals.units import SHARES, Kind, is_angle, si_factor
from gtau.signals.wrench_columns import WrenchUnits


def _unit(kind: Kind) -> AfterValidator:
    def checked(text: str) -> str:
        if text not in SHARES or kind in ("time", "position"):
            si_factor(text, kind)
        return text

    return AfterValidator(checked)


def _one_or_by_joint(kind: Kind) -> Any:
    unit = Annotated[str, _unit(kind)]
    return Annotated[
        Annotated[unit, Tag("text")] | Annotated[dict[str, unit], Tag("group")], Discriminator(text_or_group)
    ]


class Units(Keys):
    """Units of the log's columns, or quantities that stand for 1 in it (``0.0012 A``); SI where nothing is said.

    ``joint_torque`` are those of the torque sensors. ``rated`` are the rated currents (A) or torques (N m, N) of which
    ``%`` and ``‰`` are shares.
    """

    time: Annotated[str, _unit("time")] | None = None
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
                "a unit is a share of the rated value, which is not given; add 'rated: {JOINT: ...}' in A (N m, N)"
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
        """Compute factors to SI of the positions and of the commands, joint by joint, and of the time.

        Raises
        ------
        GtauError
            A share is logged of a rated value that is not given.
        """
        positions = [si_factor(self.of_position(joint) or "rad", "position") for joint in signals.position]
        commands = [self._of_command(joint, signals) for joint in signals.position]
        commands += [si_factor(_of(self.joint_torque, joint) or "N m", "torque") for joint in signals.sensors]
        commands += [factor for each in signals.wrenches for factor in self.wrenches.scale(each)]
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
                ("rated",), f"joint '{joint}' has no rated {signals.kind}, of which its column is a share; add it"
            )
        return ratio * SHARES[unit] * self.rated[joint]


def _of(units: str | dict[str, str] | None, joint: str) -> str | None:
    return units.get(joint) if isinstance(units, dict) else units


def as_units(units: Units | Mapping[str, Any] | None) -> Units:
    """Read units from a mapping as in the experiment file; raises GtauError."""
    return units if isinstance(units, Units) else validate(Units, document_of("units", units or {}))
