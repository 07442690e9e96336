"""Motion simulated in closed loop with the current estimate, free of the noise of the encoders.

The estimators with instruments (:mod:`idim.estimation.instruments`) and DIDIM (:mod:`idim.estimation.didim`) take the
regressor along a simulated motion. A log does not say by which law its robot was controlled, so the one simulated is
the usual stand-in: PID through the inertia of the model itself, the acceleration of the reference fed forward,

    M(q) (qdd_r + kd ed + kp e + ki int e) = M(q) qdd + h(q, qd),      e = q_r - q

with all three poles at ``-pole``. The measured motion, smoothed to the bandwidth of the motion, is the reference.
What the model has besides inertia then acts as a disturbance: ``e = s / (s + pole)^3  M^-1 h``. This is solved for the
whole run at once, by filtering ``M^-1 h`` along the motion of the pass before, until the motion stays: the loop
forgets in a few ``1 / pole``, so two or three passes do, each as fast as the model is along a log. (Integrated step
by step, the Orthoglide takes a thousand times as long.)
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from idim.errors import IdimError
from idim.estimation.assembly import Assembly
from idim.estimation.data import Data
from idim.estimation.rows import Labels
from idim.estimation.solution import Solution
from idim.model.inverse_dynamics import PATH, InverseDynamics, Regressor
from idim.signals.filters import differentiate, filter_edge, low_pass
from idim.signals.preparation import Held, Preparation, Prepared

SMOOTH = 4.0  # cut-off of the reference over the bandwidth of the motion
POLE = 20.0  # of the loop, over the bandwidth of the motion
PASSES = 20
SETTLED = 1e-6  # change of the accelerations, of their rms


def resimulated_runs(data: Data, assembly: Assembly, solution: Solution) -> tuple[Held, ...]:
    """All runs along the motion that the loop, simulated with what was found, gives them; see :func:`resimulated`."""
    regressor = data.model.columns(data.base.standard)
    return tuple(
        resimulated(data.model, regressor, assembly.motion(k, solution.theta), each, data.preparation)
        for k, each in enumerate(data.prepared)
    )


def resimulated(
    idm: InverseDynamics, regressor: Regressor, values: np.ndarray, prepared: Prepared, preparation: Preparation
) -> Held:
    """A run along the motion that the loop simulated gives it; rows in the reference's ends are left out too.

    Parameters
    ----------
    idm, regressor, values : InverseDynamics, Regressor, ndarray
        The model, and its columns with their values (columns,): inertia, payload and friction of the run.
    prepared, preparation : Prepared, Preparation
        The run as measured, and the bandwidth of the motion.

    Raises
    ------
    IdimError
        Where the inertia estimated is not positive, so that there is nothing to simulate, or the loop does not settle.
    """
    run, measured = prepared.run, prepared.samples()
    rate, kept = run.rate, slice(prepared.kept.start, prepared.kept.stop)
    cutoff = SMOOTH * preparation.bandwidth
    smooth = low_pass(run.position, rate, cutoff) if cutoff < 0.4 * rate else run.position
    reference = np.stack([each[kept] for each in (smooth, *differentiate(smooth, rate))])  # (3, N, n)
    edge, usable = filter_edge(rate, cutoff), measured.usable
    usable[: max(edge - kept.start, 0)] = False
    usable[max(len(run.time) - edge - kept.start, 0) :] = False
    pole = 2 * np.pi * POLE * preparation.bandwidth
    motion, size = reference, np.sqrt(np.mean(reference[2] ** 2))
    for _ in range(PASSES):
        disturbance = _disturbance(idm, regressor, values, motion, reference[1], Labels(run.name, measured.time))
        following = reference - _tracking_error(disturbance, rate, pole)
        change = np.sqrt(np.mean((following[2] - motion[2]) ** 2))
        motion = following
        if change < SETTLED * size:
            break
    else:
        raise IdimError(
            f"run '{run.name}': the robot simulated with the parameters estimated does not follow its motion; "
            "use --method ml, or add runs that tell the parameters better."
        )
    return Held(run, replace(measured, q=motion[0], qd=motion[1], qdd=motion[2], usable=usable))


def _disturbance(
    idm: InverseDynamics,
    regressor: Regressor,
    values: np.ndarray,
    motion: np.ndarray,
    direction: np.ndarray,
    labels: Labels,
) -> np.ndarray:
    """``M^-1 h`` (N, n) along a motion (3, N, n).

    Coulomb friction opposes the speeds of ``direction`` (N, n), those of the reference, so that a joint needs no
    stiction; rows where the two differ in sign are next to a reversal, and masked.
    """
    n, samples = motion.shape[2], motion.shape[1]
    found, c = np.empty((samples, n)), None
    q, qd = (np.ascontiguousarray(each.T) for each in motion[:2])
    dry = np.array([name.startswith("fs_") for name in regressor.names])
    for start in range(0, samples, PATH):
        at = slice(start, min(start + PATH, samples))
        here = Labels(labels.run, labels.time[at])
        c = idm.path(q[:, at], here, None if c is None else c[:, -1])
        still = np.zeros_like(q[:, at])
        moving = idm.rates(c, qd[:, at], still, here)
        h = regressor.torques_along(idm.layout, moving, np.where(dry, 0.0, values))
        signs = idm.rates(c, np.ascontiguousarray(direction[at].T), still, here)
        h += regressor.torques_along(idm.layout, signs, np.where(dry, values, 0.0))
        rest = replace(moving, yd=np.zeros_like(moving.yd), ydd=np.zeros_like(moving.ydd))
        weight = regressor.torques_along(idm.layout, rest, values)
        columns = [
            regressor.torques_along(idm.layout, replace(rest, ydd=np.ascontiguousarray(moving.J[:, k])), values)
            - weight
            for k in range(n)
        ]
        M = np.stack(columns, axis=1).transpose(2, 0, 1)
        M = (M + M.swapaxes(1, 2)) / 2
        lowest = np.linalg.eigvalsh(M / np.sqrt(np.einsum("ti,tj->tij", *2 * [np.abs(np.einsum("tii->ti", M))])))[:, 0]
        if not lowest.min() > 0:
            raise IdimError(
                f"the inertia estimated is not positive ({here[int(lowest.argmin())]}), so the robot cannot be "
                "simulated; use --method ml, or add runs that tell the parameters better."
            )
        found[at] = np.linalg.solve(M, h.T[:, :, None])[:, :, 0]
    return found


def _tracking_error(disturbance: np.ndarray, rate: float, pole: float) -> np.ndarray:
    """Error of the loop, its first and its second derivative, (3, N, n), that a disturbance (N, n) causes."""
    from scipy.signal import bilinear, lfilter, lfilter_zi

    found = []
    for derivative in range(3):
        b, a = bilinear([1.0, *[0.0] * (derivative + 1)], [1.0, 3 * pole, 3 * pole**2, pole**3], rate)
        state = lfilter_zi(b, a)[:, None] * disturbance[:1]  # as if it had always been there
        found.append(lfilter(b, a, disturbance, axis=0, zi=state)[0])
    return np.stack(found)
