"""Logs of the catalog's Orthoglide, made in memory: every true value is known, and faults are put in by hand."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from gtau.demo import DRIVE_GAINS, SIMULATION
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run
from gtau.simulation.trajectories import envelope, point_to_point, sines

RATE = 400.0  # Hz
SECONDS = 8.0
DELAY = 0.5e-3  # s
RIPPLE, PERIOD = 1.0, 0.02 / 6  # N, m
NOISE, QUANTUM, COUNT = 3e-4, 1e-5, 2.5e-6  # A, A, m
MASSES = (0.0, 0.0, 1.983, 1.983)


@cache
def orthoglide() -> InverseDynamics:
    """The model of the catalog's Orthoglide."""
    return InverseDynamics(load_robot("orthoglide"))


@dataclass(frozen=True)
class Plan:
    """A run to make: the mass carried, sines or moves from point to point, and its random numbers."""

    mass: float
    moves: bool
    seed: int

    def run(self) -> Run:
        """The run, with its payload declared."""
        model, rng = orthoglide(), np.random.default_rng(self.seed)
        path = (point_to_point if self.moves else sines)(envelope(model.robot), SECONDS, rng)
        time = np.arange(round(SECONDS * RATE) + 1) / RATE
        chi = dict(SIMULATION.parameters)
        chi["m_P"] += self.mass
        tau = model.torques(*path(time + DELAY), chi)
        q = path(time)[0]
        tau = tau + RIPPLE * np.sin(2 * np.pi * q / PERIOD + rng.uniform(0, 2 * np.pi, 3))
        current = tau / np.array(list(DRIVE_GAINS.values())) + NOISE * rng.standard_normal(q.shape)
        payload = Payload(name=f"{self.mass:g} kg", mass=self.mass) if self.mass else None
        return Run(
            f"run {self.seed}",
            model.actuated,
            time,
            COUNT * np.round(q / COUNT),
            QUANTUM * np.round(current / QUANTUM),
            payload=payload,
        )


def experiment(seed: int, masses: tuple[float, ...] = MASSES) -> list[Run]:
    """Runs of these masses, sines and moves by turns."""
    return [Plan(mass, bool(k % 2), 100 * seed + k).run() for k, mass in enumerate(masses)]
