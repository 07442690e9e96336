"""Source of a robot: its file, the pose of its base, and its selected joints."""

from __future__ import annotations

from math import isfinite
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Discriminator, FiniteFloat, Tag, field_validator

from gtau.documents.validation import Keys, Positive, text_or_group
from gtau.robots.placement import DEGREES_ADVICE, in_degrees
from gtau.robots.readers.expressions import evaluate

FLOATING: Literal["floating"] = "floating"
BASE_ADVICE = (
    "write 'robot: {file: ..., base: fixed}' in the experiment file ('gtau init' and 'gtau robot' have --base fixed) "
    "if the robot was hung up or bolted down, or 'base: floating' if its base moved and the motion is logged"
)


def _base(value: Any) -> Any:
    if value == "fixed":
        return {}
    if isinstance(value, str) and value != FLOATING:
        raise ValueError(
            f"write 'fixed', how the base is turned, '{{rpy: [roll, pitch, yaw]}}' in rad, or 'floating', not '{value}'"
        )
    return value


def angle(value: Any) -> Any:
    """Evaluate an angle, rad, written as a number or an expression; refuse what looks like degrees."""
    number = evaluate(value) if isinstance(value, str) else value
    if isinstance(number, int | float) and isfinite(number) and in_degrees(number):
        raise ValueError(f"{value} rad is more than a turn; {DEGREES_ADVICE}, such as deg({value})")
    return number


Angle = Annotated[FiniteFloat, BeforeValidator(angle)]


class Base(Keys):
    """A fixed base, at its pose in the file or turned by ``rpy`` in a world whose z axis points up."""

    rpy: tuple[Angle, Angle, Angle] | None = None


BaseChoice = Base | Literal["floating"] | None


class GivenLimits(Keys):
    """Limits of a joint, in SI units, which replace limits of the robot's file."""

    position: tuple[Angle, Angle] | None = None
    velocity: Positive | None = None
    acceleration: Positive | None = None
    effort: Positive | None = None

    @field_validator("position")
    @classmethod
    def _in_order(cls, position: tuple[float, float] | None) -> tuple[float, float] | None:
        if position is not None and position[0] >= position[1]:
            raise ValueError(
                f"the limits {position[0]:g} and {position[1]:g} are not in order; write the lower one first"
            )
        return position


GRAVITIES = {"none": ("0", "0", "0"), "moon": ("0", "0", "-1.62")}


def gravity_of(value: Any) -> Any:
    """Replace a word for gravity by the numbers, as text; raises ValueError."""
    value = GRAVITIES.get(value, value) if isinstance(value, str) else value
    if isinstance(value, str):
        raise ValueError(f"write three numbers, m/s2 in base axes, such as [0, 0, -9.81], moon or none, not '{value}'")
    return value


class RobotSource(BaseModel):
    """A robot's file or catalog name, with the selected joints and the pose of its base.

    ``base`` fixes a floating base, states how a fixed one is mounted, or lets it float. ``joints`` are patterns of the
    moving joints; the others are held, at the positions in ``held`` or at home. ``limits``, by joint, and ``gravity``,
    m/s2, replace values of the file; gravity is zero if the driver removes it from the logged torques.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    file: str
    base: Annotated[BaseChoice, BeforeValidator(_base)] = None
    joints: tuple[str, ...] = ()
    held: dict[str, FiniteFloat] = {}
    limits: dict[str, GivenLimits] = {}
    gravity: Annotated[tuple[FiniteFloat, FiniteFloat, FiniteFloat] | None, BeforeValidator(gravity_of)] = None


AnySource = Annotated[Annotated[str, Tag("text")] | Annotated[RobotSource, Tag("group")], Discriminator(text_or_group)]
"""Value of the key 'robot': a file or catalog name, or the group of a ``RobotSource``."""
