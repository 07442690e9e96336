"""Motor, model and external torques along a log, for contact detection.

The observer of generalized momentum ``p = M qd`` gives a causal estimate:

    ``dp/dt = tau + tau_ext + C^T qd - g - friction``, so ``r`` with ``dr/dt = K (tau_ext - r)`` needs no acceleration.

A. De Luca, R. Mattone, "Actuator failure detection and isolation using generalized momenta", ICRA 2003; S. Haddadin,
A. De Luca, A. Albu-Schaeffer, "Robot collisions: a survey on detection, isolation, and identification", T-RO 2017.

Each step integrates r exactly for a constant torque, so that any bandwidth and any period are stable. Momenta are
evaluated half-way between two positions, where their difference over the period is the velocity, and torques half-way
between two of these instants: no term lags another. The exported C takes the same steps.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from gtau.documents import files
from gtau.documents.validation import NUMBER, takes
from gtau.errors import GtauError
from gtau.estimation.results.estimate import TorqueError
from gtau.estimation.results.predicted import Prediction, torque_errors
from gtau.estimation.results.result import IdentifiedModel
from gtau.robots.floating import refuse_floating
from gtau.robots.parameter import BY_LOAD, torque_unit
from gtau.robots.robot import Placement
from gtau.signals.run import Run
from gtau.uses.identified import OBSERVED, functions, identified
from gtau.uses.prediction import loaded_parameters, predict, suited
from gtau.uses.wrench import WrenchAlongLog, wrench_along_log

if TYPE_CHECKING:
    import polars as pl

PASSES = 2  # each leaves fl of the error of the last one; fl is below 0.1 on a UR10e
USABLE = 4.0  # standard deviations: Gaussian residuals exceed them once in 16,000 rows


@dataclass(frozen=True, eq=False)
class External:
    """External torque of a joint along a log.

    ``residual`` is the rms torque residual of the identification; ``rms`` and ``largest`` (at ``time``, s) are over the
    samples away from reversals, ``share`` is the part of them beyond four residuals; ``rms_all`` is over all valid
    samples. N m or N.
    """

    joint: str
    unit: str
    residual: float | None
    rms: float
    rms_all: float
    largest: float
    time: float
    share: float | None


@dataclass(frozen=True, eq=False)
class TorquesAlongLog:
    """Table with one row per sample, and a summary per joint.

    The table has the columns of :meth:`gtau.Prediction.table` and, if requested, the causal estimate of the external
    torques ``observed_J`` and the columns of the ``wrench`` at a frame. All are behind the low-pass of identification;
    ``errors`` also compare with the raw torque, by frequency.
    """

    table: pl.DataFrame
    joints: tuple[External, ...]
    errors: tuple[TorqueError, ...]
    wrench: WrenchAlongLog | None = None


def torques_along_log(
    result: IdentifiedModel,
    run: Run,
    frame: tuple[str, Placement] | None = None,
    force_only: bool = False,
    bandwidth: float | None = None,
) -> TorquesAlongLog:
    """Compute motor, model and external torques at every sample of a run, after the low-pass of identification.

    With a ``frame``, also the wrench there, a pure force if ``force_only``; see
    :func:`gtau.uses.wrench.wrench_along_log`. With a ``bandwidth``, Hz, also the estimate of :func:`momentum_observer`.
    Raises GtauError where the run does not suit the robot, or the model refuses a sample.
    """
    raw = predict_under_load(result, run)
    prediction = raw.in_band
    residual = {error.joint: error.rms for error in result.residuals}
    joints = [
        _summary(prediction.of([joint]), torque_unit(result.robot, joint), residual.get(joint))
        for j, joint in enumerate(prediction.joints)
        if prediction.keep[:, j].any()
    ]
    table, wrench = prediction.table(), None
    if bandwidth is not None:
        observed = momentum_observer(result, run, bandwidth)
        table = table.with_columns(**{f"observed_{joint}": observed[:, j] for j, joint in enumerate(prediction.joints)})
    if frame is not None:
        wrench = wrench_along_log(result, run, prediction, frame, force_only)
        table = table.with_columns(**wrench.columns).fill_nan(None)
    return TorquesAlongLog(table, tuple(joints), torque_errors(raw, result.robot, result.preparation.bandwidth), wrench)


def predict_under_load(result: IdentifiedModel, run: Run) -> Prediction:
    """Predict torques, with load-dependent friction under the external torques too."""
    prediction = predict(result, run)
    for _ in range(PASSES * any(name.kind in BY_LOAD for name in result.friction_parameters)):
        behind = prediction.in_band
        prediction = predict(result, run, behind.predicted - behind.measured)
    return prediction


@takes(result=("a result", (IdentifiedModel,)), run=("a run (gtau.read_run)", (Run,)), bandwidth=NUMBER)
def momentum_observer(result: IdentifiedModel, run: Run, bandwidth: float) -> np.ndarray:
    """Estimate external torques along a run causally, as the exported C observer does.

    Parameters
    ----------
    result : IdentifiedModel
        Identified model of the robot.
    run : Run
        Its positions are differentiated over one sample; its commands are taken at their delayed times. A delay below
        zero, of commands that are logged late, delays the estimate by as much.
    bandwidth : float
        Bandwidth of the observer, ``K / 2 pi``, Hz.

    Returns
    -------
    ndarray
        External torques (N, n), exerted by the environment on each joint, N m or N; 0 before the third sample.

    Raises
    ------
    GtauError
        Where the run does not suit the robot, the loops cannot be closed, or the bandwidth is not positive.
    """
    if not 0 < bandwidth < np.inf:
        raise GtauError(f"the bandwidth of the observer is {bandwidth:g} Hz; write a positive number.")
    refuse_floating(result.robot, "the momentum observer is")
    run = suited(result, run)
    n, time = len(run.joints), np.asarray(run.time)
    delays = np.array([result.delays[joint].value or 0.0 for joint in run.joints])
    late = max(0.0, -delays.min())
    torque = np.stack(
        [np.interp(time - late - delay, time, run.command[:, j]) for j, delay in enumerate(delays)], axis=1
    )
    q = np.stack([np.interp(time - late, time, run.position[:, j]) for j in range(n)], axis=1)
    values = identified(result).values
    if run.payload is not None:
        values[: result.base.count] += loaded_parameters(result, run.payload, f"run '{run.name}'")
        values[: result.base.count] -= loaded_parameters(result, None, "")
    return observed(result, values, time, q, torque * result.gains, bandwidth)


def observed(
    result: IdentifiedModel, values: np.ndarray, time: np.ndarray, q: np.ndarray, torque: np.ndarray, bandwidth: float
) -> np.ndarray:
    """Observe external torques (N, n) for parameters ``values`` (n_p,), positions and motors' torques (N, n)."""
    made = functions(identified(result)).outputs
    h = np.diff(time)
    middle, qd = (q[1:] + q[:-1]) / 2, np.diff(q, axis=0) / h[:, None]
    path = np.vstack([q[:1], middle]).T
    motion = result.idm.motion(path, 0 * path, 0 * path)
    states = np.vstack([motion.c, result.friction_law.followers(lambda _: path)(time)])
    given = ca.DM(states[:, 1:]), ca.DM(qd.T), ca.DM.zeros(*qd.T.shape), ca.DM(values)
    momentum, drift = (np.array(made[output](*given)).reshape(-1, len(qd), order="F").T for output in OBSERVED)
    push = (torque[1:] + torque[:-1]) / 2 + drift
    apart = (h[1:] + h[:-1]) / 2
    unfiltered = np.diff(momentum, axis=0) / apart[:, None] - (push[1:] + push[:-1]) / 2
    kept = np.exp(-2 * np.pi * bandwidth * apart)
    external = np.zeros_like(q)
    for k in range(2, len(q)):
        external[k] = kept[k - 2] * external[k - 1] + (1.0 - kept[k - 2]) * unfiltered[k - 2]
    return external


def _summary(torque: Prediction, unit: str, residual: float | None) -> External:
    external, keep, valid = (
        columns[:, 0] for columns in (torque.predicted - torque.measured, torque.keep, torque.valid)
    )
    kept = external[keep]
    worst = int(np.argmax(np.abs(kept)))
    beyond = None if residual is None else float(np.mean(np.abs(kept) > USABLE * residual))
    rms, rms_all = (float(np.sqrt(np.mean(values**2))) for values in (kept, external[valid]))
    largest, time = float(kept[worst]), float(torque.time[keep][worst])
    return External(torque.joints[0], unit, residual, rms, rms_all, largest, time, beyond)


def write_table(torques: TorquesAlongLog, path: Path) -> None:
    """Write the table as Parquet or CSV, by the ending of ``path``; raises GtauError."""
    if path.suffix.lower() not in (".csv", ".parquet"):
        raise GtauError(f"{path} ends in neither .csv nor .parquet; give the table one of these endings.")
    files.write_table(torques.table, path)
