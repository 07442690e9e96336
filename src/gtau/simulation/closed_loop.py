"""Sampled simulation of a robot under control: control law, drives, plant and sensors.

The control laws of the paper (section 5.2) have the same linear part. The force is ``inertia`` (kp e + ki int e +
kd (weight qd_r - qd)) + ``feedforward``, with ``e = q_r - q``. The laws differ in the inertia, in the ``weight`` of the
reference velocity (0: simple PID, 1: velocity feedforward) and in the feedforward. The gains place the three poles of a
rigid axis at the bandwidth.
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
FILTER = 10.0  # bandwidth of the derivative's filter over the bandwidth of the loop
DIGITS = 9  # decimals in logs, finer than any encoder


@dataclass(frozen=True, eq=False)
class Reference:
    """Sampled motion of the actuated joints: ``time`` (N,), uniform, and ``q``, ``qd``, ``qdd`` (N, n)."""

    time: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray


def sample(trajectory: Trajectory, duration: float, rate: float) -> Reference:
    """Sample a trajectory at ``rate`` Hz for ``duration`` s."""
    time = np.arange(round(duration * rate) + 1) / rate
    return Reference(time, *trajectory(time))


@dataclass(frozen=True, eq=False)
class Controller:
    """A control law along a reference: ``inertia`` (N, n, n), ``feedforward`` (N, n), drive ``gains`` (n,), rad/s."""

    reference: Reference
    inertia: np.ndarray
    feedforward: np.ndarray
    gains: np.ndarray
    weight: float
    bandwidth: float


def pid(
    reference: Reference, inertia: np.ndarray, gains: np.ndarray, bandwidth: float = BANDWIDTH, weight: float = 1.0
) -> Controller:
    """Make a PID with an ``inertia`` (n, n) or (N, n, n); a ``weight`` of 0 gives the paper's simple PID."""
    inertias = np.broadcast_to(inertia, (*reference.q.shape, reference.q.shape[1]))
    return Controller(reference, inertias, np.zeros_like(reference.q), gains, weight, bandwidth)


def _not_zero(gain: float) -> float:
    if gain == 0:
        raise ValueError("a drive with a gain of 0 gives no torque; write its N m/A (or N per A)")
    return gain


class JointHardware(Keys):
    """Drive and sensors of a joint.

    The drive holds the current of a controller sample, limited to ``current_limit`` A, and converts it to force by
    ``gain``, N m/A or N per A. A ripple of amplitude ``ripple`` (N m or N) repeats every ``ripple_period`` (rad or m).
    Positions are delayed by ``delay`` s and rounded to ``position_quantum``, rad or m. Logged currents have white noise
    of the rms ``current_noise``, A, and are rounded to ``current_quantum``, A.
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
    """Drives and sensors of all actuated joints, every field an array (n,)."""

    gain: np.ndarray
    current_limit: np.ndarray
    ripple: np.ndarray
    ripple_period: np.ndarray
    position_quantum: np.ndarray
    delay: np.ndarray
    current_noise: np.ndarray
    current_quantum: np.ndarray

    def force(self, current: np.ndarray, q: np.ndarray, phase: np.ndarray) -> np.ndarray:
        """Compute forces (n,) from currents (n,) at positions ``q`` (n,), with the ripple's ``phase`` (n,), rad."""
        return self.gain * current + self.ripple * np.sin(2 * np.pi * q / self.ripple_period + phase)

    def measured(self, history: Sequence[PlantState], period: float) -> np.ndarray:
        """Compute the measured positions (n,) from the last states, newest first, ``period`` s apart."""
        late = self.delay / period
        periods, joints = late.astype(int), np.arange(len(late))
        q, qd = (np.array([getattr(state, name) for state in history]) for name in ("q", "qd"))
        past, speed, before = q[periods, joints], qd[periods, joints], qd[periods + 1, joints]
        back = (late - periods) * period
        return rounded(past - back * speed + back**2 / (2 * period) * (speed - before), self.position_quantum)


def hardware(joints: Sequence[str], drives: Mapping[str, JointHardware]) -> Hardware:
    """Stack the drives and sensors of ``joints``, in this order."""
    rows = [{"current_limit": inf} | drives[joint].model_dump(exclude_none=True) for joint in joints]
    return Hardware(**{name: np.array([row[name] for row in rows]) for name in JointHardware.model_fields})


def rounded(values: np.ndarray, quantum: np.ndarray) -> np.ndarray:
    """Round values to multiples of a quantum; a quantum of zero leaves them unchanged."""
    step = np.where(quantum > 0, quantum, 1.0)
    return np.where(quantum > 0, np.round(values / step) * step, values)


class Engine(Protocol):
    """Dynamics engine of the robot: :class:`~gtau.simulation.plant.Plant` or its MuJoCo counterpart."""

    def start(self, q: np.ndarray) -> PlantState:
        """Return the state at rest at actuated positions."""

    def advance(self, state: PlantState, force: np.ndarray, duration: float) -> PlantState:
        """Advance the state under constant forces."""


@dataclass(frozen=True, eq=False)
class Simulated:
    """A simulated run: the log, and the true tracking ``error`` (N, n), rad or m."""

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
    """Simulate a robot that follows the controller's reference.

    In every sample, positions are measured, and currents are computed, logged and held. ``rng`` draws the noise and the
    phase of the ripple. Raises GtauError if the robot reaches a singular pose or the control loop diverges.
    """
    reference, bandwidth = controller.reference, controller.bandwidth
    samples, n = reference.q.shape
    period = float(reference.time[1] - reference.time[0])
    kp, ki, kd = 3 * bandwidth**2, bandwidth**3, 3 * bandwidth
    blend = float(np.exp(-FILTER * bandwidth * period))
    phase = rng.uniform(0.0, 2 * np.pi, (1, n))[0]
    state = engine.start(reference.q[0])
    history = [state] * (2 + int(np.ceil(hardware.delay.max() / period)))
    position, current, error = (np.empty((samples, n)) for _ in range(3))
    slope, integral = np.zeros(n), np.zeros(n)
    behind = controller.weight * reference.q[0] - hardware.measured(history, period)
    for k in range(samples):
        measured = hardware.measured(history, period)
        e, ahead = reference.q[k] - measured, controller.weight * reference.q[k] - measured
        slope = blend * slope + (1 - blend) * (ahead - behind) / period
        behind = ahead
        pushed = kp * e + ki * (integral + period * e) + kd * slope
        wanted = (controller.inertia[k] @ pushed + controller.feedforward[k]) / controller.gains
        current[k] = np.clip(wanted, -hardware.current_limit, hardware.current_limit)
        integral = integral + period * np.where(current[k] == wanted, e, 0.0)  # no windup at the limit
        position[k], error[k] = measured, reference.q[k] - state.q
        state = engine.advance(state, hardware.force(current[k], state.q, phase), period)
        history = [state, *history[:-1]]
        if k % 1000 == 0:
            progress(k, samples)
    progress(samples, samples)
    logged = rounded(current + hardware.current_noise * rng.standard_normal(current.shape), hardware.current_quantum)
    run = Run(name, joints, reference.time, np.round(position, DIGITS), np.round(logged, DIGITS))
    return Simulated(run, error)


def write_log(run: Run, path: str | Path) -> None:
    """Write a run as CSV, atomically; columns are ``t``, and ``q`` and ``v`` followed by the joint's name."""
    import polars as pl

    columns = {"t": np.round(run.time, DIGITS)}
    columns |= {log_column("q", joint): run.position[:, j] for j, joint in enumerate(run.joints)}
    columns |= {log_column("v", joint): run.command[:, j] for j, joint in enumerate(run.joints)}
    write_table(pl.DataFrame(columns), path)
