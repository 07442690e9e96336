"""Control laws that the paper compares (section 5.2), all with the same linear part.

Force = ``inertia`` (kp e + ki int e + kd (weight qd_r - qd)) + ``feedforward``, with ``e = q_r - q``. The laws differ
in the inertia, in the ``weight`` of the reference's velocity (0: simple PID, 1: velocity feedforward) and in the
feedforward. The gains put the three poles of a rigid axis at the bandwidth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gtau.estimation.regression.column_blocks import known_values
from gtau.estimation.results.prediction import torques_along
from gtau.estimation.results.result import Result
from gtau.model.loops import Motion
from gtau.robots.parameter import Parameter
from gtau.signals.payload import Payload
from gtau.simulation.trajectories import Trajectory

BANDWIDTH = 100.0  # rad/s
FILTER = 10.0  # the derivative is filtered at this multiple of the bandwidth


@dataclass(frozen=True, eq=False)
class Reference:
    """Sampled motion of the actuated joints: ``time`` (N,), uniform, and ``q``, ``qd``, ``qdd`` (N, n)."""

    time: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray


@dataclass(frozen=True, eq=False)
class Controller:
    """A control law along a reference, sampled as that is.

    ``inertia`` (N, n, n) and ``feedforward`` (N, n); ``gains`` (n,) are the drive gains by which it turns forces into
    currents; ``bandwidth`` in rad/s.
    """

    reference: Reference
    inertia: np.ndarray
    feedforward: np.ndarray
    gains: np.ndarray
    weight: float
    bandwidth: float

    @property
    def pid(self) -> tuple[float, float, float]:
        """Proportional, integral and derivative gain for an axis of unit inertia."""
        return 3 * self.bandwidth**2, self.bandwidth**3, 3 * self.bandwidth


def sample(trajectory: Trajectory, duration: float, rate: float) -> Reference:
    """Sample a trajectory at ``rate`` Hz for ``duration`` s."""
    time = np.arange(round(duration * rate) + 1) / rate
    return Reference(time, *trajectory(time))


def simple_pid(
    reference: Reference, inertia: np.ndarray, gains: np.ndarray, bandwidth: float = BANDWIDTH
) -> Controller:
    """Make a PID with an ``inertia`` (n, n), kg or kg m2, or one for every sample (N, n, n)."""
    inertias = np.broadcast_to(inertia, (*reference.q.shape, reference.q.shape[1]))
    return Controller(reference, inertias, np.zeros_like(reference.q), gains, 0.0, bandwidth)


def pid_with_velocity(
    reference: Reference, inertia: np.ndarray, gains: np.ndarray, bandwidth: float = BANDWIDTH
) -> Controller:
    """Make a PID with the velocity of the reference fed forward."""
    return replace(simple_pid(reference, inertia, gains, bandwidth), weight=1.0)


def computed_torque(
    reference: Reference, result: Result, payload: Payload | None = None, bandwidth: float = BANDWIDTH
) -> Controller:
    """Make a computed torque law of an identified model, evaluated along the reference, and that model's gains.

    Parameters
    ----------
    reference : Reference
        The motion to follow.
    result : Result
        From :func:`gtau.identify` or :meth:`gtau.Result.load`.
    payload : Payload, optional
        The load; its known parameters go into the model as they are.
    bandwidth : float
        Of the linear part, rad/s.

    Raises
    ------
    GtauError
        Where the robot cannot follow the reference.
    """
    model, n = result.model, len(result.model.actuated)
    chi = model_parameters(result, payload)
    regressor = model.columns(result.base.standard)

    def torques(motion: Motion, parameters: np.ndarray = chi) -> np.ndarray:
        return regressor.torques(regressor(model.layout, motion), parameters, n)

    motion = model.motion(reference.q.T, reference.qd.T, reference.qdd.T)
    feedforward = torques_along(result, motion, chi)
    rest = replace(motion, yd=np.zeros_like(motion.yd), ydd=np.zeros_like(motion.ydd))
    weight = torques(rest)
    columns = [torques(replace(rest, ydd=np.ascontiguousarray(motion.J[:, k]))) - weight for k in range(n)]
    inertia = np.stack(columns, axis=2).swapaxes(0, 1)
    gains = np.array([result.drive_gains[joint].value for joint in model.actuated], dtype=float)
    return Controller(reference, inertia, feedforward.T, gains, 1.0, bandwidth)


def model_parameters(result: Result, payload: Payload | None) -> np.ndarray:
    """Return the base parameters (n_b,) of the identified robot with the known parameters of its payload."""
    model, base = result.model, result.base
    chi = np.array([result.params[name] for name in base.names])
    if payload is not None:
        place = {name: k for k, name in enumerate(model.parameter_names)}
        for kind, value in {**result.payload(payload.name), **known_values(payload)}.items():
            chi = chi + value * base.matrix[:, place[Parameter(kind, model.robot.tool).name]]
    return chi
