"""Show estimators compared on the same logs."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gtau.estimation.compare import EstimatorComparison
from gtau.findings import percent_text
from gtau.report.chart import Chart, intervals
from gtau.report.page import Column, Kind, Page, Section, Table, Text, joint_label

TRUSTED = ("good", "weak")


def comparison_page(comparison: EstimatorComparison, prior: Mapping[str, float] | None = None) -> Page:
    """Show the results of each estimator."""
    said = [f"{row.method}: {row.refusal}" for row in comparison.rows if row.refusal]
    judged = [(row.method, row.outcome.value) for row in comparison.rows if row.outcome]
    said += [f"{method}: the gains are {outcome}" for method, outcome in judged if outcome not in TRUSTED]
    said += map(str, comparison.notes)
    verdict = Text(_agreement(comparison), tuple(said), "neutral")
    words = "residual: worst joint, % of its current; time: estimation alone; ±: half the 95 % interval"
    return Page(
        f"Estimators on {comparison.robot}",
        Section("Verdict", verdict, id="verdict"),
        Section("Estimators", comparison_table(comparison), Text(words, style="soft"), id="estimators"),
        Section("Drive gains by estimator", *_charts(comparison, prior or {}), id="gains"),
    )


def _agreement(comparison: EstimatorComparison) -> str:
    """Summarise the agreement of the estimators in one sentence."""
    rows = [row for row in comparison.rows if row.gains is not None and row.std is not None]
    trusted = [row for row in rows if row.outcome is not None and row.outcome.value in TRUSTED]
    if len(trusted) < 2:
        return f"{len(trusted) or 'None'} of {len(rows)} estimators that find drive gains give trustworthy ones."
    gains = np.array([row.gains for row in trusted])
    spread = 100 * np.ptp(gains, axis=0) / np.abs(np.median(gains, axis=0))
    j = int(np.argmax(spread))
    return (
        f"{len(trusted)} of {len(rows)} estimators find trustworthy gains, which agree to "
        f"{percent_text(spread[j])} % or better, and differ most at {comparison.joints[j]}."
    )


def comparison_table(comparison: EstimatorComparison) -> Table:
    """Tabulate each estimator: worst verdict, residual, time, and gains with their 95 % intervals."""
    units = zip(comparison.joints, _units(comparison), strict=True)
    labels = [f"{joint_label(joint)}, {unit}" for joint, unit in units]
    columns = (
        Column("estimator", Kind.NAME),
        Column("worst verdict", Kind.BADGE),
        Column("residual, %", Kind.NUMBER, decimals=2),
        Column("time, s", Kind.NUMBER, decimals=2),
        *(Column(label, Kind.SPREAD, 5) for label in labels),
    )
    rows: list[tuple[object, ...]] = []
    for row in comparison.rows:
        if row.gains is None or row.residuals is None:
            rows.append((row.method, "refused", None, None, *([None] * len(comparison.joints))))
            continue
        halves = np.zeros(len(comparison.joints)) if row.half_widths is None else row.half_widths
        outcome = "given" if row.outcome is None else row.outcome.value
        gains = zip(row.gains.tolist(), halves.tolist(), strict=True)
        rows.append((row.method, outcome, float(row.residuals.max()), row.seconds, *gains))
    return Table(columns, rows)


def _charts(comparison: EstimatorComparison, prior: Mapping[str, float]) -> list[Chart]:
    """Draw the gain of each joint by every estimator, with 95 % intervals and the prior gain."""
    rows = {row.method: (row.gains, row.half_widths) for row in comparison.rows}
    shown = {method: (g.tolist(), h.tolist()) for method, (g, h) in rows.items() if g is not None and h is not None}
    charts = []
    for j, (joint, unit) in enumerate(zip(comparison.joints, _units(comparison), strict=True) if shown else ()):
        values = [gains[j] for gains, _ in shown.values()]
        halves = [half[j] for _, half in shown.values()]
        given, axis = ("prior", [prior.get(joint)] * len(shown)), f"{joint_label(joint)}, {unit}"
        charts.append(Chart((intervals(list(shown), values, halves, axis, other=given),)))
    return charts


def _units(comparison: EstimatorComparison) -> tuple[str, ...]:
    return comparison.units or ("N m/A or N per A",) * len(comparison.joints)
