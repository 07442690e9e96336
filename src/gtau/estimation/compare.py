"""Compare all estimators on the same logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.verdict import worst
from gtau.estimation.estimators import NAMES, estimator_of
from gtau.estimation.estimators.estimator import Gains
from gtau.estimation.experiment_runs import Options, Source, read
from gtau.estimation.identify import estimate
from gtau.estimation.preconditions import plan, reduced, require_inputs
from gtau.findings import Finding, Grade
from gtau.model.program import single_threaded_blas
from gtau.progress import Progress, silent
from gtau.robots.parameter import gain_unit
from gtau.signals.run import Run

if TYPE_CHECKING:
    import polars as pl

NUMBERS = ("gains", "std", "residuals")


@dataclass(frozen=True, eq=False)
class MethodRow:
    """Estimates of one estimator.

    ``gains`` and ``std`` (n,), N m/A or N per A, the standard deviations None where the gains are given;
    ``half_widths`` (n,) are half their 95 % intervals. ``residuals`` (n,) are of the currents in per cent of
    them, ``seconds`` the time of the estimation alone. An estimator that refuses the data has only its ``refusal``.
    """

    method: str
    gains: np.ndarray | None = None
    std: np.ndarray | None = None
    residuals: np.ndarray | None = None
    seconds: float = 0.0
    outcome: Grade | None = None
    refusal: str = ""
    half_widths: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class EstimatorComparison:
    """A row for each estimator, with the gains of the ``joints`` in their ``units``, and ``notes`` on drafted logs."""

    joints: tuple[str, ...]
    rows: tuple[MethodRow, ...]
    units: tuple[str, ...] = ()
    robot: str = ""
    notes: tuple[Finding, ...] = ()

    def __repr__(self) -> str:
        return f"EstimatorComparison(joints {', '.join(self.joints)}; {', '.join(row.method for row in self.rows)})"

    def to_frame(self) -> pl.DataFrame:
        """Return the comparison as a Polars table, one row per estimator and joint."""
        import polars as pl

        numbers = dict.fromkeys(("gain", "std", "residual"), pl.Float64)
        schema = {"method": pl.String, "joint": pl.String, **numbers, "verdict": pl.String, "refusal": pl.String}
        rows = []
        for row, (j, joint) in product(self.rows, enumerate(self.joints)):
            values = (None if of is None else float(of[j]) for of in (row.gains, row.std, row.residuals))
            outcome = None if row.outcome is None else row.outcome.value
            rows.append((row.method, joint, *values, outcome, row.refusal or None))
        return pl.DataFrame(rows, schema=schema, orient="row")


def compare(
    source: Source, runs: Sequence[Run] | None = None, options: Options | None = None, progress: Progress = silent
) -> EstimatorComparison:
    """Identify with every estimator, and compare the results; see :func:`gtau.compare`. Raises GtauError."""
    subject = read(source, runs, replace(options or Options(), method="ml"), progress)

    def row(method: str) -> MethodRow:
        def said(stage: str, done: int, total: int) -> None:
            progress(f"{method} ({1 + NAMES.index(method)} of {len(NAMES)}): {stage}", done, total)

        start = perf_counter()
        by_method = replace(subject, options=replace(subject.options, method=method))
        try:
            estimator = require_inputs(by_method)
            ((_, given),) = plan(by_method, estimator, dataset, system)
            usable = dataset if estimator.takes_priors else replace(dataset, priors={})
            result = estimate(usable, estimator, given, by_method.options, said)
        except GtauError as refusal:
            return MethodRow(method, refusal=str(refusal))
        seconds = perf_counter() - start
        gains = result.drive_gains.values()
        residuals = np.array([error.relative for error in result.residuals])
        numbers = ((gain.value, gain.std, gain.half_interval()) for gain in gains)
        values, std, halves = np.array(list(numbers), dtype=float).T
        if estimator.gains == Gains.GIVEN:
            return MethodRow(method, values, None, residuals, seconds)
        return MethodRow(
            method, values, std, residuals, seconds, worst(gain.verdict for gain in gains), half_widths=halves
        )

    with single_threaded_blas():
        dataset = reduced(subject, estimator_of("ml"), progress)
        system = dataset.system()
        plan(subject, estimator_of("ml"), dataset, system)  # refuses runs that do not fix the scale
        rows = [row(name) for name in NAMES]
    robot, kind = subject.robot, dataset.runs[0].kind
    units = tuple(gain_unit(robot, joint, kind) for joint in robot.motors)
    guesses = subject.experiment.guesses if subject.experiment else ()
    return EstimatorComparison(robot.motors, tuple(rows), units, robot.name, guesses)


def to_document(comparison: EstimatorComparison) -> dict[str, Any]:
    """Describe the comparison as a JSON document."""
    rows = [
        {
            "method": row.method,
            **{key: None if (held := getattr(row, key)) is None else held.tolist() for key in NUMBERS},
            "seconds": row.seconds,
            "outcome": None if row.outcome is None else row.outcome.value,
            "refusal": row.refusal,
        }
        for row in comparison.rows
    ]
    return {"joints": list(comparison.joints), "estimators": rows}
