"""How results show themselves in notebooks: the views that :mod:`gtau.display` finds.

Each is a small page in a frame of its own, so that its styles touch nothing of the notebook's.
"""

from __future__ import annotations

from functools import singledispatch
from pathlib import Path

from gtau.documents.files import write_atomically
from gtau.estimation.check_logs import ExperimentCheck
from gtau.estimation.compare import EstimatorComparison
from gtau.estimation.results.estimate import Named, PayloadEstimate, Prediction
from gtau.estimation.results.result import Result
from gtau.report.comparison_report import comparison_table, headline
from gtau.report.evidence import Evidence, gather, settings_of
from gtau.report.findings_section import findings_table
from gtau.report.gain_sections import gains_section, interval_cell, payloads_section, verdict_section
from gtau.report.html.document import asset, style
from gtau.report.html.elements import Cell, Column, escape, number, table, text, verdict
from gtau.report.html.series import Arrays, Line, chart, envelope, key, stretches, zoom_tools
from gtau.report.plots import Plots
from gtau.report.provenance import Provenance
from gtau.report.style import joint_label

BUCKETS = 1000  # of a chart in a notebook
FIT = "try { frameElement.style.height = document.body.getBoundingClientRect().height + 16 + 'px'; } catch (outside) {}"


def html(shown: object) -> str:
    """Write the markup of an object for a notebook: a frame with its view."""
    arrays = Arrays()
    body = view(shown, arrays)
    scripts = [f"new ResizeObserver(() => {{ {FIT} }}).observe(document.body);"]
    if arrays.drawn:
        scripts = [asset("uPlot.iife.min.js"), asset("report.js"), *scripts]
    code = "".join(f"<script>{script}</script>" for script in scripts)
    styles = (asset("uPlot.min.css") if arrays.drawn else "") + style()
    page = (
        f'<!DOCTYPE html><html lang="en"><meta charset="utf-8"><style>{styles}</style><body class="embedded"><main>'
        f"{body}</main>{arrays.script()}{code}</body></html>"
    )
    return f'<iframe srcdoc="{escape(page)}" style="width:100%;height:24em;border:0" title="gtau"></iframe>'


def plots(result: Result) -> Plots:
    """Return the figures of a result."""
    return Plots(result)


def write(result: Result, path: Path) -> None:
    """Write the report of a result, with the runs that it holds, to an HTML file."""
    from gtau.report.identification_report import identification_report

    evidence = gather(result, result.data)
    write_atomically(path, identification_report(evidence, Provenance("", settings=settings_of(result))))


@singledispatch
def view(shown: object, arrays: Arrays) -> str:
    """Write the markup of an object, whose charts put what they draw into ``arrays``."""
    return f"<pre>{escape(repr(shown))}</pre>"


@view.register
def _(shown: Result, arrays: Arrays) -> str:
    evidence = Evidence(shown)
    payloads = payloads_section([each for each in shown.payloads if set(each.parameters) - each.known])
    sections = [verdict_section(evidence), gains_section(evidence), payloads]
    return "".join(section.html for section in sections if section is not None)


@view.register
def _(shown: EstimatorComparison, arrays: Arrays) -> str:
    return verdict("plain", headline(shown), []) + comparison_table(shown, {})


@view.register
def _(shown: PayloadEstimate, arrays: Arrays) -> str:
    section = payloads_section([shown])
    return "" if section is None else section.html


@view.register
def _(shown: Named, arrays: Arrays) -> str:
    rows = [
        [
            text(name, "mono"),
            number(each.value, missing="not identifiable"),
            interval_cell(each.interval()),
            text(each.unit, "unit"),
            text(each.verdict.outcome.value),
        ]
        for name, each in shown.items()
    ]
    columns = [Column("name"), Column("value", True), Column("95 % interval", True), Column("unit"), Column("verdict")]
    return table(columns, rows)


@view.register
def _(shown: Prediction, arrays: Arrays) -> str:
    time, thin = envelope(shown.time - shown.time[0], shown.measured, BUCKETS)
    predicted = envelope(shown.time, shown.predicted, BUCKETS)[1]
    shortest = float(time[-1]) / 1000
    parts = [zoom_tools("torques"), key([("measured", "measured"), ("predicted", "predicted"), ("masked", "shade")])]
    for j, joint in enumerate(shown.joints):
        masked = stretches(shown.time - shown.time[0], ~shown.keep[:, j], shortest)
        lines = [
            Line("measured", thin[:, j], "measured", 2.6),
            Line("predicted", predicted[:, j], "predicted", 1.2),
        ]
        parts.append(f"<h4>{escape(joint_label(joint))}</h4>")
        parts.append(chart(arrays, time, lines, "N m or N", "torques", masked=masked, xlabel="time, s"))
    return "".join(parts)


@view.register
def _(shown: ExperimentCheck, arrays: Arrays) -> str:
    rows = [
        [
            text(log.run.name),
            text("validation" if log.validation else "identification"),
            number(log.run.rate, 5),
            number(float(log.run.time[-1] - log.run.time[0]), 4),
            Cell(f"{100 * min(joint.usable for joint in log.joints):.0f}", True),
        ]
        for log in shown.logs
    ]
    columns = [
        Column("log"),
        Column("for"),
        Column("rate, Hz", True),
        Column("duration, s", True),
        Column("samples used, % (least of the joints)", True),
    ]
    return table(columns, rows) + findings_table(shown.notes)
