"""Where a robot comes from: its file, how its base stands, and which of its joints move."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Discriminator, FiniteFloat, Tag

from gtau.robots.readers.expressions import evaluate


def _base(value: Any) -> Any:
    if value == "fixed":
        return {}
    if isinstance(value, str):
        raise ValueError(
            f"write 'fixed', or how the base is turned, '{{rpy: [roll, pitch, yaw]}}' in rad, not '{value}'"
        )
    return value


def _angle(value: Any) -> Any:
    return evaluate(value) if isinstance(value, str) else value


Angle = Annotated[FiniteFloat, BeforeValidator(_angle)]


class Base(BaseModel):
    """A base that does not move: ``rpy`` turns it in a world whose z axis points up, else it stands as in the file."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    rpy: tuple[Angle, Angle, Angle] | None = None


class RobotSource(BaseModel):
    """A robot's file or catalog name, and which part of it, how placed, is the robot.

    ``base`` fixes a floating base, or says how a fixed one is mounted. ``joints`` are patterns of the joints that move;
    the others are held, at the positions in ``held`` or at home.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    file: str
    base: Annotated[Base | None, BeforeValidator(_base)] = None
    joints: tuple[str, ...] = ()
    held: dict[str, FiniteFloat] = {}


def _text_or_group(value: Any) -> str:
    return "text" if isinstance(value, str) else "group"


AnySource = Annotated[Annotated[str, Tag("text")] | Annotated[RobotSource, Tag("group")], Discriminator(_text_or_group)]
"""What a key 'robot' holds: a file or catalog name, or the group of a ``RobotSource``."""
