"""Collision thresholds: external torques that motion without contact exceeds once in a stated time.

Each joint has a threshold in three ranges of its speed, the lowest near reversals. It follows from the residuals of
logs that the identification did not use: a generalized Pareto tail of their peaks, at the stated rate. Each log is then
checked with the thresholds of the other logs, and all are raised until no more alarms occur than stated.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.results.result import IdentifiedModel
from gtau.export.exported import Export, Exported, written
from gtau.robots.parameter import torque_unit
from gtau.signals.preparation.filters import position_filter
from gtau.signals.run import Run
from gtau.uses.external_torques import momentum_observer, predict_under_load
from gtau.uses.prediction import doubts

SPEEDS = (0.1, 0.5)  # bounds of the ranges, shares of a joint's largest speed
QUANTILE, FEWEST = 0.9, 10  # quantile of the residuals above which peaks count, and least peaks of a tail
APART = 0.1  # s between peaks
HEAVIEST = 0.3  # largest shape of a tail; the moments of few peaks give any shape
CHECKS = 10.0  # expected alarms of the checks with well chosen thresholds
STEP, MOST = 1.02, 10.0  # ratio of the factors that are tried, and the largest factor

Residual = tuple[np.ndarray, np.ndarray, float]
"""Absolute external torques (N, n) of a log, ranges of speed (N, n), -1 where samples are missing, and the step, s."""


def export_thresholds(
    result: IdentifiedModel, runs: Sequence[Run], out: Path, hours: float = 8.0, observer: float | None = None
) -> Exported:
    """Write ``thresholds.json`` from ``runs`` without contact, for one false alarm of the robot in ``hours``."""
    if len(runs) < 2 or not 0 < hours < np.inf:
        raise GtauError("thresholds need two runs without contact, listed under 'validation', and --hours above zero.")
    robot, joints = result.robot, result.idm.actuated
    runs = [run.ordered(joints) for run in runs]
    speeds = []
    for run in runs:
        cutoff = result.preparation.at(run.rate).cutoff
        speeds.append(np.abs(position_filter(run.position, run.rate, cutoff)[1]))
    fastest = np.max([speed.max(axis=0) for speed in speeds], axis=0)
    pairs = zip(runs, speeds, strict=True)
    residuals = [residual_of(result, run, speed / fastest, observer) for run, speed in pairs]
    total = sum(len(torque) * step for torque, _, step in residuals)
    factor, alarms = raised(residuals, total / CHECKS)
    values = factor * thresholds(residuals, 3600 * hours)
    entries = [
        {
            "joint": joint,
            "from_speed": bound * float(fastest[j]),
            "speed_unit": f"{robot.joint(joint).unit}/s",
            "threshold": float(values[k, j]),
            "unit": torque_unit(robot, joint),
        }
        for j, joint in enumerate(joints)
        for k, bound in enumerate((0.0, *SPEEDS))
    ]
    document = {
        "hours_between_false_alarms": hours,
        "signal": "external torque" if observer is None else f"momentum observer, {observer:g} Hz",
        "thresholds": entries,
        "check": {"seconds": total, "expected_alarms": CHECKS, "alarms": alarms, "factor": factor},
    }
    raising = f", so all are raised by {100 * (factor - 1):.0f} %" if factor > 1 else ""
    note = (
        f"from {total:.3g} s without contact: with the thresholds of the others the logs have {alarms} alarms where "
        f"{CHECKS:.0f} are expected{raising}; longer times are extrapolated"
    )
    files = written(out, {"thresholds.json": json.dumps(document, indent=1) + "\n"})
    return Exported(files, (*doubts(result), note))


def residual_of(result: IdentifiedModel, run: Run, speed: np.ndarray, observer: float | None) -> Residual:
    """Compute the residual of a run, whose ``speed`` (N, n) is in shares of the largest."""
    prediction = predict_under_load(result, run).in_band
    at = np.minimum(np.searchsorted(run.time, prediction.time), len(run.time) - 1)
    if observer is None:
        external = prediction.predicted - prediction.measured
    else:
        external = momentum_observer(result, run, observer)[at]
    cell = np.where(prediction.valid, np.sum([speed[at] >= bound for bound in SPEEDS], axis=0), -1)
    return np.abs(external), cell, float(np.median(np.diff(prediction.time)))


def peaks(torque: np.ndarray, step: float, level: float) -> np.ndarray:
    """Find the heights (k,) of the peaks of a torque (N,) above a level, at least ``APART`` from each other."""
    above = np.flatnonzero(torque > level)
    groups = np.split(above, np.flatnonzero(np.diff(above) * step > APART) + 1)
    return np.array([torque[group].max() for group in groups if len(group)])


def thresholds(residuals: Sequence[Residual], seconds: float) -> np.ndarray:
    """Compute thresholds (ranges, n), of which one is exceeded once in ``seconds``, all at the same rate."""
    total = sum(len(torque) * step for torque, _, step in residuals)
    values = np.zeros((len(SPEEDS) + 1, residuals[0][0].shape[1]))
    for k, j in np.ndindex(values.shape):
        parts = [(torque[:, j] * (cell[:, j] == k), step) for torque, cell, step in residuals]
        inside = np.concatenate([torque[torque > 0] for torque, _ in parts])
        level = float(np.quantile(inside, QUANTILE)) if len(inside) else 0.0
        tail = np.concatenate([peaks(torque, step, level) for torque, step in parts]) - level
        if len(tail) < FEWEST:
            continue
        mean, often = float(tail.mean()), max(len(tail) / total * seconds * values.size, 1.0)
        shape = float(np.clip((1 - mean**2 / max(float(tail.var()), 1e-300)) / 2, 1e-6, HEAVIEST))
        values[k, j] = level + mean * (1 - shape) * (often**shape - 1) / shape
    if not values.any(axis=0).all():
        raise GtauError("the logs have too few samples for thresholds; give longer ones in which every joint moves.")
    return np.where(values > 0, values, values.max(axis=0))


def raised(residuals: Sequence[Residual], seconds: float) -> tuple[float, int]:
    """Find the factor on the other logs' thresholds that bounds the alarms of each; also count alarms without it."""
    checks = []
    for judged in residuals:
        torque, cell, step = judged
        values = thresholds([log for log in residuals if log is not judged], seconds)
        limit = np.take_along_axis(values, np.maximum(cell, 0), axis=0)
        checks.append((torque, np.where(cell >= 0, limit, np.inf), step))

    def alarms(factor: float) -> int:
        over = [((torque > factor * limit).any(axis=1), step) for torque, limit, step in checks]
        return sum(len(peaks(any_joint.astype(float), step, 0.5)) for any_joint, step in over)

    factor = 1.0
    while alarms(factor) > CHECKS:
        factor *= STEP
        if factor > MOST:
            raise GtauError(
                f"the logs differ too much for thresholds: at {MOST:g} times the others' thresholds one log "
                "still raises alarms; check which logs have contacts, or a load that is not declared (gtau validate)."
            )
    return factor, alarms(1.0)


def _refuse(result: IdentifiedModel, out: Path) -> Exported:
    raise GtauError("thresholds come from logs without contact; give validation runs by --experiment EXPERIMENT.yaml.")


EXPORTS = {"thresholds": Export(_refuse)}
