"""Friction beyond the paper's: which terms an actuated joint needs, and how friction drifts between runs.

The paper's friction, viscous and Coulomb, is among the standard parameters of the model. Two terms are
offered on top of it to every actuated joint, and taken where its own equations ask for them:

- ``f3``: cubic in speed, ``f3 qd^3``;
- ``fl``: proportional to the torque that the joint transmits, ``fl |tau_load| sign(qd)``.

Where temperatures of the joints are logged, two more are:

- ``fvt``, ``fst``: viscous and Coulomb friction per degree above the mean temperature, ``fvt (T - T_mean) qd`` and
  ``fst (T - T_mean) sign(qd)``.

The bearing of a joint's torque sensor may have friction of its own, viscous and Coulomb (``fv_2_sensor``).

Warm-up makes friction drift between runs by per cents, which no single run shows and which ruins the
drive gains; so viscous and Coulomb friction may take a value of their own in every run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gtau.signals.channel import Channel

TERMS = ("f3", "fl")
TEMPERATURE_TERMS = {"fvt": "fv", "fst": "fs"}
DRIFTING = ("fv", "fs")
BEARING = ("fv", "fs")
UNITS = {
    "revolute": {"f3": "N m s3/rad3", "fl": "1", "fvt": "N m s/rad", "fst": "N m"},
    "prismatic": {"f3": "N s3/m3", "fl": "1", "fvt": "N s/m", "fst": "N"},
}
"""Units of the terms; those of ``fvt`` and ``fst`` per unit of the temperature."""


@dataclass(frozen=True)
class Friction:
    """A friction model: the terms taken (``fl_11``), and whether friction may drift between runs."""

    terms: tuple[str, ...] = ()
    per_run: bool = False


PAPER = Friction()
"""Viscous and Coulomb friction and an offset, shared by all runs."""


def term_columns(qd: np.ndarray, effort: np.ndarray) -> np.ndarray:
    """Build the columns of the terms, (2, n, N), from speeds and transmitted torques (n, N)."""
    return np.stack([qd * qd * qd, np.abs(effort) * np.sign(qd)])  # a power would take ten times as long


def all_terms(joints: tuple[str, ...]) -> tuple[str, ...]:
    """List every term of every joint."""
    return tuple(f"{term}_{joint}" for joint in joints for term in TERMS)


def temperature_terms(joints: Sequence[str]) -> tuple[str, ...]:
    """List the temperature-dependent friction terms of the joints with a temperature."""
    return tuple(f"{term}_{joint}" for joint in joints for term in TEMPERATURE_TERMS)


def bearing_terms(channels: Sequence[Channel]) -> tuple[str, ...]:
    """List all friction terms that the bearings of torque sensors may have of their own."""
    return tuple(f"{kind}_{channel.name}" for channel in channels if channel.kind == "sensor" for kind in BEARING)


def transmitted(names: Sequence[str]) -> np.ndarray:
    """Mark the base parameters whose torque a joint transmits by 1, friction and offsets by 0, (n_b,)."""
    return np.array([name.split("_", 1)[0] not in ("fv", "fs", "off") for name in names], dtype=float)
