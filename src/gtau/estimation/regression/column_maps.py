"""Maps from the columns of a run's factors to those of the estimation problem (eqs. 29 to 33).

All runs have the same base columns. A payload, friction that drifts or changes with temperature, and a sensor's own
parameters are combinations of them, so each channel of each run becomes a block of the problem by one product with a
small matrix.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gtau.estimation.regression.carried_payload import CarriedPayload
from gtau.estimation.regression.factors import CURRENTS, EXTRA, PUSH
from gtau.estimation.regression.friction import DRIFTING, TEMPERATURE_TERMS, TERMS, Friction
from gtau.estimation.regression.torque_sensors import sensor_name
from gtau.model.base_parameters import BaseParameters, of_drive


@dataclass(frozen=True, eq=False)
class ColumnMaps:
    """The problem's parameters, and the map to their columns for every channel of every run.

    ``joints`` are the actuated ones, ``sensors`` those with a torque sensor, ``carried`` the payloads of all ``runs``.
    """

    base: BaseParameters
    joints: tuple[str, ...]
    sensors: tuple[str, ...]
    carried: tuple[CarriedPayload, ...]
    friction: Friction
    runs: int

    @cached_property
    def drifting(self) -> list[int]:
        """Base columns of friction that may drift between runs."""
        if not self.friction.per_run or self.runs < 2:
            return []
        kinds = {f"{kind}_{joint}" for kind in DRIFTING for joint in self.joints}
        return [k for k, name in enumerate(self.base.names) if name in kinds]

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        """Names of the problem's unknown parameters, (n_theta,)."""
        drifts = [drift_name(self.base.names[k], run) for run in range(self.runs - 1) for k in self.drifting]
        offsets = [f"off_{sensor_name(joint)}" for joint in self.sensors]
        unknown = (name for each in self.carried for name in each.unknown)
        return (*self.base.names, *unknown, *drifts, *self.friction.terms, *offsets)

    @cached_property
    def position(self) -> dict[str, int]:
        """Column of each parameter."""
        return {name: k for k, name in enumerate(self.parameters)}

    def of_run(self, run: int) -> list[np.ndarray]:
        """Build the maps (p, n_theta + 4) of all channels of a run, the joints' and then the sensors'."""
        M = self._shared(run)
        return [
            *(self._of_joint(M, joint) for joint in self.joints),
            *(self._of_sensor(M, each) for each in self.sensors),
        ]

    def warmth(self, joint: str) -> np.ndarray:
        """Map a channel's friction columns to those of the problem for friction per degree, (p, n_theta + 4)."""
        E = self._empty()
        for term, kind in TEMPERATURE_TERMS.items():
            if f"{term}_{joint}" in self.position:
                E[self.base.standard.index(f"{kind}_{joint}"), self.position[f"{term}_{joint}"]] = 1.0
        return E

    def _empty(self) -> np.ndarray:
        return np.zeros((self.base.count + EXTRA, len(self.parameters) + 1 + CURRENTS))

    def _shared(self, run: int) -> np.ndarray:
        M, n_b, known = self._empty(), self.base.count, len(self.parameters)
        M[:n_b, :n_b] = np.eye(n_b)
        M[-CURRENTS - PUSH, known] = -1.0  # torques that the motors need not give
        M[-CURRENTS:, known + 1 :] = np.eye(CURRENTS)
        for each in self.carried:
            if each.run == run:
                M[:n_b, [self.position[name] for name in each.unknown]] = each.unknown_columns
                M[:n_b, known] = each.known_column
        last = self.runs - 1
        for k in self.drifting:
            # a run's difference from the mean friction; those of all runs add up to zero
            for other in range(last):
                M[k, self.position[drift_name(self.base.names[k], other)]] = (other == run) - (run == last)
        return M

    def _of_joint(self, shared: np.ndarray, joint: str) -> np.ndarray:
        M = shared.copy()
        for t, term in enumerate(TERMS):
            if f"{term}_{joint}" in self.position:
                M[self.base.count + t, self.position[f"{term}_{joint}"]] = 1.0
        return M

    def _of_sensor(self, shared: np.ndarray, joint: str) -> np.ndarray:
        M = shared.copy()
        for k, name in enumerate(self.base.standard):
            if of_drive(name, joint):  # its column, without its value, is that of what the sensor has of its own
                M[k] = 0.0
                own = f"{name.split('_', 1)[0]}_{sensor_name(joint)}"
                if own in self.position:
                    M[k, self.position[own]] = 1.0
        return M


def drift_name(name: str, run: int) -> str:
    """Name the difference of a friction parameter from its mean, in a run."""
    return f"{name}@{run + 1}"
