"""What a robot's file says beside the robot: its source, notes, constants, inertias, and the digits of its numbers."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from decimal import Decimal
from math import floor, log10

PRINTED = 6  # significant digits that programs write, MuJoCo and others that print by %g
COMPUTED = (
    14  # significant digits: numbers with as many were computed, not written; of 1,000 computed ones, 1 has fewer
)

FEWEST = 3  # decimals of numbers that were rounded, m or rad


def _digits(number: float) -> tuple[int, int]:
    """Count the significant digits of a number and return the exponent of its last one."""
    _, digits, exponent = Decimal(repr(float(number))).normalize().as_tuple()
    return len(digits), int(exponent)


def is_written(number: float) -> bool:
    """Decide whether a number has as few digits as one that is written."""
    return _digits(number)[0] < COMPUTED


@dataclass(frozen=True)
class Digits:
    """The digits of the numbers in a file: so many ``decimals``, or so many ``significant`` ones where those are many.

    Trailing zeros are often left out, so a single number does not show them; the longest of all numbers does. ``turn``
    is the largest turn about an axis by rounding, rad, where a reader computes placements from the numbers.
    """

    decimals: int
    significant: int
    turn: float = 0.0

    def half_unit(self, number: float) -> float:
        """Return half a unit of the last digit with which a number is written; of numbers of no such file, 0."""
        if not self.significant:
            return 0.0
        last = -self.decimals
        if number and self.significant >= PRINTED:
            last = max(last, floor(log10(abs(number))) + 1 - self.significant)
        return 0.5 * 10.0**last


def digits_of(numbers: Iterable[float]) -> Digits:
    """Find the digits that numbers are written with; computed ones show none, nor do 0.25 and 0.4, which are exact."""
    digits = [_digits(number) for number in numbers if number != round(number) and is_written(number)]
    significant, exponents = zip(*digits, strict=True) if digits else ((0,), (0,))
    return Digits(-min(exponents), max(significant)) if -min(exponents) >= FEWEST else Digits(0, 0)


@dataclass(frozen=True)
class RobotFile:
    """What a robot's file says beside the robot itself; only the ``source`` counts where robots are compared.

    ``notes`` say what a reader found odd in it or decided for the user, a sentence each. Without ``home_given`` the
    joints' and platforms' homes are only where the search for one begins. ``constants`` are the numbers that it names,
    and ``inertias`` the inertial parameters of bodies, and rotor inertias, that it states, by name, SI units: estimates
    are compared with them. ``rounding`` says how its numbers are rounded where placements are computed from them;
    without it, placements are the numbers in the file.
    """

    source: str = ""
    notes: tuple[str, ...] = field(default=(), compare=False)
    home_given: bool = field(default=True, compare=False)
    constants: tuple[tuple[str, float], ...] = field(default=(), compare=False)
    inertias: tuple[tuple[str, float], ...] = field(default=(), compare=False)
    rounding: Digits | None = field(default=None, compare=False)
