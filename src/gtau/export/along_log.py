"""Torques along a log: of the motors, of the model, and what comes from outside, by which contacts are seen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gtau.documents.csv import in_csv
from gtau.documents.files import write_atomically
from gtau.errors import GtauError
from gtau.estimation.results.result import Result
from gtau.robots.units import torque_unit
from gtau.signals.payload import Payload
from gtau.signals.run import Run, read_run

if TYPE_CHECKING:
    import polars as pl

USABLE = 4.0  # standard deviations: Gaussian residuals exceed them once in 16,000 rows


@dataclass(frozen=True, eq=False)
class External:
    """External torque of a joint along a log.

    ``residual`` is the rms torque residual of the identification; ``rms`` and ``largest`` (at ``time``, s) are over the
    rows where the model holds, ``share`` is the part of them beyond four residuals. N m or N.
    """

    joint: str
    unit: str
    residual: float | None
    rms: float
    largest: float
    time: float
    share: float | None


@dataclass(frozen=True, eq=False)
class TorquesAlongLog:
    """A table with a row an instant, and a summary a joint.

    Columns: ``t`` (s); for each joint ``motor_J`` (drive gain times current), ``model_J`` (what the motion takes),
    ``external_J`` (the torque that the environment exerts on the joint, model minus motor; N m or N) and ``usable_J``,
    false near reversals of the joint and near gaps, where the model does not hold.
    """

    table: pl.DataFrame
    joints: tuple[External, ...]


def read_log(result: Result, log: str | Path, experiment: str | Path | None = None) -> Run:
    """Read a log to be used with a model.

    Parameters
    ----------
    result : Result
        Of the robot.
    log : path
        The log.
    experiment : path, optional
        Experiment file whose ``signals`` and ``units`` name the columns; left out, they are ``t``, and for each joint
        ``q`` and ``v`` with the joint's name (``tau`` where the model was identified from torques), SI units.

    Raises
    ------
    GtauError
        Where the log or the experiment file cannot be read, or the columns are not there.
    """
    if experiment is not None:
        from gtau.signals.experiment import read_experiment

        described = read_experiment(experiment)
        return read_run(log, described.signals, None, described.units)
    command, letter = ("current", "v") if result.kind == "current" else ("torque", "tau")
    joints = result.robot.actuated
    signals: Mapping[str, Any] = {
        "time": "t",
        "position": {joint: f"q{joint}" for joint in joints},
        command: {joint: f"{letter}{joint}" for joint in joints},
    }
    try:
        return read_run(log, signals)
    except GtauError as error:
        raise GtauError(f"{str(error).rstrip('.')}; or name its columns by --experiment EXPERIMENT.yaml.") from None


def carrying(result: Result, run: Run, payload: str) -> Run:
    """Return the run with one of the model's payloads; raises GtauError where the model does not know its mass."""
    known = [name for name in dict.fromkeys(each.name for each in result.payloads) if "m" in result.payload(name)]
    if payload not in known:
        raise GtauError(f"the model knows no payload '{payload}'; choose from {', '.join(known) or 'none'}.")
    return replace(run, payload=Payload(name=payload))


def torques_along_log(result: Result, run: Run) -> TorquesAlongLog:
    """Compute motor, model and external torques along a run, filtered and decimated as for identification.

    Raises
    ------
    GtauError
        Where the run does not suit the robot, or the model refuses a sample.
    """
    import polars as pl

    prediction = result.predict(run)
    residual = {each.joint: each.rms for each in result.residuals}
    columns: dict[str, np.ndarray] = {"t": prediction.time}
    joints = []
    for j, joint in enumerate(prediction.joints):
        external = prediction.predicted[:, j] - prediction.measured[:, j]
        keep = prediction.keep[:, j]
        columns |= {
            f"motor_{joint}": prediction.measured[:, j],
            f"model_{joint}": prediction.predicted[:, j],
            f"external_{joint}": external,
            f"usable_{joint}": keep,
        }
        if keep.any():
            joints.append(_summary(joint, torque_unit(result.robot, joint), residual.get(joint), prediction.time[keep],
                                   external[keep]))  # fmt: skip
    return TorquesAlongLog(pl.DataFrame(columns), tuple(joints))


def _summary(joint: str, unit: str, residual: float | None, time: np.ndarray, external: np.ndarray) -> External:
    worst = int(np.argmax(np.abs(external)))
    beyond = None if residual is None else float(np.mean(np.abs(external) > USABLE * residual))
    rms = float(np.sqrt(np.mean(external**2)))
    return External(joint, unit, residual, rms, float(external[worst]), float(time[worst]), beyond)


def write_table(found: TorquesAlongLog, path: Path) -> None:
    """Write the table as Parquet or CSV, by the ending of ``path``.

    Raises
    ------
    GtauError
        Where it ends otherwise, or cannot be written.
    """
    from io import BytesIO

    match path.suffix.lower():
        case ".csv":
            write_atomically(path, in_csv(found.table))
        case ".parquet":
            buffer = BytesIO()
            found.table.write_parquet(buffer)
            write_atomically(path, buffer.getvalue())
        case _:
            raise GtauError(f"{path} ends in neither .csv nor .parquet; give the table one of these endings.")


def summary_text(found: TorquesAlongLog) -> str:
    """Print the summary as a table."""
    lines = [
        f"{'External torque':<20}{'rms':>10}{'residual':>11}{'largest':>11}{'at, s':>10}{'beyond 4':>11}   unit",
    ]
    for each in found.joints:
        residual = "-" if each.residual is None else f"{each.residual:.4g}"
        share = "-" if each.share is None else f"{100 * each.share:.2f} %"
        lines.append(
            f"  {each.joint:<18}{each.rms:>10.4g}{residual:>11}{each.largest:>11.4g}{each.time:>10.4g}{share:>11}"
            f"   {each.unit}"
        )
    return "\n".join(
        [
            *lines,
            "residual: rms torque residual of the identification; beyond 4: share of rows",
            "whose external torque exceeds four of them, by chance 0.006 %. A contact, a",
            "collision or an unknown payload shows there.",
        ]
    )
