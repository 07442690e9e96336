"""Columns of a log that hold forces and moments on a body from outside."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, FiniteFloat

from gtau.documents.validation import Keys
from gtau.robots.geometry import turn
from gtau.robots.wrench import WRENCH, WrenchFrame
from gtau.signals.units import si_factor

VERTICAL = np.array([0.0, 0.0, 1.0])

Vector = tuple[str, str, str]
Point = tuple[FiniteFloat, FiniteFloat, FiniteFloat]


def _of(kind: Literal["force", "torque"]) -> AfterValidator:
    def checked(text: str) -> str:
        si_factor(text, kind)
        return text

    return AfterValidator(checked)


class WrenchUnits(Keys):
    """Units of measured wrenches."""

    force: Annotated[str, _of("force")] = "N"
    moment: Annotated[str, _of("torque")] = "N m"

    def scale(self, wrench: Wrench) -> list[float]:
        """Return the factors to SI units of a wrench's columns."""
        return [si_factor(self.force, "force")] * 3 + [si_factor(self.moment, "torque")] * (3 if wrench.moment else 0)


class Wrench(Keys):
    """Columns of a force (N) and a moment (N m) from outside.

    The moment is that about the point ``at`` (m), in the axes of the wrench: the origin of a force plate, or of a
    sensor on the body. Without columns of the moment it is zero there.
    """

    force: Vector
    moment: Vector | None = None
    at: Point = (0.0, 0.0, 0.0)

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of the force, then of the moment if there are any, (3,) or (6,)."""
        return (*self.force, *(self.moment or ()))


class BaseWrench(Wrench):
    """A wrench that acts on a floating base, along the axes of the world or of the base."""

    axes: Literal["world", "base"] = "world"


class BodyWrench(Wrench):
    """A wrench that acts on another ``body``, along the axes of the world or of the body."""

    body: str
    axes: Literal["world", "body"] = "world"

    @property
    def frame(self) -> WrenchFrame:
        """Frame in which it acts."""
        return WrenchFrame(self.body, self.axes == "world")

    @property
    def labels(self) -> tuple[str, ...]:
        """Columns behind the components of the wrench, for messages, (6,)."""
        return (*(self.moment or (", ".join(self.force),) * 3), *self.force)


def at_origins(wrenches: Sequence[BodyWrench], values: np.ndarray, yaw: float = 0.0) -> np.ndarray:
    """Convert logged columns (M, .) to moments and forces (M, 6 k) about the origins of the wrenches' axes.

    The world is turned by ``yaw`` (rad) about the vertical.
    """
    turned, found, start = turn(VERTICAL, yaw), [], 0
    for each in wrenches:
        f, m = values[:, start : start + 3], np.cross(each.at, values[:, start : start + 3])
        if each.moment:
            m = m + values[:, start + 3 : start + 6]
        start += len(each.columns)
        found += [m @ turned.T, f @ turned.T] if each.axes == "world" else [m, f]
    return np.hstack(found) if found else np.zeros((len(values), 0))


def components(wrenches: Sequence[BodyWrench]) -> int:
    """Count the components of all wrenches together."""
    return len(WRENCH) * len(wrenches)
