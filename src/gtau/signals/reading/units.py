"""Units of a log's columns, as factors to SI; units outside ``COMMON`` are converted by pint."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from functools import cache
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Discriminator, Field, Tag, model_validator

from gtau.documents.validation import Keys, Positive, text_or_group
from gtau.documents.yaml_document import Document
from gtau.errors import GtauError
from gtau.signals.channel import LINK_SIDE, SIDE_SIGNALS
from gtau.signals.reading.body_columns import BaseColumns, PoseColumns, Wrench
from gtau.signals.reading.column_names import parse_column_name
from gtau.signals.reading.columns import PRESETS, Signals, optional_keys
from gtau.signals.reading.formats import LogTable
from gtau.signals.reading.written_units import SI

Kind = Literal["time", "position", "current", "torque", "force"]

COMMON: dict[str, dict[str, float]] = {  # units of nearly all logs, without the half second that pint takes to import
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "angle": {"rad": 1.0, "deg": math.pi / 180},
    "length": {"m": 1.0, "mm": 1e-3},
    "current": {"A": 1.0, "mA": 1e-3},
    "torque": {"N m": 1.0, "Nm": 1.0},
    "force": {"N": 1.0},
}
QUANTITIES: dict[Kind, tuple[str, ...]] = {
    "time": ("time",),
    "position": ("angle", "length"),
    "current": ("current",),
    "torque": ("torque", "force"),
    "force": ("force",),
}
SHARES = {"%": 1e-2, "‰": 1e-3}  # of the rated current or torque
NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d{1,2})?\s*", re.IGNORECASE)
UNIT = re.compile(r"[^\W\d_][^\W\d_/*^· -]*|[/*^· -]+|\d\b|[()]|°")


def si_factor(text: str, kind: Kind) -> float:
    """Convert a unit, or a quantity such as ``0.0012 A`` (of one count), to the SI unit of its kind.

    Raises ValueError, whose text gives the remedy, if it is not a unit of that kind.
    """
    return _measured(text, kind)[1]


def is_unit(text: str, kind: Kind) -> bool:
    """Decide whether a text is a unit of a kind, or a quantity in one."""
    try:
        return bool(si_factor(text, kind))
    except ValueError:
        return False


def is_angle(text: str) -> bool:
    """Decide whether a unit of positions is an angle and not a length."""
    return _measured(text, "position")[0] == "angle"


def checked_unit(
    kind: Kind, quantity: Literal["angle", "length"] | None = None, shares: bool = False
) -> AfterValidator:
    """Make the validator of units of a kind and, for positions, of a ``quantity``; ``shares`` may be allowed."""

    def checked(text: str) -> str:
        if shares and text in SHARES:
            return text
        si_factor(text, kind)
        if quantity is not None and is_angle(text) != (quantity == "angle"):
            raise ValueError(f"'{text}' is not a unit of {quantity}; write {' or '.join(COMMON[quantity])}")
        return text

    return AfterValidator(checked)


def _measured(text: str, kind: Kind) -> tuple[str, float]:
    """Find the quantity that a unit measures, and its factor to SI."""
    for quantity in QUANTITIES[kind]:
        if text in COMMON[quantity]:
            return quantity, COMMON[quantity][text]
    listed = [repr(name) for quantity in QUANTITIES[kind] for name in COMMON[quantity] if name != "Nm"]
    choices = f"{', '.join(listed[:-1])} or {listed[-1]}" if len(listed) > 1 else listed[0]
    unit = NUMBER.sub("", text, count=1) if NUMBER.match(text) else text
    if not unit or len(text) > 40 or UNIT.sub("", unit) or unit.count("^") + unit.count("**") > 1:
        raise ValueError(f"write {choices}, not '{text}'")  # nor does pint get powers of powers, which take for ever
    import pint

    try:
        quantity_written = _registry().Quantity(text)
        for quantity in QUANTITIES[kind]:
            base = quantity_written.to_base_units()
            if quantity == "angle" and str(base.units) != "radian":
                continue  # pint counts per cents and revolutions a minute among the angles
            if quantity_written.is_compatible_with(si := next(iter(COMMON[quantity]))):
                factor = float(quantity_written.to(si).magnitude)
                if factor and math.isfinite(factor):
                    return quantity, factor
    except (pint.PintError, ArithmeticError, AttributeError, TypeError, ValueError, SyntaxError):
        pass
    except Exception as error:
        if type(error).__module__ not in ("tokenize", "builtins"):  # accepted by pint's parser
            raise
    raise ValueError(f"write {choices}, or another unit of {' or '.join(QUANTITIES[kind])}, not '{text}'")


@cache
def _registry() -> Any:
    import pint

    return pint.UnitRegistry(cache_folder=None)


class WrenchUnits(Keys):
    """Units of measured wrenches."""

    force: Annotated[str, checked_unit("force")] = "N"
    moment: Annotated[str, checked_unit("torque")] = "N m"

    def scale(self, wrench: Wrench) -> list[float]:
        """Return the factors to SI units of a wrench's columns."""
        return [si_factor(self.force, "force")] * 3 + [si_factor(self.moment, "torque")] * (3 if wrench.moment else 0)


class BaseUnits(Keys):
    """Unit of the position of a base."""

    length: Annotated[str, checked_unit("position", "length")] = "m"

    def scale(self, base: BaseColumns) -> list[float]:
        """Return the factors to SI units of the pose's columns."""
        lengths = [si_factor(self.length, "position")] * len(base.position or ())
        return lengths + [1.0] * (len(base.pose) - len(lengths))


class PoseUnits(Keys):
    """Units of the lengths and the angles of a pose."""

    length: Annotated[str, checked_unit("position", "length")] = "m"
    angle: Annotated[str, checked_unit("position", "angle")] = "rad"

    def scale(self, pose: PoseColumns) -> list[float]:
        """Return the factors to SI units of the pose's columns."""
        angles = 3 if pose.rotation_vector else 0 if pose.angles is None else len(pose.angles.columns)
        length, angle = si_factor(self.length, "position"), si_factor(self.angle, "position")
        return [length] * len(pose.position) + [angle] * angles + [1.0] * (4 if pose.quaternion else 0)


def _one_or_by_joint(kind: Kind) -> Any:
    text = Annotated[str, checked_unit(kind, shares=kind in ("current", "torque"))]
    return Annotated[
        Annotated[text, Tag("text")] | Annotated[dict[str, text], Tag("group")], Discriminator(text_or_group)
    ]


SIDE = {signal.key: Literal[signal.units] for signal in SIDE_SIGNALS}


class Units(optional_keys(_one_or_by_joint("torque"), SIDE), Keys):  # type: ignore[misc]
    """Units of the log's columns, or the quantity per logged count (``0.0012 A``); SI by default.

    ``joint_torque`` is the unit of the torque sensors. ``rated`` are the rated currents (A) or torques (N m, N) of
    which ``%`` and ``‰`` are shares.
    """

    time: Annotated[str, checked_unit("time")] | None = None
    position: _one_or_by_joint("position") | None = None  # type: ignore[valid-type]
    current: _one_or_by_joint("current") | None = None  # type: ignore[valid-type]
    torque: _one_or_by_joint("torque") | None = None  # type: ignore[valid-type]
    rated: dict[str, Positive] = Field(default_factory=dict)
    base: BaseUnits = BaseUnits()
    pose: PoseUnits = PoseUnits()
    wrenches: WrenchUnits = WrenchUnits()

    @model_validator(mode="after")
    def _rated_values_of_shares(self) -> Units:
        command_units = self.current if self.torque is None else self.torque
        units = command_units.values() if isinstance(command_units, dict) else [command_units]
        if self.rated and not any(unit in SHARES for unit in units):
            raise ValueError("'rated' is given, but no unit is '%' or '‰'; remove it, or give that unit")
        if not self.rated and any(unit in SHARES for unit in units):
            raise ValueError(
                "a unit is relative to the rated value, which is missing; add 'rated: {JOINT: ...}' in A (N m, N)"
            )
        return self

    def position_unit(self, joint: str) -> str | None:
        """Return the position unit of a joint; None where nothing is stated."""
        return _unit(self.position, joint)

    def scale(self, signals: Signals) -> tuple[list[float], list[float], float]:
        """Compute factors to SI for the columns of positions and base pose, for all measured columns, and for the time.

        Raises GtauError where a share of a rated value is logged, but the rated value is not given.
        """
        positions = [si_factor(self.position_unit(joint) or "rad", "position") for joint in signals.position]
        positions += self.base.scale(signals.base) if signals.base else []
        commands = [self._command_factor(joint, signals) for joint in signals.position]
        for kind in LINK_SIDE:
            units = getattr(self, kind.calibration)
            commands += [si_factor(_unit(units, joint) or "N m", "torque") for joint in signals.sensors(kind)]
        commands += [factor for wrench in signals.all_wrenches for factor in self.wrenches.scale(wrench)]
        preset = PRESETS[signals.preset] if signals.preset else {}
        return positions, commands, si_factor(self.time or preset.get("units", {}).get("time", "s"), "time")

    def _command_factor(self, joint: str, signals: Signals) -> float:
        unit = _unit(self.current if signals.kind == "current" else self.torque, joint)
        ratio = (signals.gear_ratio or {}).get(joint, 1.0)
        if unit is None:
            return ratio
        if unit not in SHARES:
            return ratio * si_factor(unit, signals.kind)
        if joint not in self.rated:
            raise Document("units", {}).error(
                ("rated",), f"joint '{joint}' has no rated {signals.kind}, to which its column is relative; add it"
            )
        return ratio * SHARES[unit] * self.rated[joint]


def _unit(units: str | dict[str, str] | None, joint: str) -> str | None:
    return units.get(joint) if isinstance(units, dict) else units


def refuse_unstated_units(files: Sequence[LogTable], signals: Signals, units: Units) -> None:
    """Refuse columns whose unit, by name or log, is not SI if the experiment file states none; raises GtauError."""
    written = {name: unit for file in files for name, unit in file.units.items()}
    columns = [("position", *pair) for pair in signals.position.items()]
    columns += [(signals.kind, *pair) for pair in signals.command.items()]
    columns += [(kind.calibration, *pair) for kind in LINK_SIDE for pair in signals.sensors(kind).items()]
    if len(signals.time_columns) == 1 and "units" not in PRESETS.get(signals.preset or "", {}):
        columns += [("time", "", column) for column in signals.time_columns]
    for key, joint, column in columns:
        unit = parse_column_name(column, [joint] if joint else [], written.get(column)).unit
        if unit and unit not in SI and _unit(getattr(units, key), joint) is None:
            raise GtauError(
                f"column '{column}' is in '{unit}' by the log, but the experiment file states no unit; write units: "
                f"{{{key}: {unit}}}, or the SI unit if the log is wrong. Of counts state the size of one, as in "
                "'0.0012 A'; of shares the rated values, too.",
                source=files[0].path,
            )
