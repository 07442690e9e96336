"""Units of a log's columns, as factors to SI; units outside ``COMMON`` are converted by pint."""

from __future__ import annotations

import math
import re
from functools import lru_cache
from typing import Any, Literal

from pydantic import AfterValidator

Kind = Literal["time", "position", "current", "torque", "force"]

COMMON: dict[str, dict[str, float]] = {  # units of nearly all logs, without the half second that pint takes to import
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "angle": {"rad": 1.0, "deg": math.pi / 180},
    "length": {"m": 1.0, "mm": 1e-3},
    "current": {"A": 1.0, "mA": 1e-3},
    "torque": {"N m": 1.0, "Nm": 1.0},
    "force": {"N": 1.0},
}
SI_UNIT = {"time": "s", "angle": "rad", "length": "m", "current": "A", "torque": "N*m", "force": "N"}
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


@lru_cache(maxsize=64)
def si_factor(text: str, kind: Kind) -> float:
    """Convert a unit, or a quantity such as ``0.0012 A`` (of one count), to the SI unit of its kind.

    Raises
    ------
    ValueError
        It is no unit of that kind; the text gives the remedy.
    """
    return _found(text, kind)[1]


@lru_cache(maxsize=64)
def is_angle(text: str) -> bool:
    """Decide whether a unit of positions is an angle and not a length."""
    return _found(text, "position")[0] == "angle"


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


def _found(text: str, kind: Kind) -> tuple[str, float]:
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
            if quantity_written.is_compatible_with(SI_UNIT[quantity]):
                factor = float(quantity_written.to(SI_UNIT[quantity]).magnitude)
                if factor and math.isfinite(factor):
                    return quantity, factor
    except (pint.PintError, ArithmeticError, AttributeError, TypeError, ValueError, SyntaxError):
        pass
    except Exception as error:
        if type(error).__module__ not in ("tokenize", "builtins"):  # accepted by pint's parser
            raise
    raise ValueError(f"write {choices}, or another unit of {' or '.join(QUANTITIES[kind])}, not '{text}'")


@lru_cache(maxsize=1)
def _registry() -> Any:
    import pint

    return pint.UnitRegistry(cache_folder=None)
