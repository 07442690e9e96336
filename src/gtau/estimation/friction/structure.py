"""Structures of a joint's friction on all samples: the terms that it may have, and the columns of its parameters."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gtau.estimation.friction.normal_equations import SMOOTH, WEIGHTS, WIDTHS, FrictionJoint

ROUNDING = 1e-9  # of the way to the next width or speed tried
FREE = ("off", "fvt", "fst")
"""Parameters of either sign."""


@dataclass(frozen=True)
class Structure:
    """What a joint's friction has beyond the plain law.

    Presliding of a ``width``, rad or m, a bend at a ``speed``, rad/s or m/s, and dependence on the ``load`` and on the
    ``temperature``. The column of a width or speed between two tried values is interpolated. ``gradual`` presliding has
    all widths at once; no result has it, but a bend must improve the fit beyond it.
    """

    width: float | None = None
    speed: float | None = None
    load: bool = False
    temperature: bool = False
    gradual: bool = False

    def value(self, term: str) -> Any:
        """Return the value of a term."""
        return getattr(self, term)

    def changed(self, term: str, value: Any) -> Structure:
        """Return the structure with another value of a term."""
        return replace(self, **{term: value})


WORDS = {"width": "presliding", "speed": "bent", "load": "load", "temperature": "temperature"}
"""Terms that the selection tries, and their words."""
SHAPE_OF = {"width": "width", "speed": "vs"}
"""Terms with a value, and the parameters that hold these values."""


def with_term(structure: Structure, joint: FrictionJoint, term: str) -> list[Structure]:
    """List a joint's structures with a term; several if it has a value."""
    if term in SHAPE_OF:
        return [structure.changed(term, float(value)) for value in joint.tried(term)]
    possible = {"load": joint.motor is not None, "temperature": joint.warm}
    return [structure.changed(term, True)] if possible[term] else []


def parameter_columns(structure: Structure, joint: FrictionJoint) -> dict[str, np.ndarray]:
    """Combine a joint's columns to a column (p,) for each parameter of a structure; most cannot be negative.

    ``fr`` is friction at rest, ``fs + fb``.
    """
    z, weights = np.eye(1 + len(WIDTHS))[0], dict(zip(WEIGHTS, np.eye(len(WEIGHTS)), strict=True))
    if structure.width is not None:
        z = np.append(0.0, shares(structure.width, joint.widths))

    def sliding(weight: np.ndarray, direction: np.ndarray = z) -> np.ndarray:
        return np.concatenate([np.zeros(len(SMOOTH)), np.outer(direction, weight).ravel()])

    alone = dict(zip(SMOOTH, np.eye(len(SMOOTH), joint.count), strict=True))
    columns: dict[str, np.ndarray] = {kind: alone[kind] for kind in ("off", "fv") if kind in joint.plain}
    if "fs" in joint.plain:
        columns["fs"] = sliding(weights["fs"])
        if structure.speed is not None:
            bend = np.zeros(len(WEIGHTS))
            bend[[weight == "fb" for weight in WEIGHTS]] = shares(structure.speed, joint.speeds)
            columns["fr"] = sliding(bend)
            columns["fs"] = columns["fs"] - columns["fr"]
        if structure.gradual:
            states = np.eye(1 + len(WIDTHS))
            columns |= {f"z{k}": sliding(weights["fs"], states[k]) for k in range(1, len(states)) if not z[k]}
        if structure.load:
            columns["fl"] = sliding(weights["fl"])
    if structure.temperature:
        columns |= {"fvt": alone["fvt"], "fst": sliding(weights["fst"])}
    return columns


def place(value: float, tried: np.ndarray) -> float:
    """Return the position of a width or speed among tried values of constant ratio; whole at a tried value."""
    number = float(np.log(value / tried[0]) / np.log(tried[1] / tried[0]))
    return float(round(number)) if abs(number - round(number)) < ROUNDING else number


def shares(value: float, tried: np.ndarray) -> np.ndarray:
    """Interpolate between the columns of the values ``tried`` by a cubic through four: the share of each column.

    With half a decade between two speeds ``exp(-|v| / v_s)`` is off by at most 0.02.
    """
    number, made = place(value, tried), np.zeros(len(tried))
    if number == round(number):
        made[int(number)] = 1.0
        return made
    begin = min(max(int(number) - 1, 0), len(tried) - 4)
    nodes = range(begin, begin + 4)
    for k in nodes:
        made[k] = np.prod([(number - other) / (k - other) for other in nodes if other != k])
    return made
