"""Drives and sensors of a simulated robot: what stands between a controller and the forces on the joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from math import inf

import numpy as np


@dataclass(frozen=True)
class Drive:
    """A joint's drive: it holds the current of a controller's sample and turns it into force.

    ``gain`` in N m/A or N/A; currents are limited to ``current_limit`` A. A ripple of amplitude ``ripple`` (N m or
    N) repeats every ``ripple_period`` (rad or m).
    """

    gain: float
    current_limit: float = inf
    ripple: float = 0.0
    ripple_period: float = 1.0


@dataclass(frozen=True)
class Sensors:
    """What is measured and logged of a joint.

    Positions are late by ``delay`` s and rounded to ``position_quantum``, rad or m. The logged current has white noise
    of the rms ``current_noise`` and is rounded to ``current_quantum``, both in A.
    """

    position_quantum: float = 0.0
    delay: float = 0.0
    current_noise: float = 0.0
    current_quantum: float = 0.0


@dataclass(frozen=True, eq=False)
class Hardware:
    """Drives and sensors of all actuated joints: every field of theirs as an array (n,)."""

    gain: np.ndarray
    current_limit: np.ndarray
    ripple: np.ndarray
    ripple_period: np.ndarray
    position_quantum: np.ndarray
    delay: np.ndarray
    current_noise: np.ndarray
    current_quantum: np.ndarray

    def force(self, current: np.ndarray, q: np.ndarray, phase: np.ndarray) -> np.ndarray:
        """Compute forces (n,) of held currents (n,) at ``q`` (n,), with the ripple's ``phase`` (n,) in rad."""
        return self.gain * current + self.ripple * np.sin(2 * np.pi * q / self.ripple_period + phase)


def hardware(joints: Sequence[str], drives: Mapping[str, Drive], sensors: Mapping[str, Sensors]) -> Hardware:
    """Stack drives and sensors in the order of ``joints``; a joint without sensors of its own has perfect ones."""
    pairs = [(drives[joint], sensors.get(joint, Sensors())) for joint in joints]
    return Hardware(
        **{field.name: np.array([getattr(drive, field.name) for drive, _ in pairs]) for field in fields(Drive)},
        **{field.name: np.array([getattr(sensor, field.name) for _, sensor in pairs]) for field in fields(Sensors)},
    )


def rounded(values: np.ndarray, quantum: np.ndarray) -> np.ndarray:
    """Round values to multiples of a quantum; a quantum of zero rounds nothing."""
    some = np.where(quantum > 0, quantum, 1.0)
    return np.where(quantum > 0, np.round(values / some) * some, values)
