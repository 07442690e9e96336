"""The section on logged poses: whether they confirm the robot's geometry."""

from __future__ import annotations

from gtau.estimation.diagnostics.geometry_findings import GeometryTest, percent
from gtau.estimation.results.geometry_text import late
from gtau.estimation.thresholds.logs import POSE_DELAY_STD
from gtau.report.html.document import Section
from gtau.report.html.elements import Column, folded, number, paragraph, sentence, table, text, verdict
from gtau.report.html.series import COLOURS, Arrays, Line, chart, key, zoom_tools

GRADES = {"confirmed": "good", "other constants": "bad", "unexplained": "weak"}
TABLE = 12  # constants that the table shows


def geometry_section(test: GeometryTest | None, arrays: Arrays) -> Section | None:
    """Show residuals of the pose in time and by component, and the constants that would explain them."""
    if test is None:
        return None
    parts = [verdict(GRADES[test.outcome], sentence(str(test.note)), _frames(test))]
    for k, trace in enumerate(test.traces):
        names = [(each.name, each.unit) for each in test.residuals if each.run == trace.run]
        drawn = [zoom_tools(f"pose-{k}"), key([(name, f"c{j % COLOURS}") for j, (name, _) in enumerate(names)])]
        shown = (("logged less computed", trace.before), ("with the change", trace.after))
        for words, values in shown[: 2 if test.explained_by else 1]:
            for unit in ("m", "rad"):
                lines = [
                    Line(f"{name}, {words}", 1e3 * values[:, j], f"c{j % COLOURS}", 1.3)
                    for j, (name, of_name) in enumerate(names)
                    if of_name == unit
                ]
                if lines:
                    label = f"{words}, m{unit}"
                    drawn.append(chart(arrays, trace.time, lines, label, f"pose-{k}", height=200))
        parts.append(folded(trace.run, "\n".join(drawn), shown=k == 0))
    parts += [_residuals(test), _constants(test)]
    return Section("geometry", "Logged pose and geometry", "\n".join(parts))


def _frames(test: GeometryTest) -> list[str]:
    estimated = {
        "controller": "Nothing but the delay of the poses was estimated beside the constants.",
        "tool": "The position of the tool on the body was estimated too.",
        "tracker": "Where the tracker (in each run) and its marker stand was estimated beside the constants.",
    }[test.source]
    return [estimated, *([sentence(late(test))] if test.delay_std < POSE_DELAY_STD else [])]


def _residuals(test: GeometryTest) -> str:
    columns = [Column("run"), Column("component"), Column("rms", True), Column("bias", True)]
    columns += [*([Column("rms with the changes", True)] if test.explained_by else []), Column("unit")]
    rows = [
        [
            text(each.run),
            text(each.name),
            number(1e3 * each.rms, 3),
            number(1e3 * each.bias, 2),
            *([number(1e3 * each.rms_after, 3)] if test.explained_by else []),
            text(f"m{each.unit}", "unit"),
        ]
        for each in test.residuals
    ]
    return folded("Residuals by component: logged less computed from the positions", table(columns, rows), shown=True)


def _constants(test: GeometryTest) -> str:
    columns = [Column("length or encoder zero"), Column("in the robot file", True), Column("change", True)]
    columns += [Column("standard deviation", True), Column("unit"), Column("explains", True)]
    rows = [
        [
            text(each.name),
            number(1e3 * each.value if each.value else None, 5),
            number(1e3 * each.change, 3),
            number(1e3 * each.std, 2),
            text(f"m{each.unit}", "unit"),
            text(percent(each.share), "number"),
        ]
        for each in test.tried[:TABLE]
    ]
    words = "Each by itself, the one that explains most of the residual variance first"
    more = len(test.tried) - TABLE
    parts = [table(columns, rows)]
    if more > 0:
        parts.append(paragraph(f"{more} more explain less; model.json and --json list them."))
    if test.unseen:
        parts.append(paragraph(f"Not identifiable by this pose: {', '.join(test.unseen)}."))
    return folded(words, "\n".join(parts), shown=True)
