"""A robot under control: controller, drives, plant and sensors, sample by sample."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from gtau.documents.files import write_atomically
from gtau.signals.payload import Payload
from gtau.signals.run import Run
from gtau.simulation.controllers import FILTER, Controller
from gtau.simulation.drive import Hardware, rounded
from gtau.simulation.plant import PlantState

DIGITS = 9  # decimals of what is logged, finer than any encoder


class Engine(Protocol):
    """What moves the robot: :class:`~gtau.simulation.plant.Plant` or its like in MuJoCo."""

    def start(self, q: np.ndarray) -> PlantState:
        """Return the state at rest at actuated positions."""

    def advance(self, state: PlantState, force: np.ndarray, duration: float) -> PlantState:
        """Advance the state under constant forces."""


@dataclass(frozen=True, eq=False)
class Simulated:
    """What a simulation gives: the ``run`` as logged, and the true tracking ``error`` (N, n), rad or m."""

    run: Run
    error: np.ndarray


def simulate(
    name: str,
    engine: Engine,
    controller: Controller,
    hardware: Hardware,
    rng: np.random.Generator,
    payload: Payload | None = None,
    joints: tuple[str, ...] = (),
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Simulated:
    """Follow the controller's reference.

    At every sample the positions are measured, the currents computed, logged and held until the next.

    Parameters
    ----------
    name : str
        Of the run.
    engine : Engine
        The robot, its payload included.
    controller : Controller
        The control law along its reference.
    hardware : Hardware
        From :func:`gtau.simulation.drive.hardware`.
    rng : Generator
        Of the noise and the phase of the ripple.
    payload : Payload, optional
        What the run says of its payload.
    joints : tuple of str
        Names of the actuated joints.
    progress : callable
        Called with the samples done and their number.

    Raises
    ------
    GtauError
        Where the robot gets to a singular pose or out of control.
    """
    reference = controller.reference
    samples, n = reference.q.shape
    period = float(reference.time[1] - reference.time[0])
    kp, ki, kd = controller.pid
    blend = float(np.exp(-FILTER * controller.bandwidth * period))
    phase = rng.uniform(0.0, 2 * np.pi, (1, n))[0]
    state = engine.start(reference.q[0])
    history = [state] * (2 + int(np.ceil(hardware.delay.max() / period)))
    position, current, error = (np.empty((samples, n)) for _ in range(3))
    slope, integral = np.zeros(n), np.zeros(n)
    behind = controller.weight * reference.q[0] - _measured(history, hardware, period)
    for k in range(samples):
        seen = _measured(history, hardware, period)
        e, ahead = reference.q[k] - seen, controller.weight * reference.q[k] - seen
        slope = blend * slope + (1 - blend) * (ahead - behind) / period
        behind = ahead
        pushed = kp * e + ki * (integral + period * e) + kd * slope
        wanted = (controller.inertia[k] @ pushed + controller.feedforward[k]) / controller.gains
        current[k] = np.clip(wanted, -hardware.current_limit, hardware.current_limit)
        integral = integral + period * np.where(current[k] == wanted, e, 0.0)  # no windup at the limit
        position[k], error[k] = seen, reference.q[k] - state.q
        state = engine.advance(state, hardware.force(current[k], state.q, phase), period)
        history = [state, *history[:-1]]
        if k % 1000 == 0:
            progress(k, samples)
    progress(samples, samples)
    logged = rounded(current + hardware.current_noise * rng.standard_normal(current.shape), hardware.current_quantum)
    run = Run(name, joints, reference.time, np.round(position, DIGITS), np.round(logged, DIGITS), payload=payload)
    return Simulated(run, error)


def write_log(run: Run, path: str | Path) -> None:
    """Write a run as CSV, atomically: ``t``, then ``q`` and the joint's name, then ``v`` and the joint's name."""
    import polars as pl

    columns = {"t": np.round(run.time, DIGITS)}
    columns |= {f"q{joint}": run.position[:, j] for j, joint in enumerate(run.joints)}
    columns |= {f"v{joint}": run.command[:, j] for j, joint in enumerate(run.joints)}
    write_atomically(path, pl.DataFrame(columns).write_csv())


def _measured(history: list[PlantState], hardware: Hardware, period: float) -> np.ndarray:
    """Compute positions (n,) as the sensors give them, from the latest states, newest first."""
    late = hardware.delay / period
    whole = late.astype(int)
    past, older = (
        np.array([[getattr(history[m + back], what)[j] for what in ("q", "qd")] for j, m in enumerate(whole)]).T
        for back in (0, 1)
    )
    back = (late - whole) * period
    q = past[0] - back * past[1] + back**2 / (2 * period) * (past[1] - older[1])
    return rounded(q, hardware.position_quantum)
