"""The report of a fleet: each joint's gain on every robot, and which stand apart."""

from __future__ import annotations

import numpy as np

from gtau.fleet.gains import FleetTable, JointOfFleet
from gtau.report import provenance
from gtau.report.fleet_page import remarks
from gtau.report.html.document import Section
from gtau.report.html.drawings import Interval, Panel, interval_rows, panel_figure
from gtau.report.html.elements import Cell, Column, badge, escape, facts, number, paragraph, table, text, verdict
from gtau.report.html.series import Arrays
from gtau.report.identification_report import page
from gtau.report.provenance import Provenance
from gtau.report.style import joint_label

INTERVAL = 1.96  # standard deviations to either side, 95 %
ROWS = 40  # robots that have a row each; of more, a panel shows all


def fleet_report(found: FleetTable, of: Provenance) -> str:
    """Render the report of a fleet as the text of one HTML file."""
    sections = (
        _verdict(found),
        _joints(found),
        _charts(found),
        _gains(found),
        _refused(found),
        provenance.section(of),
    )
    return page("Drive gains of a fleet", [f"{len(found.robots)} robots."], sections, Arrays())


def _verdict(found: FleetTable) -> Section:
    outliers = found.outliers
    robots = list(dict.fromkeys(gain.robot for gain in outliers))
    if not found.robots:
        words, grade = "No robot could be identified.", "bad"
    elif outliers:
        words = f"{len(outliers)} drive gain{'' if len(outliers) == 1 else 's'} of {len(robots)} robot"
        words, grade = f"{words}{'' if len(robots) == 1 else 's'} stand apart from the fleet.", "weak"
    elif any(joint.comparable for joint in found.joints):
        words, grade = "No drive gain is an outlier in the fleet.", "good"
    else:
        words, grade = "The robots are identified, but too few to detect outliers among them.", "plain"
    sentences = [
        f"robot '{gain.robot}', {joint_label(gain.joint)}: {gain.difference_percent or 0.0:+.3g} % from the median, "
        f"{abs(gain.z or 0.0):.3g} standard deviations"
        for gain in outliers[:10]
    ]
    shown = facts({"identified": len(found.robots), "refused": len(found.refused), "outliers": len(outliers)})
    return Section("verdict", "Verdict", verdict(grade, words, [*sentences, *remarks(found)]) + shown)


def _joints(found: FleetTable) -> Section:
    rows = [
        [
            text(each.model),
            text(joint_label(each.joint), "unit"),
            number(float(each.robots), 6),
            number(each.median),
            number(each.median_std, 2),
            Cell(f"{100 * each.spread / abs(each.median):.2f}", True, each.spread / abs(each.median)),
            text(each.unit, "unit"),
        ]
        for each in found.joints
    ]
    columns = [
        Column("model"),
        Column("joint"),
        Column("robots", True),
        Column("median gain", True),
        Column("std of the median", True),
        Column("spread, %", True),
        Column("unit"),
    ]
    return Section("joints", "Joints over the fleet", table(columns, rows))


def _charts(found: FleetTable) -> Section:
    parts = [_chart(found, joint) for joint in found.joints]
    words = "Per cent from the median of the joint; lines are 95 % intervals."
    return Section("chart", "Gains by robot", paragraph(words, "soft") + "\n".join(parts))


def _chart(found: FleetTable, joint: JointOfFleet) -> str:
    gains = [g for g in found.gains if (g.model, g.joint, g.unit) == (joint.model, joint.joint, joint.unit)]
    gains = [g for g in gains if g.difference_percent is not None]
    title = f"{joint.model}, {joint_label(joint.joint)}: median {joint.median:.5g} {joint.unit}"
    percent = 100 / abs(joint.median)
    if len(gains) > ROWS:
        values = [g.difference_percent or 0.0 for g in gains]
        size = 1.1 * max(max(map(abs, values)), 1e-9)
        panel = Panel((0.0, len(gains) + 1.0), (-size, size), "robot", "from median, %", (640.0, 220.0))
        panel.band(-percent * joint.spread, percent * joint.spread)
        panel.rule(y=0.0)
        for outlier, colour in ((False, "predicted"), (True, "residual")):
            at = np.flatnonzero([g.outlier == outlier for g in gains])
            labels = [f"{gains[k].robot}: {values[k]:+.3g} %" for k in at]
            panel.points(at + 1.0, np.array(values)[at], colour, labels)
        return panel_figure(title, panel.svg(title))
    bars, axis = interval_rows(
        [
            Interval(
                g.difference_percent,
                (g.difference_percent - INTERVAL * percent * g.std, g.difference_percent + INTERVAL * percent * g.std)
                if g.std is not None and g.difference_percent is not None
                else None,
            )
            for g in gains
        ],
        zero=0.0,
    )
    rows = "".join(
        f'<tr><td class="name">{escape(g.robot)}{" " + badge("outlier").html if g.outlier else ""}</td>'
        f'<td class="bar">{bar}</td></tr>'
        for g, bar in zip(gains, bars, strict=True)
    )
    return (
        f'<h3>{escape(title)}</h3><div class="scroll"><table class="intervals"><tbody>{rows}'
        f'<tr><td class="soft">from median, %</td><td class="bar">{axis}</td></tr></tbody></table></div>'
    )


def _gains(found: FleetTable) -> Section:
    rows = [
        [
            text(g.robot),
            text(joint_label(g.joint), "unit"),
            badge("outlier") if g.outlier else badge(g.outcome),
            number(g.gain),
            number(g.std, 2),
            text(g.unit, "unit"),
            number(g.difference_percent, 3),
            number(g.z, 3),
            text(g.why),
        ]
        for g in found.gains
    ]
    columns = [
        Column("robot"),
        Column("joint"),
        Column("verdict"),
        Column("gain", True),
        Column("std", True),
        Column("unit"),
        Column("from median, %", True),
        Column("z", True),
        Column("why"),
    ]
    return Section("gains", "All gains", table(columns, rows, sortable="gains-table"))


def _refused(found: FleetTable) -> Section | None:
    if not found.refused:
        return None
    rows = [[text(robot), text(why)] for robot, why in found.refused]
    return Section("refused", "Refused robots", table([Column("robot"), Column("why")], rows))
