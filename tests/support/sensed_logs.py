"""Logs with torque sensors between gear and link, of robots whose every parameter is known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.robot import DRIVE
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run

RATE = 250.0  # Hz


@dataclass(frozen=True)
class SensedPlant:
    """A robot whose motors have ``gains`` and whose ``sensors`` read with an offset, late by ``lag``, with noise (N m).

    ``noise`` is that of the currents, A; the path is a sum of sines of ``amplitudes`` about ``home``.
    """

    model: InverseDynamics
    chi: Mapping[str, float]
    gains: Sequence[float]
    home: Sequence[float]
    amplitudes: Sequence[float]
    sensors: tuple[str, ...] = ()
    noise: float = 0.01
    sensor_noise: float = 0.05
    offset: float = 0.3
    lag: float = 0.0
    bearing: float = 0.0
    tool: str = ""

    def run(self, seed: int, payload: Mapping[str, float] | None = None, known: Payload | None = None) -> Run:
        """Make a run of 8 s; its motion and noise follow from the ``seed``."""
        rng, joints = np.random.default_rng(seed), self.model.actuated
        time = np.arange(round(8 * RATE)) / RATE
        w = 2 * np.pi * np.array([0.35, 0.8, 1.3, 1.9])
        phase = rng.uniform(0, 2 * np.pi, (len(joints), 4))

        def path(at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            angle, size = w * at[:, None, None] + phase, np.array(self.amplitudes)[:, None] / w
            return (
                np.array(self.home) + (size * np.sin(angle)).sum(2),
                (size * w * np.cos(angle)).sum(2),
                (-size * w**2 * np.sin(angle)).sum(2),
            )

        chi = dict(self.chi)
        for kind, value in (payload or {}).items():
            chi[f"{kind}_{self.tool}"] = chi.get(f"{kind}_{self.tool}", 0.0) + value
        current = self.model.torques(*path(time), chi) / self.gains
        current += self.noise * rng.standard_normal(current.shape)
        columns = [current]
        for joint in self.sensors:
            j = joints.index(joint)
            sensed = self.model.torques(*path(time - self.lag), chi | {f"{kind}_{joint}": 0.0 for kind in DRIVE})[:, j]
            sensed += self.offset + self.bearing * np.sign(path(time - self.lag)[1][:, j])
            columns.append((sensed + self.sensor_noise * rng.standard_normal(len(time)))[:, None])
        return Run(f"run {seed}", joints, time, path(time)[0], np.hstack(columns), payload=known, sensors=self.sensors)

    def with_sensors(self, *sensors: str) -> SensedPlant:
        """The same robot with these sensors."""
        return replace(self, sensors=sensors)
