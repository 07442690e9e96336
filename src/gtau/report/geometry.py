"""Show findings of logged poses on lengths and encoder zeros, as a section of a page."""

from __future__ import annotations

from gtau.estimation.diagnostics.geometry_findings import GeometryTest, percent
from gtau.estimation.thresholds.logs import POSE_DELAY_STD
from gtau.report.chart import Axis, Chart, Panel, Series, colour
from gtau.report.page import Column, Kind, Section, Table, Text, section, table

STYLES = {"confirmed": "good", "other constants": "bad", "unexplained": "weak"}
LISTED = 12  # constants
ROUNDING = 1e-3  # of the rms: a smaller bias is shown as zero
ESTIMATED = {
    "controller": "Nothing but the delay of the poses was estimated beside the constants.",
    "tool": "The position of the tool on the body was estimated too.",
    "tracker": "The positions of the tracker (in each run) and its marker were estimated beside the constants.",
}


def geometry_section(test: GeometryTest | None) -> Section | None:
    """Show residuals of the pose in time and by component, and the constants that would explain them."""
    if test is None:
        return None
    said = [ESTIMATED[test.source]]
    delay, std = test.delay
    if std < POSE_DELAY_STD:
        said.append(f"the poses lag {1e3 * delay:.1f} ± {1e3 * std:.1g} ms behind the positions")
    return section(
        "Logged pose and geometry",
        Text(str(test.note), tuple(said), STYLES[test.outcome]),  # type: ignore[arg-type]
        *(section(run, _traces(test, run), folded=k > 0) for k, run in enumerate(_traced_runs(test))),
        section(f"Residuals of the pose of '{test.body}': logged less computed", _residuals(test), folded=False),
        section(
            "Constants, each by itself, sorted by the share of the residual variance explained",
            _constants(test),
            Text(f"{len(test.tried) - LISTED} more explain less; model.json and --json list them.")
            if len(test.tried) > LISTED
            else None,
            Text(f"Not identifiable by this pose: {', '.join(test.unseen)}.") if test.unseen else None,
            folded=False,
        ),
        id="geometry",
    )


def _traced_runs(test: GeometryTest) -> dict[str, None]:
    return dict.fromkeys(residual.run for residual in test.residuals if residual.time.size)


def _traces(test: GeometryTest, run: str) -> Chart:
    components = [residual for residual in test.residuals if residual.run == run]
    shown = {"logged less computed": [residual.before for residual in components]}
    if test.explained_by:
        shown["with the change"] = [residual.after for residual in components]
    panels = []
    for words, values in shown.items():
        for unit in ("m", "rad"):
            lines = [
                Series(f"{residual.name}, {words}", residual.time, 1e3 * values[j], colour(j))
                for j, residual in enumerate(components)
                if residual.unit == unit
            ]
            if lines:
                panels.append(
                    Panel(Axis("time from the start of the run, s"), Axis(f"{words}, m{unit}"), tuple(lines), height=2)
                )
    return Chart(tuple(panels), run, live=True)


def _residuals(test: GeometryTest) -> Table:
    columns = [Column("run"), Column("component"), Column("rms", Kind.NUMBER, 3), Column("bias", Kind.NUMBER, 2)]
    columns += [Column("rms with the changes", Kind.NUMBER, 3)] if test.explained_by else []
    rows = [
        (
            each.run,
            each.name,
            1e3 * each.rms,
            1e3 * each.bias if abs(each.bias) > ROUNDING * each.rms else 0.0,
            *([1e3 * each.rms_after] if test.explained_by else []),
            f"m{each.unit}",
        )
        for each in test.residuals
    ]
    return table([*columns, Column("unit")], rows)


def _constants(test: GeometryTest) -> Table:
    columns = (
        Column("length or encoder zero"),
        Column("in the robot file", Kind.NUMBER, 5),
        Column("change", Kind.NUMBER, 3),
        Column("std", Kind.NUMBER, 2),
        Column("unit"),
        Column("explains", Kind.NUMBER),
    )
    rows = [
        (
            each.name,
            1e3 * each.value if each.value else None,
            1e3 * each.change,
            1e3 * each.std,
            f"m{each.unit}",
            percent(each.share),
        )
        for each in test.tried[:LISTED]
    ]
    return table(columns, rows)
