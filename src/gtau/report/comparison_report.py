"""The report of a comparison: the same logs by every estimator."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gtau.estimation.compare import EstimatorComparison, Row
from gtau.estimation.diagnostics.sentences import percent_text
from gtau.report import provenance
from gtau.report.html.document import Section
from gtau.report.html.drawings import Interval, interval_rows
from gtau.report.html.elements import Cell, Column, badge, escape, paragraph, plain, table, text, verdict
from gtau.report.html.series import Arrays
from gtau.report.identification_report import page
from gtau.report.provenance import Provenance
from gtau.report.style import joint_label

BELIEVED = ("good", "weak")
INTERVAL = 1.96  # standard deviations to either side, 95 %


def comparison_report(
    found: EstimatorComparison, robot: str, units: Mapping[str, str], prior_gains: Mapping[str, float], of: Provenance
) -> str:
    """Render the report of a comparison as the text of one HTML file; ``units`` of the gains by joint."""
    sections = (
        Section("verdict", "Verdict", verdict("plain", headline(found), remarks(found))),
        Section("estimators", "Estimators", comparison_table(found, units)),
        Section("gains", "Drive gains by estimator", comparison_charts(found, units, prior_gains)),
        provenance.section(of),
    )
    return page(f"Estimators on {robot}", [], sections, Arrays())


def headline(found: EstimatorComparison) -> str:
    """Summarise in one sentence how far the estimators agree."""
    rows = [row for row in found.rows if row.gains is not None and row.std is not None]
    believed = [row for row in rows if row.outcome is not None and row.outcome.value in BELIEVED]
    if len(believed) < 2:
        return f"{len(believed) or 'None'} of {len(rows)} estimators that find drive gains can be believed."
    gains = np.array([row.gains for row in believed])
    spread = 100 * np.ptp(gains, axis=0) / np.abs(np.median(gains, axis=0))
    j = int(np.argmax(spread))
    return (
        f"{len(believed)} of {len(rows)} estimators find gains that can be believed; these agree to "
        f"{percent_text(spread[j])} % or better, and differ most at {found.joints[j]}."
    )


def remarks(found: EstimatorComparison) -> list[str]:
    """List estimators that refuse the data, or whose gains are not to be believed."""
    words = [f"{row.method}: {row.refusal}" for row in found.rows if row.refusal]
    words += [
        f"{row.method}: the gains are {row.outcome.value}"
        for row in found.rows
        if row.outcome is not None and row.outcome.value not in BELIEVED
    ]
    return words


def comparison_table(found: EstimatorComparison, units: Mapping[str, str]) -> str:
    """Tabulate each estimator: worst verdict, gains with relative standard deviations, residual and time."""
    columns = [
        Column("estimator"),
        Column("worst verdict"),
        *(Column(f"{joint_label(joint)}, {units.get(joint, 'N m/A or N/A')}", True) for joint in found.joints),
        Column("residual, % of the current", True),
        Column("time, s", True),
    ]
    return table(columns, [_row(row, len(found.joints)) for row in found.rows])


def _row(row: Row, n: int) -> list[Cell]:
    if row.gains is None or row.residuals is None:
        return [text(row.method, "mono"), badge("refused"), *([Cell("–", True)] * (n + 2))]
    cells = []
    for j, gain in enumerate(row.gains):
        more = " given" if row.std is None else f" ± {percent_text(100 * row.std[j] / abs(gain))} %"
        cells.append(Cell(escape(plain(float(gain), 5) + more), True, float(gain)))
    return [
        text(row.method, "mono"),
        text("given") if row.outcome is None else badge(row.outcome.value),
        *cells,
        Cell(f"{row.residuals.max():.2f}", True, float(row.residuals.max())),
        Cell(f"{row.seconds:.2f}", True, row.seconds),
    ]


def comparison_charts(found: EstimatorComparison, units: Mapping[str, str], prior_gains: Mapping[str, float]) -> str:
    """Draw the gain of each joint by every estimator, with 95 % intervals, and the prior gain."""
    parts = []
    rows = [row for row in found.rows if row.gains is not None and row.std is not None]
    for j, joint in enumerate(found.joints):
        bars = [_interval(row, j, prior_gains.get(joint)) for row in rows]
        drawn, axis = interval_rows(bars)
        lines = "".join(
            f'<tr><td class="name mono">{escape(row.method)}</td><td class="bar">{bar}</td></tr>'
            for row, bar in zip(rows, drawn, strict=True)
        )
        unit = units.get(joint, "N m/A or N/A")
        parts.append(
            f'<h3>{escape(joint_label(joint))}</h3><div class="scroll"><table class="intervals"><tbody>{lines}'
            f'<tr><td class="soft">{escape(unit)}</td><td class="bar">{axis}</td></tr></tbody></table></div>'
        )
    words = "Discs are the gains and lines their 95 % intervals" + (
        "; diamonds are the prior gains." if prior_gains else "."
    )
    return paragraph(words, "soft") + "\n".join(parts)


def _interval(row: Row, j: int, prior: float | None) -> Interval:
    assert row.gains is not None
    assert row.std is not None
    value, half = float(row.gains[j]), INTERVAL * float(row.std[j])
    return Interval(value, (value - half, value + half), other=prior)
