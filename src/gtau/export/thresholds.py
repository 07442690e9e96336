"""Collision thresholds: external torques that motion without contact exceeds once in a stated time.

Of each joint, and of three ranges of its speed, the lowest of which is near reversals, the residuals of logs that the
identification did not use give a threshold. Peaks above their 90 % quantile, apart by a tenth of a second, have a
generalized Pareto tail, which is read where it is exceeded at the stated rate; all joints and ranges share that rate
equally. Then each log is checked with the thresholds of the others, and all thresholds are raised by the factor with
which no more alarms come than stated: logs of other days have more friction than any one of them shows.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.results.result import Result
from gtau.export.exported import Export, Exported, written
from gtau.robots.parameter import position_unit, torque_unit
from gtau.signals.preparation.filters import position_filter
from gtau.signals.run import Run
from gtau.uses.external_torques import momentum_observer, predict_under_load

SPEEDS = (0.1, 0.5)  # of a joint's largest speed: bounds of the ranges
QUANTILE = 0.9  # of the residuals, above which peaks are counted
APART = 0.1  # s between peaks
FEWEST = 10  # peaks of a tail
HEAVIEST = 0.3  # shape of a tail; the moments of few peaks give any
CHECKS = 10.0  # alarms that the checks would have with well chosen thresholds
STEP, MOST = 1.02, 10.0  # factors that are tried, and the largest


@dataclass(frozen=True, eq=False)
class Residual:
    """Absolute external torques (N, n) of a run without contact, the range of speed (N, n), and the time step, s.

    Samples near gaps have the range -1.
    """

    name: str
    torque: np.ndarray
    cell: np.ndarray
    step: float

    @property
    def seconds(self) -> float:
        """Duration."""
        return len(self.torque) * self.step


def export_thresholds(
    result: Result, runs: Sequence[Run], out: Path, hours: float = 8.0, observer: float | None = None
) -> Exported:
    """Write ``thresholds.json``: thresholds on external torques that occur without contact once in ``hours``.

    Parameters
    ----------
    result : Result
        Identified model.
    runs : sequence of Run
        Logs without contact that the identification did not use, two at least.
    out : path
        Folder.
    hours : float
        Mean time between false alarms of the whole robot.
    observer : float, optional
        Bandwidth (Hz) of the momentum observer whose estimate is compared; else the external torque is the difference
        of model and motor torque behind the low-pass of identification.

    Raises
    ------
    GtauError
        Where the runs are too few or too short, or do not suit the model.
    """
    if len(runs) < 2:
        raise GtauError(
            f"thresholds are checked on other logs, and there is only {len(runs)}; list two logs without contact under "
            "'validation', at least."
        )
    if not 0 < hours < np.inf:
        raise GtauError(f"the time between false alarms is {hours:g} h; write a positive number.")
    fastest = np.max([np.abs(_speed(result, run)).max(axis=0) for run in runs], axis=0)
    residuals = [_residual(result, run, fastest, observer) for run in runs]
    total = sum(residual.seconds for residual in residuals)
    factor, alarms = _factor(residuals, total / CHECKS)
    values = factor * _thresholds(residuals, 3600 * hours)
    joints, robot = result.idm.actuated, result.robot
    bounds = [0.0, *(share * fastest for share in SPEEDS)]
    cells = [
        {
            "joint": joint,
            "from_speed": float(np.broadcast_to(bounds[k], len(joints))[j]),
            "speed_unit": f"{position_unit(robot, joint)}/s",
            "threshold": float(values[k, j]),
            "unit": torque_unit(robot, joint),
        }
        for j, joint in enumerate(joints)
        for k in range(len(bounds))
    ]
    document = {
        "hours_between_false_alarms": hours,
        "signal": "external torque" if observer is None else f"momentum observer, {observer:g} Hz",
        "thresholds": cells,
        "logs": [residual.name for residual in residuals],
        "seconds": total,
        "check": {"expected_alarms": CHECKS, "alarms": alarms, "factor": factor},
    }
    files = written(out, {"thresholds.json": json.dumps(document, indent=1, allow_nan=False) + "\n"})
    note = (
        f"thresholds for one false alarm of the robot in {hours:g} h, from {total:.3g} s without contact: with those "
        f"of the others the logs have {alarms} alarms where {CHECKS:.0f} are expected, so all are raised by a factor "
        f"of {factor:.2f}; times longer than the logs are extrapolated"
    )
    return Exported(files, (note,), {"factor": factor})


def _speed(result: Result, run: Run) -> np.ndarray:
    run = run.ordered(result.idm.actuated)
    return position_filter(run.position, run.rate, result.preparation.at(run.rate).cutoff)[1]


def _residual(result: Result, run: Run, fastest: np.ndarray, observer: float | None) -> Residual:
    prediction = predict_under_load(result, run).in_band
    external = prediction.predicted - prediction.measured
    if observer is not None:
        observed = momentum_observer(result, run, observer)
        external = np.stack([np.interp(prediction.time, run.time, column) for column in observed.T], axis=1)
    speed = np.abs(_speed(result, run)[np.minimum(np.searchsorted(run.time, prediction.time), len(run.time) - 1)])
    cell = np.where(prediction.valid, np.sum([speed >= share * fastest for share in SPEEDS], axis=0), -1)
    return Residual(run.name, np.abs(external), cell, float(np.median(np.diff(prediction.time))))


def _peaks(torque: np.ndarray, step: float, level: float) -> np.ndarray:
    """Find the heights of the peaks (k,) of a torque (N,) above a level, apart by ``APART``."""
    above = np.flatnonzero(torque > level)
    groups = np.split(above, np.flatnonzero(np.diff(above) * step > APART) + 1) if len(above) else []
    return np.array([torque[group].max() for group in groups])


def _thresholds(residuals: Sequence[Residual], seconds: float) -> np.ndarray:
    """Compute thresholds (ranges, n) of which one is exceeded in ``seconds``, on average."""
    total, n = sum(residual.seconds for residual in residuals), residuals[0].torque.shape[1]
    values = np.zeros((len(SPEEDS) + 1, n))
    for (k, j), _ in np.ndenumerate(values):
        parts = [(np.where(part.cell[:, j] == k, part.torque[:, j], 0.0), part.step) for part in residuals]
        inside = np.concatenate([torque[torque > 0] for torque, _ in parts])
        if len(inside) < FEWEST:
            continue
        level = float(np.quantile(inside, QUANTILE))
        peaks = np.concatenate([_peaks(torque, step, level) for torque, step in parts])
        if len(peaks) < FEWEST:
            continue
        mean, variance = float(np.mean(peaks - level)), float(np.var(peaks))
        shape = float(np.clip((1 - mean**2 / max(variance, 1e-300)) / 2, 0.0, HEAVIEST))
        often = max(len(peaks) / total * seconds * values.size, 1.0)  # peaks in the time of one alarm of this range
        growth = np.log(often) if shape < 1e-6 else (often**shape - 1) / shape
        values[k, j] = level + mean * (1 - shape) * growth
    if not values.any(axis=0).all():
        raise GtauError("the logs have too few samples for thresholds; give longer ones in which every joint moves.")
    return np.where(values > 0, values, values.max(axis=0))


def _factor(residuals: Sequence[Residual], seconds: float) -> tuple[float, int]:
    """Find the factor with which logs have no more alarms than stated at the others' thresholds; and those without it.

    Raises GtauError where no plausible factor suffices.
    """
    pairs = [(one, _thresholds([other for other in residuals if other is not one], seconds)) for one in residuals]

    def alarms(factor: float) -> int:
        count = 0
        for residual, values in pairs:
            limits = factor * np.take_along_axis(values, np.maximum(residual.cell, 0), axis=0)
            over = ((residual.torque > limits) & (residual.cell >= 0)).any(axis=1)
            count += len(_peaks(over.astype(float), residual.step, 0.5))
        return count

    first, factor = alarms(1.0), 1.0
    while alarms(factor) > CHECKS and factor < MOST:
        factor *= STEP
    if factor >= MOST:
        raise GtauError(
            f"the logs differ too much for thresholds: at {MOST:g} times those of the others one still has alarms; "
            "check which logs have contacts, or a load that is not declared (gtau validate)."
        )
    return factor, first


def _refuse(result: Result, out: Path) -> Exported:
    raise GtauError(
        "thresholds come from logs without contact; give them by --experiment EXPERIMENT.yaml ('validation'), in "
        "Python to gtau.export.thresholds.export_thresholds."
    )


EXPORTS = {"thresholds": Export(_refuse)}
