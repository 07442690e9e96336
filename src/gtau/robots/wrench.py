"""Wrenches on the bodies of a robot from outside: a foot on a force plate, a flange that carries a force sensor."""

from __future__ import annotations

from typing import NamedTuple

WRENCH = ("moment_x", "moment_y", "moment_z", "force_x", "force_y", "force_z")
"""Components of a wrench, N m and N."""


class WrenchFrame(NamedTuple):
    """The body on which a wrench acts, and whether its axes and origin are those of the world, or of the body."""

    body: str
    of_world: bool = False
