"""Sections on torques: measured and predicted ones along the runs, and their errors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gtau.report.evidence import Evidence, RunEvidence
from gtau.report.html.document import Section
from gtau.report.html.elements import Cell, Column, escape, folded, number, paragraph, table, text
from gtau.report.html.series import Arrays, Line, buckets_for, chart, envelope, key, stretches, zoom_tools
from gtau.report.style import joint_label

OPEN_RUNS = 1  # of the runs used, and of the others: shown unfolded
GROUPS = (("runs used", True), ("validation", False))
SERIES_A_JOINT = 3  # measured, predicted, residual


def errors_table(runs: Sequence[RunEvidence]) -> str:
    """Tabulate torque errors of each joint on each run, away from reversals and over all samples."""
    rows = []
    whole = any(error.relative_all is not None for run in runs for error in run.errors)
    for run in runs:
        for error in run.errors:
            over_all = error.relative_all
            rows.append(
                [
                    text(run.run.name),
                    text("used" if run.used else "validation"),
                    text(error.joint),
                    number(error.rms, 3),
                    number(error.signal, 3),
                    text(error.unit),
                    Cell(f"{error.relative:.2f}", True, error.relative),
                    *([Cell("–" if over_all is None else f"{over_all:.2f}", True, over_all)] if whole else []),
                ]
            )
    columns = [
        Column("run"),
        Column(""),
        Column("joint"),
        Column("error rms", True),
        Column("torque rms", True),
        Column("unit"),
        Column("error, % away from reversals", True),
        *([Column("error, % over all samples", True)] if whole else []),
    ]
    return table(columns, rows)


def joint_errors_table(evidence: Evidence) -> str:
    """Tabulate the largest torque error of each joint on the runs used, and on those kept for validation."""
    groups = [(words, [run for run in evidence.runs if run.used == used]) for words, used in GROUPS]
    groups = [(words, [run for run in runs if run.errors]) for words, runs in groups]
    groups = [(words, runs) for words, runs in groups if runs]
    rows = []
    for joint in evidence.joints:
        cells = []
        for _, runs in groups:
            errors = [error for run in runs for error in run.errors if error.joint == joint]
            whole = [error.relative_all for error in errors if error.relative_all is not None]
            cells += [_largest([error.relative for error in errors]), _largest(whole)]
        rows.append([text(joint_label(joint), "unit"), *cells])
    columns = [Column("largest torque error, %")]
    for words, _ in groups:
        columns += [Column(f"{words}: away from reversals", True), Column(f"{words}: over all samples", True)]
    return table(columns, rows)


def _largest(values: Sequence[float]) -> Cell:
    return Cell(f"{max(values):.2f}", True, max(values)) if values else Cell("–", True)


def torques_section(evidence: Evidence, arrays: Arrays) -> Section | None:
    """Show measured and predicted torques of every joint along every run, used and not used."""
    if not evidence.runs:
        return None
    series = sum(SERIES_A_JOINT * len(evidence.joints) for run in evidence.runs if run.prediction is not None)
    buckets = buckets_for(series)
    shown, opened = [], {True: 0, False: 0}
    for k, run in enumerate(evidence.runs):
        label = f"{run.run.name} ({'used' if run.used else 'validation, not used'}; {run.payload})"
        if run.prediction is None:
            shown.append(folded(label, paragraph(f"Not predicted: {run.refusal}")))
            continue
        opened[run.used] += 1
        content = _torque_charts(evidence, run, f"torques-{k}", buckets, arrays)
        shown.append(folded(label, content, shown=opened[run.used] <= OPEN_RUNS))
    of_current = evidence.result.kind == "current"
    measured = "measured (current × gain)" if of_current else "measured"
    legend = key(
        [
            (measured, "measured"),
            ("predicted", "predicted"),
            ("residual", "residual"),
            ("masked: near a reversal, a gap or a repaired sample", "shade"),
        ]
    )
    words = (
        "A small residual does not prove the gains, as both sides carry them. In the shaded stretches the friction "
        "model does not hold or samples are missing; identification leaves them out."
    )
    every = folded("Torque errors of every run", errors_table(evidence.runs))
    return Section(
        "torques",
        "Torques",
        paragraph(words) + joint_errors_table(evidence) + every + legend + "\n".join(shown),
    )


def _torque_charts(evidence: Evidence, run: RunEvidence, group: str, buckets: int, arrays: Arrays) -> str:
    prediction = run.prediction
    assert prediction is not None
    n = len(prediction.joints)
    rest = prediction.measured - prediction.predicted
    columns = np.column_stack([prediction.measured, prediction.predicted, rest])
    time, thin = envelope(run.time, columns, buckets)
    shortest = float(run.time[-1] - run.time[0]) / 1000
    parts = [zoom_tools(group)]
    if run.cut:
        parts.append(paragraph(f"Only the first {run.time[-1]:.4g} s of this long run are shown.", "soft"))
    errors = {error.joint: error for error in run.errors}
    for j, joint in enumerate(prediction.joints):
        error = errors.get(joint)
        words = joint_label(joint)
        if error is not None:
            whole = error.relative_all
            words += f": residual {error.relative:.2f} %" + (
                "" if whole is None else f" away from reversals, {whole:.2f} % over all samples"
            )
        masked = stretches(run.time, ~prediction.keep[:, j], shortest)
        unit = evidence.units[evidence.joints.index(joint)]
        parts.append(f"<h4>{escape(words)}</h4>")
        parts.append(
            chart(
                arrays,
                time,
                [
                    Line("measured", thin[:, j], "measured", 2.6),
                    Line("predicted", thin[:, n + j], "predicted", 1.2),
                ],
                unit,
                group,
                masked=masked,
                last=False,
            )
        )
        parts.append(
            chart(
                arrays,
                time,
                [Line("residual", thin[:, 2 * n + j], "residual")],
                unit,
                group,
                height=125,
                masked=masked,
                last=True,
            )
        )
    return "\n".join(parts)
