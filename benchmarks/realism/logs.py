"""Logs of a plant with one departure, and the gains behind them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import polars as pl

from gtau.model.inverse_dynamics import InverseDynamics
from gtau.signals.run import Run, read_run
from realism.departures import Departure, Drives
from realism.plants import Plant

LOADED = (False, True, False, True)
NOISE = 0.003  # of a joint's rms current
DRIFT = 0.02  # relative change of friction from run to run
DRIVE = ("ia", "fv", "fs", "off")


def make_logs(plant: Plant, departure: Departure, seed: int) -> tuple[list[Run], np.ndarray]:
    """Runs in turn without and with the payload, spoilt by one departure, and the true gains (n,)."""
    rng, model = np.random.default_rng([11, seed]), plant.model
    chi, n, rate = plant.parameters(model, rng), len(model.actuated), departure.rate or plant.rate
    gains = rng.uniform(*np.broadcast_to(plant.gains, (n, 2)).T)
    time = np.arange(round(plant.seconds * rate) + 1) / rate
    runs, drives, inertias = [], None, None
    for k, loaded in enumerate(LOADED):
        if not (loaded and departure.repeated):
            motion = departure.motion(plant.within(model.robot), plant.seconds, rng)(time)
        now = {name: value * (1 + DRIFT * k * name.startswith(("fv_", "fs_"))) for name, value in chi.items()}
        if loaded:
            carried = {f"{kind}_{model.robot.tool}": value for kind, value in plant.payload().items()}
            now |= {name: now[name] + value for name, value in carried.items() if name in model.parameter_names}
        if departure.deflection is not None and inertias is None:  # of the empty robot: stiffness knows no payload
            inertias = _inertias(model, chi, motion[0])
        q, qd, tau, carried = _drive(model, now, inertias, motion, departure, rate)
        drives = drives or Drives(_rms(tau), _rms(qd), np.abs(tau / gains).max(axis=0))
        if departure.torque is not None:
            tau = tau + departure.torque(time, q, qd, tau, carried, drives)
        v = (tau + NOISE * _rms(tau) * rng.standard_normal(tau.shape)) / gains
        v = v if departure.current is None else departure.current(v, rate, rng, drives)
        q = q if departure.position is None else departure.position(q, rng)
        stamps = time if departure.stamps is None else departure.stamps(time, rng)
        runs.append(_run(model, f"run {k + 1}", stamps, q, v, _declared(plant, departure) if loaded else None))
    return runs, gains


def _drive(
    model: InverseDynamics,
    chi: dict[str, float],
    inertias: np.ndarray | None,
    motion: tuple[np.ndarray, np.ndarray, np.ndarray],
    departure: Departure,
    rate: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Positions, velocities and torques of the motors, and the torques that the links take; (N, n) each.

    Where the transmissions give way, the motors lead the links; their stiffness follows from the ``inertias`` (n,).
    """
    of_motors = {f"{kind}_{joint}" for kind in DRIVE for joint in model.actuated}
    carried = model.torques(*motion, {name: value for name, value in chi.items() if name not in of_motors})
    q, qd, qdd = motion
    if departure.deflection is not None:
        q = q + departure.deflection(carried, inertias, rate)
        qd = np.gradient(q, 1 / rate, axis=0)
        qdd = np.gradient(qd, 1 / rate, axis=0)
    ia, fv, fs, off = (np.array([chi.get(f"{kind}_{joint}", 0.0) for joint in model.actuated]) for kind in DRIVE)
    return q, qd, carried + ia * qdd + fv * qd + fs * np.sign(qd) + off, carried


def _inertias(model: InverseDynamics, chi: dict[str, float], q: np.ndarray) -> np.ndarray:
    """Inertia (n,) of rotor and links about each joint at the mean pose, the other joints held."""
    n = q.shape[1]
    still = {name: value for name, value in chi.items() if not name.startswith(("fv_", "fs_", "off_"))}
    poses, rest = np.tile(q.mean(axis=0), (n, 1)), np.zeros((n, n))
    return np.diag(model.torques(poses, rest, np.eye(n), still) - model.torques(poses, rest, rest, still))


def _declared(plant: Plant, departure: Departure) -> dict[str, object]:
    """The payload as the experiment file describes it."""
    payload: dict[str, object] = {"name": "disc", "mass": plant.mass * departure.mass}
    if departure.centre_off is not None:
        centre = np.array(plant.centre) + departure.centre_off * np.array([1.0, 0.0, 0.0])
        payload["parameters"] = dict(zip(("mx", "my", "mz"), map(float, plant.mass * centre), strict=True))
    return payload


def _run(
    model: InverseDynamics, name: str, stamps: np.ndarray, q: np.ndarray, v: np.ndarray, payload: dict | None
) -> Run:
    """The run as it is read from a table, with the checks of a log."""
    n = len(model.actuated)
    names = [f"{what}{j}" for what in ("q", "v") for j in range(n)]
    table = pl.DataFrame(dict(zip(["t", *names], [stamps, *q.T, *v.T], strict=True)))
    signals = {
        "time": "t",
        "position": {joint: f"q{j}" for j, joint in enumerate(model.actuated)},
        "current": {joint: f"v{j}" for j, joint in enumerate(model.actuated)},
    }
    return replace(read_run(table, signals, payload), name=name)


def _rms(values: np.ndarray) -> np.ndarray:
    """Root of the mean square, (n,), of signals (N, n)."""
    return np.sqrt(np.mean(values**2, axis=0))
