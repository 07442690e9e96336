"""Logs made by inverse dynamics: what a drive and its sensors would have recorded along a trajectory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from idim.files import write_atomically
from idim.model.inverse_dynamics import InverseDynamics
from idim.signals.experiment import Payload
from idim.signals.run import Run
from idim.simulation.trajectories import Trajectory

DIGITS = 9  # decimals of a written log, finer than any encoder


@dataclass(frozen=True)
class Drive:
    """A joint's drive and sensors.

    ``gain`` in N m/A or N/A. The current runs ahead of the position by ``delay`` s. A ripple of amplitude
    ``ripple`` (N m or N) repeats every ``ripple_period`` (rad or m). The logged current has white noise of
    the rms ``current_noise`` and is rounded to ``current_quantum``, both in A; the position is rounded to
    ``position_quantum``, rad or m.
    """

    gain: float
    delay: float
    ripple: float
    ripple_period: float
    current_noise: float
    current_quantum: float
    position_quantum: float


def synthetic_run(
    name: str,
    model: InverseDynamics,
    trajectory: Trajectory,
    time: np.ndarray,
    chi: Mapping[str, float],
    drives: Mapping[str, Drive],
    rng: np.random.Generator,
    payload: Payload | None = None,
) -> Run:
    """The run that a robot with standard parameters ``chi`` would have logged.

    Parameters
    ----------
    name : str
        Of the run.
    model : InverseDynamics
        Of the robot, with all parameters.
    trajectory : callable
        From :mod:`idim.simulation.trajectories`.
    time : ndarray
        Instants of the samples, (N,) in s.
    chi : mapping
        Standard parameters by name, SI units; what is missing is zero.
    drives : mapping
        Actuated joint to its drive.
    rng : Generator
        Of the noise.
    payload : Payload, optional
        A further body fixed to ``robot.tool``; what it does not state is zero.

    Raises
    ------
    IdimError
        Where the trajectory leaves what the robot can reach, or comes too close to a singular pose.
    """
    chi = dict(chi)
    if payload is not None:
        for kind, value in {"m": payload.mass or 0.0, **payload.parameters}.items():
            standard = f"{kind}_{model.robot.tool}"
            chi[standard] = chi.get(standard, 0.0) + value
    position, command = trajectory(time)[0], np.empty((len(time), len(model.actuated)))
    ahead = {
        delay: model.torques(*trajectory(time + delay), chi) for delay in {drive.delay for drive in drives.values()}
    }
    for j, joint in enumerate(model.actuated):
        drive = drives[joint]
        angle = 2 * np.pi * position[:, j] / drive.ripple_period + rng.uniform(0.0, 2 * np.pi)
        torque = ahead[drive.delay][:, j] + drive.ripple * np.sin(angle)
        current = torque / drive.gain + drive.current_noise * rng.standard_normal(len(time))
        command[:, j] = _rounded(current, drive.current_quantum)
        position[:, j] = _rounded(position[:, j], drive.position_quantum)
    return Run(name, model.actuated, time, position, command, payload=payload)


def _rounded(signal: np.ndarray, quantum: float) -> np.ndarray:
    return np.round(np.round(signal / quantum) * quantum, DIGITS)


def write_log(run: Run, path: str | Path) -> None:
    """Write a run as CSV, atomically: ``t``, then ``q`` and the joint's name, then ``v`` and the joint's name."""
    import polars as pl

    columns = {"t": np.round(run.time, DIGITS)}
    columns |= {f"q{joint}": run.position[:, j] for j, joint in enumerate(run.joints)}
    columns |= {f"v{joint}": run.command[:, j] for j, joint in enumerate(run.joints)}
    write_atomically(path, pl.DataFrame(columns).write_csv())
