"""Sampled simulation of a robot under control: control law, drives, plant and sensors.

The control laws of the paper (section 5.2) have the same linear part. The force is ``inertia`` (kp e + ki int e +
kd (weight qd_r - qd)) + ``feedforward``, with ``e = q_r - q``. The laws differ in the inertia, in the ``weight`` of the
reference velocity (0: simple PID, 1: velocity feedforward) and in the feedforward. The gains place the three poles of a
rigid axis at the bandwidth.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf, nan
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field, FiniteFloat, model_validator

from gtau.documents.files import write_table
from gtau.documents.validation import Keys, Positive
from gtau.estimation.electrical import CONVENTIONS
from gtau.signals.channel import SIDE_SIGNALS, SideValues
from gtau.signals.run import Log, Run
from gtau.simulation.mujoco_plant import MujocoPlant
from gtau.simulation.plant import Plant, PlantState
from gtau.simulation.trajectories import NotNegative, Trajectory

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
    if abs(gain) < 1e-12:
        raise ValueError(f"a drive with a gain of {gain:g} gives no torque; write its N m/A (or N per A)")
    return gain


class JointHardware(Keys):
    """Drive and sensors of a joint.

    The drive holds the current of a controller sample, limited to ``current_limit`` A, and converts it to force by
    ``gain``, N m/A or N per A. A ripple of amplitude ``ripple`` (N m or N) repeats every ``ripple_period`` (rad or m).
    Positions are delayed by ``delay`` s and rounded to ``position_quantum``, rad or m. Logged currents have white noise
    of the rms ``current_noise``, A, and are rounded to ``current_quantum``, A.

    On a supply, the motor has the ``resistance`` (ohm), which grows by ``warming`` of itself along a run,
    ``inductance`` (H) and ``convention`` of experiment files; its torque constant differs from its back-EMF constant by
    a number drawn with the relative standard deviation ``commutation``. The bridge loses ``dead_time`` of the supply
    voltage; logged duties are rounded to ``duty_quantum``. A drive with ``proportional_gain`` (1/rad or 1/m) is a
    servo: its duty is this gain times goal less position, none within its ``dead_band`` (rad or m).
    """

    gain: Annotated[FiniteFloat, AfterValidator(_not_zero)]
    current_limit: Positive | None = None
    ripple: NotNegative = 0.0
    ripple_period: Positive = 1.0
    position_quantum: NotNegative = 0.0
    delay: Annotated[FiniteFloat, Field(ge=0, le=0.1)] = 0.0
    current_noise: NotNegative = 0.0
    current_quantum: NotNegative = 0.0
    resistance: Positive | None = None
    inductance: NotNegative = 0.0
    warming: NotNegative = 0.0
    convention: Literal["dc", "amplitude", "power"] = "dc"
    commutation: Annotated[FiniteFloat, Field(ge=0, le=0.2)] = 0.0
    dead_time: Annotated[FiniteFloat, Field(ge=0, lt=0.5)] = 0.0
    duty_quantum: NotNegative = 0.0
    proportional_gain: Positive | None = None
    dead_band: NotNegative = 0.0

    @model_validator(mode="after")
    def _no_key_in_vain(self) -> JointHardware:
        for key, why in (("current_limit", "is limited by its voltage"), ("inductance", "has currents without a lag")):
            if self.proportional_gain is not None and getattr(self, key):
                raise ValueError(f"a servo ('proportional_gain') {why}; remove '{key}'")
        for key, other in (("ripple_period", "ripple"), ("dead_band", "proportional_gain")):
            if key in self.model_dump(exclude_defaults=True) and not getattr(self, other):
                raise ValueError(f"'{key}' has no effect without '{other}'; add '{other}', or remove '{key}'")
        return self


@dataclass(frozen=True, eq=False)
class Hardware:
    """Drives and sensors of all actuated joints: ``keys`` as above, each an array (n,), and motors on a supply."""

    keys: Mapping[str, np.ndarray]
    motors: MotorDrives | None = None

    def force(self, current: np.ndarray, q: np.ndarray, phase: np.ndarray) -> np.ndarray:
        """Compute forces (n,) from currents (n,) at positions ``q`` (n,), with the ripple's ``phase`` (n,), rad."""
        ripple = self.keys["ripple"] * np.sin(2 * np.pi * q / self.keys["ripple_period"] + phase)
        return np.asarray(self.keys["gain"] * current + ripple)

    def measured(self, history: Sequence[PlantState], period: float) -> np.ndarray:
        """Compute the measured positions (n,) from the last states, newest first, ``period`` s apart."""
        late = self.keys["delay"] / period
        periods, joints = late.astype(int), np.arange(len(late))
        q, qd = (np.array([getattr(state, name) for state in history]) for name in ("q", "qd"))
        past, speed, before = q[periods, joints], qd[periods, joints], qd[periods + 1, joints]
        back = (late - periods) * period
        exact = past - back * speed + back**2 / (2 * period) * (speed - before)
        return rounded(exact, self.keys["position_quantum"])


def hardware(
    joints: Sequence[str], drives: Mapping[str, JointHardware], supply: Supply | None = None, seed: int = 0
) -> Hardware:
    """Stack the drives and sensors of ``joints``, in this order; the ``seed`` draws constants of motors on a supply."""
    missing = {"current_limit": inf, "resistance": nan, "proportional_gain": nan}
    rows = [missing | drives[joint].model_dump(exclude_none=True) for joint in joints]
    columns = {name: np.array([row[name] for row in rows]) for name in JointHardware.model_fields}
    drawn = np.random.default_rng([seed, len(joints)]).standard_normal(len(joints))
    c = np.array([CONVENTIONS[name] for name in columns["convention"]])
    emf = columns["gain"] / (1 + columns["commutation"] * drawn) / c
    return Hardware(columns, None if supply is None else MotorDrives(supply, emf, columns))


@dataclass(frozen=True, eq=False)
class Simulated:
    """A simulated run: the log, and the true tracking ``error`` (N, n), rad or m."""

    run: Run
    error: np.ndarray


def close_loop(
    name: str,
    engine: Plant | MujocoPlant,
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
    history = [state] * (2 + int(np.ceil(hardware.keys["delay"].max() / period)))
    position, current, error, duty = (np.empty((samples, n)) for _ in range(4))
    motors, voltage = hardware.motors, np.empty(samples)
    supplied = nan if motors is None else motors.supply.voltage
    slope, integral, limit = np.zeros(n), np.zeros(n), hardware.keys["current_limit"]
    behind = controller.weight * reference.q[0] - hardware.measured(history, period)
    for k in range(samples):
        measured = hardware.measured(history, period)
        e, ahead = reference.q[k] - measured, controller.weight * reference.q[k] - measured
        slope = blend * slope + (1 - blend) * (ahead - behind) / period
        behind = ahead
        pushed = kp * e + ki * (integral + period * e) + kd * slope
        wanted = (controller.inertia[k] @ pushed + controller.feedforward[k]) / controller.gains
        current[k] = np.clip(wanted, -limit, limit)
        if motors is not None:
            voltage[k] = supplied
            current[k], duty[k] = motors.currents(current[k], e, state.qd, supplied, k / samples)
            supplied = motors.supply.voltage - motors.supply.resistance * float(np.sum(current[k] * duty[k]))
        integral = integral + period * np.where(current[k] == wanted, e, 0.0)  # no windup at the limit
        position[k], error[k] = measured, reference.q[k] - state.q
        state = engine.advance(state, hardware.force(current[k], state.q, phase), period)
        history = [state, *history[:-1]]
        if k % 1000 == 0:
            progress(k, samples)
    progress(samples, samples)
    noise = hardware.keys["current_noise"] * rng.standard_normal(current.shape)
    logged, side = rounded(current + noise, hardware.keys["current_quantum"]), dict[str, SideValues]()
    if motors is not None:
        beside = motors.logged(period, current, duty, voltage, reference.q)
        beside["supply_current"] = rounded(beside["supply_current"] + noise, hardware.keys["current_quantum"])
        side = {key: _side(reference.time, values, joints, key) for key, values in beside.items()}
    run = Run(name, joints, reference.time, np.round(position, DIGITS), np.round(logged, DIGITS), log=Log(side=side))
    return Simulated(run, error)


def _side(time: np.ndarray, values: np.ndarray, joints: Sequence[str], key: str) -> SideValues:
    """Make a side signal of values (N, n)."""
    (unit,) = (signal.units[0] for signal in SIDE_SIGNALS if signal.key == key)
    return SideValues(time, dict(zip(joints, np.round(values, DIGITS).T, strict=True)), unit)


def write_log(run: Run, path: str | Path) -> None:
    """Write a run as CSV, atomically: ``t``; ``q``, ``v`` and ``duty_``, or another signal, before the joint's name."""
    import polars as pl

    beside = {f"{key}_{joint}": values for key, side in run.side.items() for joint, values in side.by_joint.items()}
    table = run.to_frame().with_columns(pl.col("t").round(DIGITS), **beside)
    write_table(table.rename(str.rstrip), path)  # readers strip blanks
