"""A robot under control: control laws, drives, plant and sensors, sample by sample.

The laws are those that the paper compares (section 5.2), all with the same linear part.

Force = ``inertia`` (kp e + ki int e + kd (weight qd_r - qd)) + ``feedforward``, with ``e = q_r - q``. The laws differ
in the inertia, in the ``weight`` of the reference's velocity (0: simple PID, 1: velocity feedforward) and in the
feedforward. The gains put the three poles of a rigid axis at the bandwidth.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Annotated, Protocol

import numpy as np
from pydantic import AfterValidator, Field, FiniteFloat

from gtau.documents.files import write_table
from gtau.documents.validation import Keys, Positive
from gtau.signals.run import Run
from gtau.simulation.plant import PlantState
from gtau.simulation.trajectories import NotNegative, Trajectory, log_column

BANDWIDTH = 100.0  # rad/s
FILTER = 10.0  # the derivative is filtered at this multiple of the bandwidth
DIGITS = 9  # decimals of what is logged, finer than any encoder


@dataclass(frozen=True, eq=False)
class Reference:
    """Sampled motion of the actuated joints: ``time`` (N,), uniform, and ``q``, ``qd``, ``qdd`` (N, n)."""

    time: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray


@dataclass(frozen=True, eq=False)
class Controller:
    """A law along a reference: ``inertia`` (N, n, n), ``feedforward`` (N, n), drive gains (n,), bandwidth in rad/s."""

    reference: Reference
    inertia: np.ndarray
    feedforward: np.ndarray
    gains: np.ndarray
    weight: float
    bandwidth: float

    @property
    def pid(self) -> tuple[float, float, float]:
        """Make a PID with an ``inertia`` (n, n) or (N, n, n); with a ``weight`` of 0 it is the paper's simple PID."""
        return 3 * self.bandwidth**2, self.bandwidth**3, 3 * self.bandwidth


def sample(trajectory: Trajectory, duration: float, rate: float) -> Reference:
    """Sample a trajectory at ``rate`` Hz for ``duration`` s."""
    time = np.arange(round(duration * rate) + 1) / rate
    return Reference(time, *trajectory(time))


def pid(
    reference: Reference, inertia: np.ndarray, gains: np.ndarray, bandwidth: float = BANDWIDTH, weight: float = 1.0
) -> Controller:
    """Make a PID with an ``inertia`` (n, n) or (N, n, n); with a ``weight`` of 0 it is the paper's simple PID."""
    inertias = np.broadcast_to(inertia, (*reference.q.shape, reference.q.shape[1]))
    return Controller(reference, inertias, np.zeros_like(reference.q), gains, weight, bandwidth)


def _not_zero(gain: float) -> float:
    if gain == 0:
        raise ValueError("a drive with a gain of 0 gives no torque; write its N m/A (or N per A)")
    return gain


class JointHardware(Keys):
    """Drive and sensors of a joint.

    The drive holds the current of a controller's sample and turns it into force: ``gain`` in N m/A or N per A; currents
    are limited to ``current_limit`` A. A ripple of amplitude ``ripple`` (N m or N) repeats every ``ripple_period`` (rad
    or m). Positions are delayed ``delay`` s and rounded to ``position_quantum``, rad or m. The logged current has white
    noise of the rms ``current_noise`` and is rounded to ``current_quantum``, both in A.
    """

    gain: Annotated[FiniteFloat, AfterValidator(_not_zero)]
    current_limit: Positive | None = None
    ripple: NotNegative = 0.0
    ripple_period: Positive = 1.0
    position_quantum: NotNegative = 0.0
    delay: Annotated[FiniteFloat, Field(ge=0, le=0.1)] = 0.0
    current_noise: NotNegative = 0.0
    current_quantum: NotNegative = 0.0


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


def hardware(joints: Sequence[str], drives: Mapping[str, JointHardware]) -> Hardware:
    """Stack drives and sensors in the order of ``joints``."""
    rows = [{"current_limit": inf} | drives[joint].model_dump(exclude_none=True) for joint in joints]
    return Hardware(**{name: np.array([row[name] for row in rows]) for name in JointHardware.model_fields})


def rounded(values: np.ndarray, quantum: np.ndarray) -> np.ndarray:
    """Round values to multiples of a quantum; a quantum of zero rounds nothing."""
    some = np.where(quantum > 0, quantum, 1.0)
    return np.where(quantum > 0, np.round(values / some) * some, values)


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


def close_loop(
    name: str,
    engine: Engine,
    controller: Controller,
    hardware: Hardware,
    rng: np.random.Generator,
    joints: tuple[str, ...],
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Simulated:
    """Follow the controller's reference: a run as logged, and the true tracking error.

    At every sample positions are measured, currents computed, logged and held. ``rng`` draws the noise and the phase of
    the ripple. Raises GtauError where the robot reaches a singular pose or the control loop diverges.
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
    run = Run(name, joints, reference.time, np.round(position, DIGITS), np.round(logged, DIGITS))
    return Simulated(run, error)


def write_log(run: Run, path: str | Path) -> None:
    """Write a run as CSV, atomically: ``t``, then ``q`` and the joint's name, then ``v`` and the joint's name."""
    import polars as pl

    columns = {"t": np.round(run.time, DIGITS)}
    columns |= {log_column("q", joint): run.position[:, j] for j, joint in enumerate(run.joints)}
    columns |= {log_column("v", joint): run.command[:, j] for j, joint in enumerate(run.joints)}
    write_table(pl.DataFrame(columns), path)


def _measured(history: list[PlantState], hardware: Hardware, period: float) -> np.ndarray:
    """Compute the measured positions (n,) from the latest states, newest first."""
    late = hardware.delay / period
    periods, joints = late.astype(int), np.arange(len(late))
    q, qd = (np.array([getattr(state, name) for state in history]) for name in ("q", "qd"))
    past, speed, before = q[periods, joints], qd[periods, joints], qd[periods + 1, joints]
    back = (late - periods) * period
    return rounded(past - back * speed + back**2 / (2 * period) * (speed - before), hardware.position_quantum)
