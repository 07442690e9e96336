"""Causal estimate of external torques by the observer of generalized momentum ``p = M qd``.

    ``dp/dt = tau + tau_ext + C^T qd - g - friction``, so ``r`` with ``dr/dt = K (tau_ext - r)`` needs no acceleration.

A. De Luca, R. Mattone, "Actuator failure detection and isolation using generalized momenta", ICRA 2003; S. Haddadin,
A. De Luca, A. Albu-Schaeffer, "Robot collisions: a survey on detection, isolation, and identification", T-RO 2017.

Each step integrates r exactly for a torque that is constant in it, so that any bandwidth and any period are stable.
Momenta are those half-way between two positions, where their difference over the period is the velocity, and torques
are those half-way between two of these instants: no term lags another. The exported C takes the same steps.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from gtau.documents.validation import NUMBER, takes
from gtau.errors import GtauError
from gtau.estimation.results.prediction import loaded_parameters, suited
from gtau.estimation.results.result import Result
from gtau.export.functions import OBSERVED, functions
from gtau.export.identified import identified
from gtau.robots.floating import refuse_floating
from gtau.signals.run import Run


@takes(result=("a result", (Result,)), run=("a run (gtau.read_run)", (Run,)), bandwidth=NUMBER)
def momentum_observer(result: Result, run: Run, bandwidth: float) -> np.ndarray:
    """Estimate external torques along a run causally, as the exported C observer does.

    Parameters
    ----------
    result : Result
        Of the robot.
    run : Run
        Its positions are differentiated over one sample; its commands are taken at their delayed times. A delay below
        zero, of commands that are logged late, delays the estimate by as much.
    bandwidth : float
        Of the observer, ``K / 2 pi``, Hz.

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
    result: Result, values: np.ndarray, time: np.ndarray, q: np.ndarray, torque: np.ndarray, bandwidth: float
) -> np.ndarray:
    """Observe external torques (N, n) for parameters ``values`` (n_p,), positions and motors' torques (N, n)."""
    made = functions(identified(result)).outputs
    h = np.diff(time)
    middle, qd = (q[1:] + q[:-1]) / 2, np.diff(q, axis=0) / h[:, None]
    path = np.vstack([q[:1], middle]).T
    motion = result.model.motion(path, 0 * path, 0 * path)
    states = np.vstack([motion.c, result.friction_law.followers(lambda _: path)(time)])
    given = ca.DM(states[:, 1:]), ca.DM(qd.T), ca.DM.zeros(*qd.T.shape), ca.DM(values)
    momentum, drift = (np.array(made[each](*given)).reshape(-1, len(qd), order="F").T for each in OBSERVED)
    push = (torque[1:] + torque[:-1]) / 2 + drift
    apart = (h[1:] + h[:-1]) / 2
    found = np.diff(momentum, axis=0) / apart[:, None] - (push[1:] + push[:-1]) / 2
    kept = np.exp(-2 * np.pi * bandwidth * apart)
    external = np.zeros_like(q)
    for k in range(2, len(q)):
        external[k] = kept[k - 2] * external[k - 1] + (1.0 - kept[k - 2]) * found[k - 2]
    return external
