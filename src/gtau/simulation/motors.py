"""Motors of simulated drives: their voltage equation, the supply that sags, and position servos.

The words are those of experiment files. At the joint, a motor obeys ``u = R i + L di/dt + (ke / c) qd``; its bridge
loses a share of the supply voltage, with the sign of the current, to its dead time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from gtau.documents.validation import Keys, Positive
from gtau.simulation.trajectories import NotNegative

Logged = Literal["voltage", "duty", "supply_voltage", "supply_current", "goal"]
SMALL = 4e-3  # of the stall current, below which a bridge loses less: its ripple R / 8 L f of 0.6 ohm, 1 mH, 20 kHz


class Supply(Keys):
    """The supply of all drives: its ``voltage`` without load, V, and the ``resistance`` by which it sags, ohm."""

    voltage: Positive
    resistance: NotNegative = 0.0


@dataclass(frozen=True, eq=False)
class MotorDrives:
    """Motors of all actuated joints on a supply: back-EMF constants ``emf`` (n,) over c, V s/rad or V s/m.

    ``drives`` are the keys of :class:`gtau.simulation.closed_loop.JointHardware`, each an array (n,); without
    ``proportional_gain`` (NaN) a drive is no servo, but holds a current.
    """

    supply: Supply
    emf: np.ndarray
    drives: Mapping[str, np.ndarray]

    def currents(
        self, wanted: np.ndarray, error: np.ndarray, qd: np.ndarray, voltage: float, done: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute currents and duties (n,) at a supply ``voltage`` when a part of the run is ``done``.

        ``wanted`` are the currents of a controller, which the voltage limits; a servo has the duty of its gain times
        the ``error``, goal less measured position, 1 at most, and no duty within its dead band.
        """
        drives, emf = self.drives, self.emf * qd
        resistance = drives["resistance"] * (1 + drives["warming"] * (1 - np.exp(-2 * done)))
        lost, gain = drives["dead_time"] * voltage, drives["proportional_gain"]
        push = gain * np.sign(error) * np.maximum(np.abs(error) - drives["dead_band"], 0.0)
        duty = np.clip(push, -1.0, 1.0)
        free = duty * voltage - emf
        driven = np.sign(free) * np.maximum(np.abs(free) - lost, 0.0) / resistance
        held = np.clip(wanted, (lost - voltage - emf) / resistance, (voltage - lost - emf) / resistance)
        servo = np.isfinite(gain)
        current = np.where(servo, driven, held)
        bridge = lost * np.clip(current * resistance / (SMALL * voltage), -1.0, 1.0)
        return current, np.where(servo, duty, (resistance * current + emf + bridge) / voltage)

    def logged(
        self, period: float, current: np.ndarray, duty: np.ndarray, voltage: np.ndarray, goal: np.ndarray
    ) -> dict[Logged, np.ndarray]:
        """Make all side signals (N, n) from currents, duties and goals (N, n), and supply voltages (N,)."""
        servos = np.isfinite(self.drives["proportional_gain"])  # their currents would lag
        inductive = np.where(servos, 0.0, self.drives["inductance"])
        change = inductive * np.gradient(current, period, axis=0) / voltage[:, None]
        measured = rounded(duty + change, self.drives["duty_quantum"])
        return {
            "voltage": measured * voltage[:, None],
            "duty": measured,
            "supply_voltage": np.repeat(voltage[:, None], duty.shape[1], axis=1),
            "supply_current": duty * current,
            "goal": goal,
        }


def rounded(values: np.ndarray, quantum: np.ndarray) -> np.ndarray:
    """Round values to multiples of a quantum; a quantum of zero leaves them unchanged."""
    step = np.where(quantum > 0, quantum, 1.0)
    return np.where(quantum > 0, np.round(values / step) * step, values)
