"""What a user states besides columns and logs: payloads (also in file names), gains, data sheets, settings, limits."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal
from unicodedata import normalize

import numpy as np
from pydantic import BeforeValidator, Field, FiniteFloat, field_validator, model_validator

from gtau.documents.validation import MAPPING, Keys, Number, Positive, expect, name_problem, read_group
from gtau.errors import GtauError
from gtau.findings import Finding, Grade
from gtau.robots.parameter import Parameter, torque_unit, unit_of
from gtau.robots.robot import INERTIAL, Robot

FIRST_MOMENTS = ("mx", "my", "mz")
PAYLOAD_KINDS = ("m", *FIRST_MOMENTS, *INERTIAL[:6])
"""Kinds in the order in which they are shown: what people ask for first."""


class Payload(Keys):
    """A load on the robot's tool; without ``mass`` it is unknown and will be estimated.

    ``mass`` and its standard deviation in kg; ``parameters`` are further known inertial parameters
    (``xx xy xz yy yz zz`` in kg m2, ``mx my mz`` in kg m) in the frame of the body that carries it; ``center`` is the
    centre of an unknown mass in that frame, m.
    """

    name: str
    mass: Positive | None = None
    mass_std: Annotated[Number, Field(ge=0)] = 0.0
    parameters: dict[str, Number] = Field(default_factory=dict)
    center: tuple[Number, Number, Number] | None = None

    @field_validator("name")
    @classmethod
    def _printable(cls, name: str) -> str:
        if problem := name_problem(name):
            raise ValueError(problem)
        return name

    @field_validator("parameters")
    @classmethod
    def _inertial(cls, parameters: dict[str, float]) -> dict[str, float]:
        for name in parameters:
            if name == "m":
                raise ValueError("write the mass as 'mass', not among the parameters")
            if name not in INERTIAL:
                raise ValueError(f"a payload has no parameter '{name}'; choose from {' '.join(INERTIAL[:-1])}")
        return parameters

    @model_validator(mode="after")
    def _possible(self) -> Payload:
        if problem := _no_body(self.parameters, self.mass):
            raise ValueError(f"{problem}, which no body has; correct the parameters (at the frame's origin, SI units)")
        if self.mass is None and "mass_std" in self.model_fields_set:
            raise ValueError("'mass_std' is given without 'mass'; add the mass or remove it")
        if self.center is None:
            return self
        if twice := [kind for kind in FIRST_MOMENTS if kind in self.parameters]:
            raise ValueError(f"'center' and '{twice[0]}' of the parameters state the same; remove one of them")
        if self.mass is not None:
            moments = ", ".join(f"{k}: {self.mass * c:z.6g}" for k, c in zip(FIRST_MOMENTS, self.center, strict=True))
            raise ValueError(f"'center' is for an unknown mass; for a known one write 'parameters: {{{moments}}}'")
        return self


ROUNDED = 0.01  # of a moment of inertia: what people round


def _no_body(parameters: Mapping[str, float], mass: float | None) -> str:
    """Say which of the inertial parameters (at the frame's origin) no body can have; empty if all are possible."""
    x, y, z = (parameters.get(kind, 0.0) for kind in FIRST_MOMENTS)
    axes = {"xx": ("yy", "zz", "yz", y, z), "yy": ("xx", "zz", "xz", x, z), "zz": ("xx", "yy", "xy", x, y)}
    for kind, (first, second, product, a, b) in axes.items():
        moment = parameters.get(kind)
        if moment is None:
            continue
        least = (a * a + b * b) / mass if mass else 0.0
        if moment < 0 or moment < (1 - ROUNDED) * least:
            return f"{kind} is {moment:g} kg m2" + (f", and {least:.3g} by mass and centre alone" if least else "")
        most = parameters.get(first, np.inf) + parameters.get(second, np.inf)
        if moment > (1 + ROUNDED) * most:
            return f"{kind} is {moment:g} kg m2, and {first} and {second} together {most:g}"
        if 2 * abs(parameters.get(product, 0.0)) > (1 + ROUNDED) * moment:
            return f"{product} is {parameters[product]:g} kg m2, and {kind} {moment:g}"
    return ""


def as_payload(payload: Payload | Mapping[str, Any] | str | float | None) -> Payload | None:
    """Read a payload from a mapping as in the experiment file; raises GtauError."""
    if isinstance(payload, (str, float, int)):
        name, mass = (repr(payload), "...") if isinstance(payload, str) else ("'load'", f"{payload:g}")
        raise GtauError(f"a payload has keys; did you mean payload={{'name': {name}, 'mass': {mass}}}?")
    return None if payload is None else read_group(Payload, "payload", payload)


# None where a file says "payload: none", null or {}
CarriedPayload = Annotated[Payload | None, BeforeValidator(lambda load: None if load in ("none", "null", {}) else load)]


class Prior(Keys):
    """Prior of a standard parameter, SI units: a value with its standard deviation, or bounds."""

    value: Number | None = None
    std: Positive | None = None
    min: Number | None = None
    max: Number | None = None

    @model_validator(mode="after")
    def _complete(self) -> Prior:
        if (self.value is None) != (self.std is None):
            raise ValueError("give 'value' and 'std' (its standard deviation) together")
        if self.min is not None and self.max is not None and self.min >= self.max:
            raise ValueError(f"'min' is {self.min:g} and 'max' {self.max:g}; write the smaller one as 'min'")
        return self


class StatedGain(Keys):
    """Drive gain of a joint, N m/A or N per A, with its standard deviation where that is known."""

    value: Number
    std: Positive | None = None


GainEntry = Annotated[
    StatedGain, BeforeValidator(lambda gain: gain if isinstance(gain, dict | StatedGain) else {"value": gain})
]
"""A gain of an experiment file, which may be a number alone."""


def as_priors(priors: Mapping[str, Prior | Mapping[str, Any]]) -> dict[str, Prior]:
    """Read priors by parameter from mappings as in the experiment file; raises GtauError."""
    expect("'priors'", priors, MAPPING)
    return {str(name): read_group(Prior, f"prior of {name}", prior) for name, prior in priors.items()}


TOLERANCE = 0.1  # standard deviation of a torque constant or rotor inertia: data sheets state tolerances of 10 %
EFFICIENCY = 0.85  # of a gear without stated efficiency: 0.65 to 1 is within two standard deviations
EFFICIENCY_STD = 0.1


class Drive(Keys):
    """A motor and its gear, from their data sheets.

    ``gear_ratio`` is rad of the motor per rad (or m) of the joint, negative where they turn in opposite directions;
    ``torque_constant`` (N m/A) and ``rotor_inertia`` (kg m2) belong to the motor; ``uncertainty`` is the relative
    standard deviation of the expected values. Of logged voltages ``convention`` says what they and the currents are:
    of a DC motor, or of the q axis, of invariant ``amplitude`` or ``power``; ``commutation`` is the relative standard
    deviation of the torque constant over the back-EMF constant, and ``resistance`` (ohm) replaces a supply voltage.
    """

    gear_ratio: Number = 1.0
    torque_constant: Positive | None = None
    efficiency: Annotated[FiniteFloat, Field(gt=0, le=1)] | None = None
    rotor_inertia: Positive | None = None
    uncertainty: Annotated[FiniteFloat, Field(gt=0, lt=1)] | None = None
    convention: Literal["dc", "amplitude", "power"] = "dc"
    commutation: Annotated[FiniteFloat, Field(gt=0, lt=1)] | None = None
    resistance: Positive | None = None

    @field_validator("gear_ratio")
    @classmethod
    def _turns(cls, ratio: float) -> float:
        if not ratio:
            raise ValueError("the gear ratio is zero; write rad of the motor per rad (or m) of the joint")
        return ratio

    @model_validator(mode="after")
    def _says_something(self) -> Drive:
        electrical = self.model_fields_set & {"convention", "commutation", "resistance"}
        if self.torque_constant is None and self.rotor_inertia is None and not electrical:
            raise ValueError("neither 'torque_constant' nor 'rotor_inertia' is given; add one, or remove the drive")
        if self.efficiency is not None and self.torque_constant is None:
            raise ValueError("'efficiency' is given without 'torque_constant'; add it, or remove the efficiency")
        return self

    @property
    def gain(self) -> tuple[float, float] | None:
        """Gain expected at the joint, N m/A or N per A, and its standard deviation."""
        if self.torque_constant is None:
            return None
        spread = 0.0 if self.efficiency else EFFICIENCY_STD / EFFICIENCY
        value = self.gear_ratio * self.torque_constant * (self.efficiency or EFFICIENCY)
        return value, abs(value) * (self.uncertainty or float(np.hypot(TOLERANCE, spread)))

    @property
    def inertia(self) -> tuple[float, float] | None:
        """Rotor inertia ``ia`` expected at the joint, kg m2 or kg, and its standard deviation."""
        if self.rotor_inertia is None:
            return None
        value = self.gear_ratio**2 * self.rotor_inertia
        return value, value * (self.uncertainty or TOLERANCE)


def check_drives(drives: Mapping[str, Drive], robot: Robot) -> None:
    """Refuse data-sheet gears that the robot's couplings already contain; raises GtauError."""
    for joint, drive in drives.items():
        if robot.joint(joint).parameters == "drive" and drive.gear_ratio != 1.0:
            raise GtauError(
                f"drives.{joint}.gear_ratio is {drive.gear_ratio:g}, but '{joint}' is the shaft of a motor, whose "
                f"gear ratio is in the couplings of robot '{robot.name}'; leave 'gear_ratio' out."
            )


def data_sheet_notes(
    drives: Mapping[str, Drive], robot: Robot, estimates: Mapping[str, tuple[float | None, float | None]]
) -> Iterator[Finding]:
    """Compare estimates of gains and ``ia``, their values and standard deviations by name, with data sheets."""
    for joint, drive in drives.items():
        for what, sheet, kind in (("gain", drive.gain, "gain"), ("rotor inertia", drive.inertia, "ia")):
            value, std = estimates.get(Parameter(kind, joint), (None, None))
            if sheet is None or value is None:
                continue
            expected, spread = sheet
            unit = f"{torque_unit(robot, joint)}/A" if kind == "gain" else unit_of(kind, robot, joint)
            apart = float(abs(value - expected) / np.hypot(spread, std or 0.0))
            text = (
                f"{what} of '{joint}': {value:.4g} {unit} was identified, and {expected:.4g} {unit} is by the data "
                f"sheet (standard deviation {spread:.2g}; apart by {apart:.1f} standard deviations)"
            )
            yield Finding("data sheet", (joint,), text=text, grade=Grade.INFORMATION)


class PreparationSettings(Keys):
    """The key ``preparation`` of an experiment file; missing entries are chosen from the logs.

    ``bandwidth`` of the motion and cut-off of the ``position_filter`` in Hz; ``decimation``: samples of the slowest log
    per row; ``delay`` (s) of currents or torques behind the positions, which is compensated; ``least_speed``: share of
    a joint's rms speed below which rows are left out; ``clock``: whether samples were taken at their ``stamps``, or at
    a ``regular`` rate and stamped late.
    """

    bandwidth: Positive | None = None
    position_filter: Positive | Literal["none"] | None = None
    decimation: Annotated[int, Field(ge=1, le=1000)] | None = None
    delay: FiniteFloat = 0.0
    least_speed: Annotated[FiniteFloat, Field(ge=0, lt=1)] | None = None
    clock: Literal["stamps", "regular"] | None = None

    @property
    def given(self) -> tuple[str, ...]:
        """Names of the settings made by hand, in the order of the class."""
        return tuple(name for name in type(self).model_fields if name in self.model_fields_set)


CHOSEN = PreparationSettings()


def _per_cent(value: Any) -> Any:
    """Read ``5 %`` as 5; a bare number could be a share."""
    match = re.fullmatch(r"\s*([0-9.eE+-]+)\s*%\s*", value) if isinstance(value, str) else None
    if match is None:
        raise ValueError(f"write per cent, such as '{value} %', if that is what '{value}' means")
    return match[1]


Percent = Annotated[FiniteFloat, Field(gt=0), BeforeValidator(_per_cent)]


class Tolerances(Keys):
    """Changes since the identification that are accepted of a watched robot.

    ``gain`` and ``friction`` are relative, ``load`` is in kg (or 2 % of ``rated_payload``), ``zero`` in degrees or mm.
    """

    gain: Positive = 0.05
    friction: Positive = 0.3
    load: Positive | None = None
    rated_payload: Positive | None = None
    zero: Positive = 0.5
    delay: Positive = 0.005

    @property
    def mass(self) -> float:
        """Accepted undeclared load, kg."""
        rated = None if self.rated_payload is None else 0.02 * self.rated_payload
        return self.load or rated or 0.3


class Requirements(Keys):
    """Limits on the result, per cent.

    ``torque_error`` holds for every joint over the rows used, and on each run kept for validation; ``gain_interval``
    for half the 95 % interval of every drive gain.
    """

    torque_error: Percent | None = None
    gain_interval: Percent | None = None


MASS_UNITS = {"kg": 1.0, "kilo": 1.0, "g": 1e-3, "lb": 0.45359237, "pound": 0.45359237, "oz": 0.45359237 / 16}
MASS = re.compile(
    r"(?P<point>[.,]?)(?<!\d)(?P<number>\d+(?:(?:[-.,·_ p]|dot|pt)\d+)*)[-_ ]?"
    r"(?P<unit>kg(?![fm]|cm)|kilos?(?![a-z])|kilogram|(?:g|gr|gms?|grams?|grammes?|gramm)(?![a-z])|lbs?(?![a-z])|pounds?"
    r"|oz(?![a-z]))(?P<rest>\d(?![\d.,]*[-_ ]?(?:kg|g|lb|oz)(?![a-z])))?",
    re.IGNORECASE | re.ASCII,
)
# before a number: words for none, or a sum, product, fraction or power, of which the number is a part
DOUBT = re.compile(
    r"(?<![a-z])(?:no|non|without|wo|sans|ohne|un)[-_ ]?(?:(?:pay)?load(?:ed)?|mass|weight)?[-_ ]*$"
    r"|\d ?[+x*×/⁄] ?$|\de[+-]?$",
    re.IGNORECASE,
)
DATE = re.compile(
    r"(?<!\d)20\d\d([-_.]?)[01]\d\1[0-3]\d(?:[-_T ][0-2]\d[-_.:h]?[0-5]\d(?:[-_.:]?[0-5]\d)?(?=[-_ ]))?(?!\d)"
)
DECIMAL = (".", ",", "·", "p", "dot", "pt")  # between digits; others may also separate a number from what precedes it
LEAST, MOST = 0.01, 1e3  # kg; of a payload. Less may be an acceleration (0.5g), more a time or a count


def masses_in_name(name: str) -> tuple[float, ...]:
    """Read the mass, kg, from the name of a log: no reading, one, or several from which the user must choose.

    ``1,5kg``, ``1p5kg`` and ``1500g`` have one; ``loaded_1_5kg`` may be 1.5 kg or log 1 with 5 kg. A mass that is too
    small or too large may mean no payload (0), as may ``no_5kg``, and a number that is no mass alone (``2x1.25kg``).
    """
    name = DATE.sub(" ", normalize("NFKC", name))
    matches = list(MASS.finditer(name))
    readings = [_readings(match) for match in matches]
    masses = [mass for several in readings for mass in several]
    if len(matches) > 1:
        masses.append(round(sum(several[0] for several in readings), 6))
    if any(match["rest"] or DOUBT.search(name[: match.start()]) for match in matches):
        masses.append(0.0)
    likely = [mass for mass in masses if mass == 0 or LEAST <= mass <= MOST]
    return tuple(dict.fromkeys(likely or [*masses, *[0.0] * bool(masses)]))


def _readings(match: re.Match[str]) -> list[float]:
    """List the masses, kg, that a number and its unit may mean, the likeliest first."""
    factor = next(size for unit, size in MASS_UNITS.items() if match["unit"].lower().startswith(unit))
    *before, last = re.split(r"(\D+)", match["number"])
    integer, separator = before[-2:] if before else ("", "")
    texts = []
    if integer and (separator in DECIMAL or integer == "0" or integer[0] != "0"):
        texts.append(f"{integer}.{last}")
    if len(last) == 3 and factor < 0.01 and integer and integer[0] != "0":
        texts.append(integer + last)  # thousands of grams
    if before[-3:-2] in ([","], ["."]) and len(integer) == 3:
        texts.append(f"{before[-4]}{integer}.{last}")  # 1.200,5
    if separator not in DECIMAL or (len(before) > 2 and before[-3] in DECIMAL):
        texts.append(last)
    if match["point"] and not integer:
        texts.append(f"0.{last}")
    return [round(float(text) * factor, 6) for text in texts]
