"""Data sheets of motors and gears: gains and rotor inertias expected at the joints."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

import numpy as np
from pydantic import Field, FiniteFloat, field_validator, model_validator

from gtau.documents.validation import Keys, Positive
from gtau.errors import GtauError
from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.robots.parameter import Parameter
from gtau.robots.robot import Robot
from gtau.robots.units import torque_unit, unit_of

TOLERANCE = 0.1  # standard deviation of a torque constant or rotor inertia: data sheets state tolerances of 10 %
EFFICIENCY = 0.85  # of a gear without stated efficiency: 0.65 to 1 is within two standard deviations
EFFICIENCY_STD = 0.1


class Drive(Keys):
    """A motor and its gear, from their data sheets.

    ``gear_ratio`` is rad of the motor per rad (or m) of the joint, negative where they turn in opposite directions;
    ``torque_constant`` N m/A and ``rotor_inertia`` kg m2 are those of the motor; ``uncertainty`` is the relative
    standard deviation of the expected values.
    """

    gear_ratio: FiniteFloat = 1.0
    torque_constant: Positive | None = None
    efficiency: Annotated[FiniteFloat, Field(gt=0, le=1)] | None = None
    rotor_inertia: Positive | None = None
    uncertainty: Annotated[FiniteFloat, Field(gt=0, lt=1)] | None = None

    @field_validator("gear_ratio")
    @classmethod
    def _turns(cls, ratio: float) -> float:
        if ratio == 0:
            raise ValueError("the gear ratio is zero; write rad of the motor per rad (or m) of the joint")
        return ratio

    @model_validator(mode="after")
    def _says_something(self) -> Drive:
        if self.torque_constant is None and self.rotor_inertia is None:
            raise ValueError("neither 'torque_constant' nor 'rotor_inertia' is given; add one, or remove the drive")
        if self.efficiency is not None and self.torque_constant is None:
            raise ValueError("'efficiency' is given without 'torque_constant'; add it, or remove the efficiency")
        return self

    @property
    def gain(self) -> tuple[float, float] | None:
        """Gain expected at the joint, N m/A or N/A, and its standard deviation."""
        if self.torque_constant is None:
            return None
        efficiency = EFFICIENCY if self.efficiency is None else self.efficiency
        spread = 0.0 if self.efficiency is not None else EFFICIENCY_STD / EFFICIENCY
        value = self.gear_ratio * self.torque_constant * efficiency
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
    drives: Mapping[str, Drive], robot: Robot, found: Mapping[str, tuple[float | None, float | None]]
) -> tuple[Finding, ...]:
    """Compare estimates (value and standard deviation) of gains and ``ia`` with data sheets, one note for each.

    Parameters
    ----------
    drives : mapping
        By joint.
    robot : Robot
    found : mapping
        Identified values and standard deviations, of gains by ``gain_JOINT`` and of rotor inertias by ``ia_JOINT``.
    """
    said = []
    for joint, drive in drives.items():
        rows = (
            ("gain", drive.gain, Parameter("gain", joint), f"{torque_unit(robot, joint)}/A"),
            ("rotor inertia", drive.inertia, Parameter("ia", joint), unit_of("ia", robot, joint)),
        )
        for what, expected, name, unit in rows:
            value, std = found.get(name, (None, None))
            if expected is None or value is None:
                continue
            off = (value - expected[0]) / np.hypot(expected[1], std or 0.0)
            values = {"quantity": what, "value": value, "unit": unit, "stated": expected[0], "std": expected[1]}
            said.append(Finding(F.DATA_SHEET, (joint,), values={**values, "apart": float(abs(off))}))
    return tuple(said)
