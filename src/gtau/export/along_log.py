"""Motor, model and external torques along a log, for contact detection."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np

from gtau.documents.files import in_csv, write_atomically
from gtau.errors import GtauError
from gtau.estimation.results.estimate import Prediction
from gtau.estimation.results.result import Result
from gtau.export.observer import momentum_observer
from gtau.export.wrench import WrenchAlongLog, wrench_along_log
from gtau.robots.robot import Placement
from gtau.robots.units import torque_unit
from gtau.signals.run import Run

if TYPE_CHECKING:
    import polars as pl

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

    The table is that of :meth:`gtau.estimation.results.estimate.Prediction.table`; with ``observed_J``, the causal
    estimate of the external torques, and the columns of the ``wrench`` at a frame, where these were asked for.
    """

    table: pl.DataFrame
    joints: tuple[External, ...]
    wrench: WrenchAlongLog | None = None


def torques_along_log(
    result: Result,
    run: Run,
    frame: tuple[str, Placement] | None = None,
    force_only: bool = False,
    bandwidth: float | None = None,
) -> TorquesAlongLog:
    """Compute motor, model and external torques at every sample of a run, after the low-pass of identification.

    Parameters
    ----------
    result, run : Result, Run
        The model and the run.
    frame : tuple, optional
        Frame for the wrench, and whether it is a pure force (``force_only``); see
        :func:`gtau.export.wrench.wrench_along_log`.
    bandwidth : float, optional
        Of :func:`gtau.export.observer.momentum_observer`, Hz, to add its estimate.

    Raises
    ------
    GtauError
        Where the run does not suit the robot, or the model refuses a sample.
    """
    prediction = result.predict(run)
    residual = {each.joint: each.rms for each in result.residuals}
    joints = [
        _summary(prediction.of([joint]), torque_unit(result.robot, joint), residual.get(joint))
        for j, joint in enumerate(prediction.joints)
        if prediction.keep[:, j].any()
    ]
    table, wrench = prediction.table(), None
    if bandwidth is not None:
        observed = momentum_observer(result, run, bandwidth)
        table = table.with_columns(**{f"observed_{each}": observed[:, j] for j, each in enumerate(prediction.joints)})
    if frame is not None:
        wrench = wrench_along_log(result, run, prediction, frame, force_only)
        table = table.with_columns(**wrench.columns).fill_nan(None)
    return TorquesAlongLog(table, tuple(joints), wrench)


def _summary(of: Prediction, unit: str, residual: float | None) -> External:
    external, keep, valid = (each[:, 0] for each in (of.predicted - of.measured, of.keep, of.valid))
    kept = external[keep]
    worst = int(np.argmax(np.abs(kept)))
    beyond = None if residual is None else float(np.mean(np.abs(kept) > USABLE * residual))
    rms, rms_all = (float(np.sqrt(np.mean(each**2))) for each in (kept, external[valid]))
    return External(of.joints[0], unit, residual, rms, rms_all, float(kept[worst]), float(of.time[keep][worst]), beyond)


def write_table(found: TorquesAlongLog, path: Path) -> None:
    """Write the table as Parquet or CSV, by the ending of ``path``.

    Raises
    ------
    GtauError
        Where the extension is another one, or the file cannot be written.
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
        f"{'External torque':<20}{'rms':>10}{'rms, all':>10}{'residual':>11}{'largest':>11}{'at, s':>10}"
        f"{'beyond 4':>11}   unit",
    ]
    for each in found.joints:
        residual = "-" if each.residual is None else f"{each.residual:.4g}"
        share = "-" if each.share is None else f"{100 * each.share:.2f} %"
        lines.append(
            f"  {each.joint:<18}{each.rms:>10.4g}{each.rms_all:>10.4g}{residual:>11}{each.largest:>11.4g}"
            f"{each.time:>10.4g}{share:>11}"
            f"   {each.unit}"
        )
    return "\n".join(
        [
            *lines,
            "rms: away from reversals, as largest and beyond 4; all: over all samples.",
            "residual: rms torque residual of the identification; beyond 4: share of samples",
            "whose external torque exceeds four of them, by chance 0.006 %. A contact, a",
            "collision or an unknown payload shows there.",
            *(() if found.wrench is None else _wrench_lines(found.wrench)),
        ]
    )


def _wrench_lines(found: WrenchAlongLog) -> Iterator[str]:
    yield ""
    yield f"{'External wrench':<20}{'rms':>10}{'+-':>10}{'largest':>11}{'at, s':>10}{'beyond 4':>11}{'seen':>9}   unit"
    for each in found.components:
        numbers = (each.rms, each.interval, each.largest, each.time)
        rms, interval, largest, time = ("-" if number is None else f"{number:.4g}" for number in numbers)
        share = "-" if each.share is None else f"{100 * each.share:.2f} %"
        yield (
            f"  {each.name:<18}{rms:>10}{interval:>10}{largest:>11}{time:>10}{share:>11}{100 * each.seen:>7.0f} %"
            f"   {each.unit}"
        )
    yield from wrap(f"At {found.frame}, in its axes. +-: half the 95 % interval, the median.", 80)
    if not found.seen.all():
        few = int(np.median(found.directions))
        yield from wrap(
            f"seen: share of samples whose pose shows the component; there the joints feel {few} of 6 directions, the "
            "median. Elsewhere it has no value: it is empty in the table.",
            80,
        )
