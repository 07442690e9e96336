"""A robot under control: controller, drives, plant and sensors, sample by sample."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from math import inf
from pathlib import Path
from typing import Protocol

import numpy as np

from gtau.documents.files import in_csv, write_atomically
from gtau.signals.payload import Payload
from gtau.signals.run import Run
from gtau.simulation.controllers import FILTER, Controller
from gtau.simulation.plant import PlantState


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
    """Measurement and logging of a joint.

    Positions are delayed ``delay`` s and rounded to ``position_quantum``, rad or m. The logged current has white noise
    of the rms ``current_noise`` and is rounded to ``current_quantum``, both in A.
    """

    position_quantum: float = 0.0
    delay: float = 0.0
    current_noise: float = 0.0
    current_quantum: float = 0.0


@dataclass(frozen=True, eq=False)
class Hardware:
    """Drives and sensors of all actuated joints: each field as an array (n,)."""

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


DIGITS = 9  # decimals of what is logged, finer than any encoder


class Engine(Protocol):
    """Dynamics engine of the robot: :class:`~gtau.simulation.plant.Plant` or its MuJoCo counterpart."""

    def start(self, q: np.ndarray) -> PlantState:
        """Return the state at rest at actuated positions."""

    def advance(self, state: PlantState, force: np.ndarray, duration: float) -> PlantState:
        """Advance the state under constant forces."""


@dataclass(frozen=True, eq=False)
class Simulated:
    """Result of a simulation: the ``run`` as logged, and the true tracking ``error`` (N, n), rad or m."""

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
        From :func:`gtau.simulation.closed_loop.hardware`.
    rng : Generator
        Of the noise and the phase of the ripple.
    payload : Payload, optional
        Payload stated in the run.
    joints : tuple of str
        Names of the actuated joints.
    progress : callable
        Called with the samples done and their number.

    Raises
    ------
    GtauError
        Where the robot reaches a singular pose or the control loop diverges.
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
    write_atomically(path, in_csv(pl.DataFrame(columns)))


def _measured(history: list[PlantState], hardware: Hardware, period: float) -> np.ndarray:
    """Compute the measured positions (n,) from the latest states, newest first."""
    late = hardware.delay / period
    whole = late.astype(int)
    past, older = (
        np.array([[getattr(history[m + back], what)[j] for what in ("q", "qd")] for j, m in enumerate(whole)]).T
        for back in (0, 1)
    )
    back = (late - whole) * period
    q = past[0] - back * past[1] + back**2 / (2 * period) * (past[1] - older[1])
    return rounded(q, hardware.position_quantum)
