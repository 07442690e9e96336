"""Units: factors to SI, by pint outside ``COMMON``, and units as recorders write them.

Those become units of an experiment file (``mN m``), which refuses counts and unknown units: none is ignored.
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import AfterValidator, Discriminator, Field, Tag, model_validator

from gtau.documents.markup import Document, own_table
from gtau.documents.validation import Keys, Positive, text_or_group
from gtau.signals.channel import LINK_SIDE, SIDE_SIGNALS, SideSignal
from gtau.signals.reading.body_columns import BaseColumns, PoseColumns
from gtau.signals.reading.columns import PRESETS, SENSORS, Signals, optional_keys

Kind = Literal["time", "position", "current", "torque", "force"]

COMMON: dict[str, dict[str, float]] = {  # units of nearly all logs, without the half second that pint takes to import
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "angle": {"rad": 1.0, "deg": math.pi / 180},
    "length": {"m": 1.0, "mm": 1e-3},
    "current": {"A": 1.0, "mA": 1e-3},
    "torque": {"N m": 1.0, "Nm": 1.0},
    "force": {"N": 1.0},
}
QUANTITIES = {"position": ("angle", "length"), "torque": ("torque", "force")}  # kinds that measure two
SI = frozenset(["s", "rad", "m", "A", "N m", "N"])
SHARES = {"%": 1e-2, "‰": 1e-3}  # of the rated current or torque
SIZE = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d{1,2})?\s*", re.IGNORECASE)
UNIT = re.compile(r"[^\W\d_][^\W\d_/*^· -]*|[/*^· -]+|\d\b|[()]|°")


def si_factor(text: str, kind: Kind) -> float:
    """Convert a unit, or a quantity such as ``0.0012 A`` (of one count), to the SI unit of its kind; or ValueError."""
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


def _measured(text: str, kind: Kind) -> tuple[str, float]:
    quantities = QUANTITIES.get(kind, (kind,))
    for quantity in quantities:
        if text in COMMON[quantity]:
            return quantity, COMMON[quantity][text]
    if re.fullmatch(PEAK, re.sub(r"[\W_]", "", text).lower()):
        raise ValueError(
            f"'{text}' is an amplitude; write 'A' for gains per ampere of amplitude, or '0.70711 A' for gains per "
            "ampere rms, of which data sheets give torque constants (of mA a thousandth)"
        )
    names = [repr(name) for quantity in quantities for name in COMMON[quantity] if name != "Nm"]
    choices = " or ".join(filter(None, [", ".join(names[:-1]), names[-1]]))
    unit = SIZE.sub("", text, count=1) if SIZE.match(text) else text
    if not unit or len(text) > 40 or UNIT.sub("", unit) or unit.count("^") + unit.count("**") > 1:
        raise ValueError(f"write {choices}, not '{text}'")  # nor does pint get powers of powers, which take for ever
    with suppress(Exception):  # pint's parser raises what it likes
        written = _registry().Quantity(text)
        base = str(written.to_base_units().units)
        for quantity in quantities:
            if quantity == "angle" and base != "radian":
                continue  # pint counts per cents and revolutions a minute among the angles
            si = next(iter(COMMON[quantity]))
            if written.is_compatible_with(si):
                factor = float(written.to(si).magnitude)
                if factor and math.isfinite(factor):
                    return quantity, factor
    raise ValueError(f"write {choices}, or another unit of {' or '.join(quantities)}, not '{text}'")


@cache
def _registry() -> Any:
    import pint

    return pint.UnitRegistry(cache_folder=None)


def _checked(kind: Kind, quantity: str = "", shares: bool = False) -> AfterValidator:
    """Make the validator of units of a kind and, for positions, of a ``quantity``; ``shares`` may be allowed."""

    def checked(text: str) -> str:
        if shares and text in SHARES:
            return text
        measures, factor = _measured(text, kind)
        if quantity and measures != quantity:
            raise ValueError(f"'{text}' is not a unit of {quantity}; write {' or '.join(COMMON[quantity])}")
        # by its name in COMMON, as checks compare names
        return next((unit for unit, size in COMMON[measures].items() if math.isclose(size, factor)), text)

    return AfterValidator(checked)


Length = Annotated[str, _checked("position", "length")]


class WrenchUnits(Keys):
    """Units of measured wrenches."""

    force: Annotated[str, _checked("force")] = "N"
    moment: Annotated[str, _checked("torque")] = "N m"


class BaseUnits(Keys):
    """Unit of the position of a base."""

    length: Length = "m"

    def scale(self, base: BaseColumns) -> list[float]:
        """Return the factors to SI units of the pose's columns."""
        lengths = [si_factor(self.length, "position")] * len(base.position or ())
        return lengths + [1.0] * (len(base.pose) - len(lengths))


class PoseUnits(Keys):
    """Units of the lengths and the angles of a pose."""

    length: Length = "m"
    angle: Annotated[str, _checked("position", "angle")] = "rad"

    def scale(self, pose: PoseColumns) -> list[float]:
        """Return the factors to SI units of the pose's columns."""
        angles = 3 if pose.rotation_vector else len(pose.angles.columns) if pose.angles else 0
        lengths = [si_factor(self.length, "position")] * len(pose.position)
        return lengths + [si_factor(self.angle, "position")] * angles + [1.0] * (4 if pose.quaternion else 0)


def _one_or_by_joint(kind: Kind) -> Any:
    text = Annotated[str, _checked(kind, shares=kind in ("current", "torque"))]
    return Annotated[
        Annotated[text, Tag("text")] | Annotated[dict[str, text], Tag("group")], Discriminator(text_or_group)
    ]


Optional = dict.fromkeys(SENSORS, _one_or_by_joint("torque"))


def _side_unit(signal: SideSignal) -> Any:
    """Make the type of a side signal's unit: one of its own, or of a fast one the quantity of a count in it."""
    if signal.slow:
        return Literal[signal.units]

    def checked(text: str) -> str:
        size, _, unit = text.rpartition(" ")
        if unit not in signal.units or (size and not SIZE.fullmatch(size)):
            raise ValueError(f"write {' or '.join(signal.units)}, or the quantity of a count, not '{text}'")
        return text

    return Annotated[str, AfterValidator(checked)]


Optional |= {signal.key: _side_unit(signal) for signal in SIDE_SIGNALS}


class Units(optional_keys(Optional)):  # type: ignore[misc]
    """Units of the log's columns, or the quantity per logged count (``0.0012 A``); SI by default.

    ``joint_torque`` is the unit of the torque sensors. ``rated`` are the rated currents (A) or torques (N m, N) of
    which ``%`` and ``‰`` are shares.
    """

    time: Annotated[str, _checked("time")] | None = None
    position: _one_or_by_joint("position") | None = None  # type: ignore[valid-type]
    current: _one_or_by_joint("current") | None = None  # type: ignore[valid-type]
    torque: _one_or_by_joint("torque") | None = None  # type: ignore[valid-type]
    rated: dict[str, Positive] = Field(default_factory=dict)
    base: BaseUnits = BaseUnits()
    pose: PoseUnits = PoseUnits()
    wrenches: WrenchUnits = WrenchUnits()

    @model_validator(mode="after")
    def _rated_values_of_shares(self) -> Units:
        of_commands = self.current if self.torque is None else self.torque
        units = of_commands.values() if isinstance(of_commands, dict) else [of_commands]
        shares = any(unit in SHARES for unit in units)
        if self.rated and not shares:
            raise ValueError("'rated' is given, but no unit is '%' or '‰'; remove it, or give that unit")
        if shares and not self.rated:
            raise ValueError(
                "a unit is relative to the rated value, which is missing; add 'rated: {JOINT: ...}' in A (N m, N)"
            )
        return self

    def stated(self, key: str, joint: str) -> str | None:
        """Return the unit of a joint's column under a key; None where none is stated."""
        units: str | dict[str, str] | None = getattr(self, key)
        return units.get(joint) if isinstance(units, dict) else units

    def position_unit(self, joint: str) -> str | None:
        """Return the position unit of a joint; None where nothing is stated."""
        return self.stated("position", joint)

    def scale(self, signals: Signals) -> tuple[list[float], list[float], float]:
        """Compute factors to SI for the columns of positions and base pose, all measured columns, and the time."""
        positions = [si_factor(self.position_unit(joint) or "rad", "position") for joint in signals.position]
        if signals.base:
            positions += self.base.scale(signals.base)
        commands = [self._command_factor(joint, signals) for joint in signals.position]
        for kind in LINK_SIDE:
            units = (self.stated(kind.calibration, joint) or "N m" for joint in signals.sensors(kind))
            commands += [si_factor(unit, "torque") for unit in units]
        force = si_factor(self.wrenches.force, "force")
        moment = si_factor(self.wrenches.moment, "torque")
        for wrench in signals.all_wrenches:
            commands += [force] * 3 + [moment] * len(wrench.moment or ())
        preset = PRESETS[signals.preset] if signals.preset else {}
        return positions, commands, si_factor(self.time or preset.get("units", {}).get("time", "s"), "time")

    def _command_factor(self, joint: str, signals: Signals) -> float:
        unit = self.stated(signals.kind, joint)
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


SPELLINGS = own_table(__file__, "units.yaml")
UNITS = {
    spelling: (what, unit)
    for what, units in SPELLINGS.items()
    for unit, spellings in units.items()
    for spelling in spellings.split()
}
LONGEST = 40  # characters
PEAK = "m?a(pk|peak|0pk?|amp|ampl|amplitude)"
PATTERNS = {  # of units that no experiment file takes, by what they measure
    "acceleration": re.compile(r".*/(s\^?2|sec2|s\*\*2|s/s|min/s)"),
    "velocity": re.compile(r"rpm|rps|dps|\D*(/|per)(s|sec|min)|(min|s)\^?1|1/(min|s)"),
    None: re.compile(
        r"(inc|ink|inkr|incr|increment|inkremente?|count|cnt|ct|tick|pulse?|step|digit)s?|pls|lsb|raw|adc|u"
        rf"|{PEAK}"
    ),
}
NUMBER = re.compile(r"[x×*]?\s*(\d+(?:[.,]\d+)?(?:e-?\d+)?)(?:/(\d+))?\s*[x×*]?\s*(.*)", re.IGNORECASE)
WORDS = (  # of names, where they cannot mean anything else: no single letter, and no degs, which may be deg/s
    "deg|degrees?|[cm]deg|rad|radians?|mrad|turns?|revs?|rotations?|mm|cm|mA|milliamp(?:ere)?s?|amps|(?:m|c|k|da)?Nm|N[cm]m|kgf?_?cm|"
    "oz_?in|A_?pk|A_?peak|ms|msecs?|us|usecs?|ns|rpm|counts?|cnts?|ticks?|incs?|inkr|increments?|pct|percent|permille|lsb"
)
WORD = re.compile(
    rf"(?:(?<![A-Za-z])|(?-i:(?<=[a-z])(?=[A-Z])))({WORDS}|%|‰)(?:[_ ]?(?:/|per)?[_ ]?(s|sec|min)(\^?2)?)?(?![A-Za-z])",
    re.IGNORECASE,
)
# brackets that may hold an unknown unit: a single letter may be a joint
ODD = re.compile(r"(?<=[\s\d#])\[([^\[\]]{0,30}[^\[\]\s\d][^\[\]]{1,30})\]\s*$")
# As physicists label axes, q/deg and i/mA: the last of two parts, and no single letter, which may be a joint
QUOTIENT = re.compile(r"[^/]+?\s*/\s*([^/\W\d_]{2,}|[°%‰])")


class WrittenUnit(NamedTuple):
    """A unit in the form of an experiment file, or as written; it measures a key of SPELLINGS or PATTERNS, if known."""

    measures: str | None
    text: str


def read_unit(text: str) -> WrittenUnit | None:
    """Read a unit, or the quantity of one count (``0.01A``); None if the text is neither."""
    if len(text) > LONGEST:
        return None
    plain = unicodedata.normalize("NFKC", text.replace("º", "°")).replace("μ", "u").strip()
    key = re.sub(r"\s" if plain[:1].isdigit() else r"[\s·⋅._*-]", "", plain).lower()
    if key in UNITS:
        return WrittenUnit(*UNITS[key])
    for measures, pattern in PATTERNS.items():
        if pattern.fullmatch(key):
            return WrittenUnit(measures, text.strip())
    number = NUMBER.fullmatch(plain)
    unit = read_unit(number[3]) if number and number[3] else None
    if number is None or unit is None:
        return None
    if unit.measures not in SPELLINGS:
        return WrittenUnit(unit.measures, text.strip())
    size = float(number[1].replace(",", ".")) / (float(number[2] or 1) or 1.0)
    return WrittenUnit(unit.measures, f"{size:g} {unit.text}")


def split_unit(name: str, remarks: frozenset[str] = frozenset()) -> tuple[str, WrittenUnit | None]:
    """Split a column's name into the rest and its unit, in brackets, after a stroke, or else a word.

    Brackets at the end may hold an unknown unit, unless one of the words in them is a remark.
    """
    for match in reversed(list(re.finditer(r"([\[(])([^\[\]()]*)[\])]", name))):
        remark = match[1] == "(" and re.fullmatch(r"\s*[a-z]\s*", match[2])  # measured, set, actual
        if not remark and (unit := read_unit(match[2])):
            return name[: match.start()].rstrip(" /") + name[match.end() :], unit
    if (odd := ODD.search(name)) and remarks.isdisjoint(re.findall(r"[a-z]{2,}|°", odd[1].lower())):
        return name[: odd.start()], WrittenUnit(None, odd[1])
    if (quotient := QUOTIENT.fullmatch(name)) and (unit := read_unit(quotient[1])):
        return name[: quotient.start(1)].rstrip("/ "), unit
    words = list(WORD.finditer(name))
    if not words:
        return name, None
    word = words[-1]
    unit = read_unit(word[1].replace("_", ""))
    if word[2]:
        unit = WrittenUnit("acceleration" if word[3] else "velocity", word[0])
    return name[: word.start()].rstrip("_ .-") + name[word.end() :], unit


def unit_row(fields: Sequence[str], named: bool) -> list[str] | None:
    """Read the units in a row beside the names of columns; None if it holds none.

    Most of its fields are units, or stand in brackets; where all columns are ``named``, a unit of time comes first.
    """
    texts = [re.sub(r"^[\[(](.*)[\])]$", r"\1", field.strip()) for field in fields]
    likely = [text != field.strip() or read_unit(text) is not None for text, field in zip(texts, fields, strict=True)]
    texts = ["" if text.lower() in ("unit", "units", "einheit", "-", "1") else text for text in texts]
    likely = [is_likely for text, is_likely in zip(texts, likely, strict=True) if text]
    first = read_unit(texts[0]) if named else None
    return texts if 2 * sum(likely) > len(likely) or (first and first.measures == "time") else None
