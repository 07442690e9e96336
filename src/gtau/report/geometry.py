"""Show findings of logged poses on lengths and encoder zeros, as a section of a page."""

from __future__ import annotations

from gtau.estimation.diagnostics.geometry_findings import GeometryTest, percent
from gtau.estimation.thresholds.logs import POSE_DELAY_STD
from gtau.report.chart import Axis, Chart, Panel, Series, colour
from gtau.report.motion import TIME
from gtau.report.page import Column, Kind, Section, Table, Text, section, table_of

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
    shown = {"logged less computed": "before"} | ({"with the change": "after"} if test.explained_by else {})
    panels = []
    for words, which in shown.items():
        for unit in ("m", "rad"):
            lines = tuple(
                Series(f"{component.name}, {words}", component.time, 1e3 * getattr(component, which), colour(j))
                for j, component in enumerate(components)
                if component.unit == unit
            )
            panels += [Panel(TIME, Axis(f"{words}, m{unit}"), lines, height=2)] if lines else []
    return Chart(tuple(panels), run, live=True)


def _residuals(test: GeometryTest) -> Table:
    after = (Column("rms with the changes", Kind.NUMBER, 3), lambda residual: 1e3 * residual.rms_after)
    return table_of(
        test.residuals,
        (Column("run"), "run"),
        (Column("component"), "name"),
        (Column("rms", Kind.NUMBER, 3), lambda residual: 1e3 * residual.rms),
        (Column("bias", Kind.NUMBER, 2), lambda pose: 1e3 * pose.bias * (abs(pose.bias) > ROUNDING * pose.rms)),
        *([after] if test.explained_by else []),
        (Column("unit"), lambda residual: f"m{residual.unit}"),
    )


def _constants(test: GeometryTest) -> Table:
    return table_of(
        test.tried[:LISTED],
        (Column("length or encoder zero"), "name"),
        (Column("in the robot file", Kind.NUMBER, 5), lambda constant: 1e3 * constant.value or None),
        (Column("change", Kind.NUMBER, 3), lambda constant: 1e3 * constant.change),
        (Column("std", Kind.NUMBER, 2), lambda constant: 1e3 * constant.std),
        (Column("unit"), lambda constant: f"m{constant.unit}"),
        (Column("explains", Kind.NUMBER), lambda constant: percent(constant.share)),
    )
