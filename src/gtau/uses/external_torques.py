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

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from gtau.documents import files
from gtau.documents.validation import NUMBER, takes
from gtau.errors import GtauError
from gtau.estimation.regression.rows import stream_motions
from gtau.estimation.results.estimate import TorqueError
from gtau.estimation.results.result import IdentifiedModel
from gtau.findings import Finding
from gtau.model.inverse_dynamics import InverseDynamics, Regressor
from gtau.model.loops import Motion
from gtau.robots.geometry import characteristic_length, refuse_floating
from gtau.robots.parameter import BY_LOAD, Parameter, torque_unit
from gtau.robots.placement import WRENCH, WrenchFrame
from gtau.robots.robot import Placement
from gtau.signals.run import Run
from gtau.uses.identified import OBSERVED, functions, identified
from gtau.uses.prediction import Prediction, loaded_parameters, predict, prepared_for, suited, torque_errors

if TYPE_CHECKING:
    import polars as pl

CLEAR = 0.005  # least share of the largest singular value of J^T (lengths over the reach), at which a direction is seen
ROUNDING = 1e-10  # relative singular value of a direction that is left out
SEEN = 0.999  # of a component's square in seen directions; others contribute at most sqrt(SEEN (1 - SEEN)) = 3 %
NORMAL = 1.959963984540054  # half the 95 % interval, in standard deviations


@dataclass(frozen=True)
class Component:
    """Component of the wrench along a log.

    ``seen`` is the share of samples that show it; of the usable ones among them are ``rms``, ``largest`` (at ``time``,
    s), ``interval`` (median half of the 95 % interval) and ``share`` beyond four standard deviations. N m or N.
    """

    name: str
    unit: str
    seen: float
    rms: float | None = None
    interval: float | None = None
    largest: float | None = None
    time: float | None = None
    share: float | None = None


@dataclass(frozen=True, eq=False)
class WrenchAlongLog:
    """Wrench at a ``frame``, in its axes: moments and forces (N, 6), N m and N, NaN where not ``seen`` (N, 6).

    ``interval`` (N, 6) is half the 95 % interval, ``directions`` (N,) the number of observable directions; ``usable``
    (N,) marks samples that are usable for all joints.
    """

    frame: str
    time: np.ndarray
    wrench: np.ndarray
    interval: np.ndarray
    seen: np.ndarray
    directions: np.ndarray
    usable: np.ndarray

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """Columns of a table: value, half 95 % interval and visibility of each component."""
        parts = {"": self.wrench, "_interval": self.interval, "_seen": self.seen}
        columns = {f"{name}{end}": part[:, k] for k, name in enumerate(WRENCH) for end, part in parts.items()}
        return columns | {"wrench_directions": self.directions, "wrench_usable": self.usable}

    @property
    def components(self) -> tuple[Component, ...]:
        """Summary of each component."""
        return tuple(self._component(k) for k in range(len(WRENCH)))

    def _component(self, k: int) -> Component:
        name = WRENCH[k]
        unit = "N m" if name.startswith("moment") else "N"
        share = float(self.seen[:, k].mean())
        kept = self.seen[:, k] & self.usable
        if not kept.any():
            return Component(name, unit, share)
        values, half = self.wrench[kept, k], self.interval[kept, k]
        largest = _largest(values, self.time[kept])
        beyond = float(np.mean(np.abs(values) > USABLE * half / NORMAL))
        return Component(name, unit, share, _rms(values), float(np.median(half)), *largest, beyond)


def _largest(values: np.ndarray, time: np.ndarray) -> tuple[float, float]:
    """Return the value of largest size, and its time."""
    worst = int(np.argmax(np.abs(values)))
    return float(values[worst]), float(time[worst])


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def wrench_along_log(
    result: IdentifiedModel, run: Run, prediction: Prediction, frame: tuple[str, Placement], force_only: bool = False
) -> WrenchAlongLog:
    """Compute the wrench at a frame of the body that carries the payload, at every sample of a run.

    ``prediction`` is :meth:`gtau.Result.predict` of it, ``frame`` a name and the placement on the body (see
    :func:`gtau.robots.readers.read.frame_on`). If ``force_only``, the contact exerts no moment about the frame's
    origin, so that three motors suffice for the force.

    The torques are weighted by their covariance: the residual of the identification, also as a share of the external
    torque, plus the covariance of parameters and gains at the sample's motion. Near singular poses, components with a
    part in directions that the pose does not show have no value. Raises GtauError where the base floats, or the model
    lacks a residual.
    """
    refuse_floating(result.robot, "the external wrench is")
    errors = {error.joint: error for error in result.residuals}
    if lacking := [joint for joint in prediction.joints if joint not in errors]:
        raise GtauError(
            f"the model has no residual of joint '{lacking[0]}', which did not move in its logs, so that the wrench "
            "has no interval; identify it from logs in which all joints move."
        )
    called, placement = frame
    residual, relative = np.array([(errors[joint].rms, errors[joint].relative / 100) for joint in prediction.joints]).T
    external = prediction.predicted - prediction.measured
    spread = residual**2 + (relative * external) ** 2  # the second part: relative error of the model
    length = characteristic_length(result.robot)
    scale = np.repeat([0.0 if force_only else 1.0 / length, 1.0], 3)  # of unknowns: forces, and moments over a length
    R, p = placement.rotation, placement.position
    arm = np.array([[0.0, -p[2], p[1]], [p[2], 0.0, -p[0]], [-p[1], p[0], 0.0]])
    at_frame = np.block([[R, arm @ R], [np.zeros((3, 3)), R]]) * scale  # to the wrench at the body's frame
    turning = [result.robot.joint(joint).turns for joint in prediction.joints]
    rows = np.where(turning, length, 1.0)  # torques over a length are forces too
    parts, first = [], 0
    for J_t, covariance in _along(result, run):
        part = slice(first, first + len(J_t))
        covariance += spread[part, :, None] * np.eye(len(residual))
        parts.append(_solve(J_t @ at_frame / rows[:, None], covariance / np.outer(rows, rows), external[part] / rows))
        first = part.stop
    value, std, shares, directions = (np.concatenate(blocks) for blocks in zip(*parts, strict=True))
    seen = (shares >= SEEN) & (scale > 0)
    wrench = np.where(seen, value * scale, np.nan)
    half = np.where(seen, NORMAL * std * scale, np.nan)
    return WrenchAlongLog(called, prediction.time, wrench, half, seen, directions, np.all(prediction.keep, axis=1))


def _along(result: IdentifiedModel, run: Run) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield blocks of ``J^T`` (N, n, 6) at the body's frame, and of the covariance of model and gains (N, n, n)."""
    model, base, joints = result.idm, result.base, result.robot.actuated
    known = {name: k for k, name in enumerate(result.covariance_names)}
    # with the columns of friction: offset and gravity, for instance, are known far better together than separately
    chosen = [k for k, name in enumerate(base.names) if name in known]
    at = [known[base.names[k]] for k in chosen] + [known[Parameter("gain", joint)] for joint in joints]
    spread = result.covariance[np.ix_(at, at)]
    columns = model.columns(tuple(base.standard[k] for k in chosen))
    wrenches = model.wrenches([WrenchFrame(result.robot.tool)])
    prepared, _ = prepared_for(result, run)
    for samples, motion in stream_motions(model, prepared):
        W = _dense(model, columns, motion)
        currents = -samples.command[:, : len(joints), None] * np.eye(len(joints))
        slopes = np.concatenate([W, currents], axis=2)
        covariance = np.einsum("ikp,pq,ilq->ikl", slopes, spread, slopes, optimize=True)
        yield _dense(model, wrenches, motion), covariance


def _dense(model: InverseDynamics, columns: Regressor, motion: Motion) -> np.ndarray:
    dense = np.zeros((motion.c.shape[1], len(model.actuated), len(columns.names)))
    columns.fill(model.layout, motion, dense)
    return dense


def _solve(A: np.ndarray, covariance: np.ndarray, torque: np.ndarray) -> tuple[np.ndarray, ...]:
    """Solve ``A w = torque`` (N, n), all in N, in the directions that the pose shows.

    Returns w, its standard deviations and its shares in these directions (N, 6), and their number (N,).
    """
    _, size, directions = np.linalg.svd(A, full_matrices=False)
    shown = size > CLEAR * size[:, :1]
    onto = np.einsum("ij,ijw,ijv->iwv", shown, directions, directions, optimize=True)
    root = np.linalg.cholesky(covariance)
    U, s, V_t = np.linalg.svd(np.linalg.solve(root, A @ onto), full_matrices=False)
    inverse = np.divide(1.0, s, out=np.zeros_like(s), where=s > ROUNDING * s[:, :1])
    along = np.einsum("ikj,ik->ij", U, np.linalg.solve(root, torque[:, :, None])[:, :, 0])
    value = np.einsum("ij,ijw->iw", inverse * along, V_t)
    shares = np.einsum("ij,ijw->iw", shown, directions**2)
    # assuming an equal wrench along the directions left out
    unseen = (1.0 - shares) * np.sum(value**2, axis=1, keepdims=True)
    std = np.sqrt(np.einsum("ij,ijw->iw", inverse**2, V_t**2) + np.maximum(unseen, 0.0))
    return value, std, shares, np.sum(shown, axis=1)


PASSES = 2  # each leaves fl of the error of the last one; fl is below 0.1 on a UR10e
USABLE = 4.0  # standard deviations: Gaussian residuals exceed them once in 16,000 rows


@dataclass(frozen=True, eq=False)
class External:
    """External torque of a joint along a log.

    ``rms``, ``largest`` (at ``time``, s) and ``share`` beyond four times the ``residual`` of the identification are of
    samples away from reversals, ``rms_all`` of all valid ones. N m or N.
    """

    joint: str
    unit: str
    residual: float | None
    rms: float
    rms_all: float
    largest: float
    time: float
    share: float | None


@dataclass(frozen=True, eq=False, repr=False)
class TorquesAlongLog:
    """Table with one row per sample, and a summary per joint.

    The table has the columns of :meth:`gtau.Prediction.to_frame`, behind the low-pass of identification, and if asked
    ``observed_J``, the causal estimate, and the columns of the ``wrench``.
    """

    table: pl.DataFrame
    joints: tuple[External, ...]
    errors: tuple[TorqueError, ...]
    wrench: WrenchAlongLog | None = None
    notes: tuple[Finding, ...] = ()

    def __repr__(self) -> str:
        largest = (f"{joint.joint} {joint.largest:.3g} {joint.unit} at {joint.time:.4g} s" for joint in self.joints)
        return f"TorquesAlongLog({len(self.table)} samples; largest: {', '.join(largest)}; table has all)"

    @property
    def observed(self) -> dict[str, tuple[float, float]]:
        """Largest torques by the observer, N m or N, and their times, s, by joint; empty without an observer."""
        columns = self.table.select("^observed_.*$").to_dict(as_series=False)
        time = self.table["t"].to_numpy()
        return {name.removeprefix("observed_"): _largest(np.array(of), time) for name, of in columns.items()}


def torques_along_log(
    result: IdentifiedModel,
    run: Run,
    frame: tuple[str, Placement] | None = None,
    force_only: bool = False,
    bandwidth: float | None = None,
) -> TorquesAlongLog:
    """Compute torques along a run; see :meth:`gtau.Result.external_torques`. Raises GtauError."""
    raw = predict_under_load(result, run)
    prediction = raw.in_band
    residual = {error.joint: error.rms for error in result.residuals}
    joints = [
        _summary(prediction.of([joint]), torque_unit(result.robot, joint), residual.get(joint))
        for joint, kept in zip(prediction.joints, prediction.keep.T, strict=True)
        if kept.any()
    ]
    table, wrench = prediction.to_frame(), None
    if bandwidth is not None:
        columns = zip(prediction.joints, momentum_observer(result, run, bandwidth).T, strict=True)
        table = table.with_columns(**{f"observed_{joint}": torque for joint, torque in columns})
    if frame is not None:
        wrench = wrench_along_log(result, run, prediction, frame, force_only)
        table = table.with_columns(**wrench.columns).fill_nan(None)
    errors = torque_errors(raw, result.robot, result.preparation.bandwidth)
    return TorquesAlongLog(table, tuple(joints), errors, wrench, raw.notes)


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
        Where the run does not suit the robot, the loops cannot be closed, or the bandwidth is not
        between zero and half the sampling rate.

    Examples
    --------
    >>> result = gtau.load("result/model.json")
    >>> run = gtau.read_run("check_1200g.csv", result.recording.signals, payload={"name": "load_1200g"})
    >>> gtau.momentum_observer(result, run, bandwidth=10.0).shape == run.position.shape
    True
    """
    if not 0 < bandwidth < np.inf:
        raise GtauError(f"the bandwidth of the observer is {bandwidth:g} Hz; write a positive number.")
    refuse_floating(result.robot, "the momentum observer is")
    run = suited(result, run)
    n, time = len(run.joints), np.asarray(run.time)
    if bandwidth >= (half := 0.5 / float(np.median(np.diff(time)))):
        raise GtauError(
            f"the bandwidth of the observer is {bandwidth:g} Hz, but run '{run.name}' shows nothing from {half:.4g} Hz "
            "on, half its sampling rate; write a lower one."
        )
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
    external = (torque.predicted - torque.measured)[:, 0]
    keep = torque.keep[:, 0]
    kept = external[keep]
    beyond = None if residual is None else float(np.mean(np.abs(kept) > USABLE * residual))
    largest = _largest(kept, torque.time[keep])
    return External(torque.joints[0], unit, residual, _rms(kept), _rms(external[torque.valid[:, 0]]), *largest, beyond)


def write_table(torques: TorquesAlongLog, path: Path) -> None:
    """Write the table as Parquet or CSV, by the ending of ``path``; raises GtauError."""
    if path.suffix.lower() not in (".csv", ".parquet"):
        raise GtauError(f"{path} ends in neither .csv nor .parquet; give the table one of these endings.")
    files.write_table(torques.table, path)
