"""The report of a designed motion: the motion, what to expect of it, and the limits that it uses."""

from __future__ import annotations

from typing import Any

import numpy as np

from gtau.excitation.design import Design
from gtau.excitation.forecast import sampled_motions
from gtau.report import provenance
from gtau.report.html.document import Section
from gtau.report.html.elements import Cell, Column, bullets, escape, facts, number, paragraph, table, text, verdict
from gtau.report.html.series import COLOURS, Arrays, Line, buckets_for, chart, envelope, key, zoom_tools
from gtau.report.identification_report import page
from gtau.report.provenance import Provenance
from gtau.report.robot_drawing import robot_drawing
from gtau.report.style import joint_label

ORDERS = (("position", ""), ("velocity", "/s"), ("acceleration", "/s²"))


def design_report(design: Design, document: dict[str, Any], of: Provenance) -> str:
    """Render the report of a design, whose ``document`` is in ``design.json``, as the text of one HTML file."""
    arrays, robot = Arrays(), design.task.model.robot
    sections = (
        _verdict(document),
        Section("gains", "Drive gains to expect", _expected(document["gains"])),
        Section("motion", "Motion", _motion(design, arrays)),
        Section("limits", "Limits", _limits(document)),
        Section("parameters", "Parameters to expect", _expected(document["parameters"], "parameter-table")),
        _masses(document),
        Section("robot", "Robot", f'<figure class="panel robot">{robot_drawing(robot)}</figure>'),
        Section("assumed", "Assumptions", bullets(document["assumed"]) or paragraph("Nothing was assumed.")),
        provenance.section(of),
    )
    lead = [f"Criterion: {document['criterion']}. Runs: {', '.join(map(_load, document['runs']))}."]
    return page(f"Exciting motion for {document['robot']}", lead, sections, arrays)


def _load(run: str) -> str:
    return "no payload" if run == "none" else f"payload '{run}'"


def _verdict(document: dict[str, Any]) -> Section:
    expected = document["gains_rms"]
    words = (
        f"With this motion of {document['duration']:.4g} s a run, the drive gains can be identified with a standard "
        f"deviation of {expected:.2g} % (rms over the joints)."
    )
    weak: dict[str, list[str]] = {}
    for each in document["weak"]:
        weak.setdefault(each["advice"], []).append(f"{each['name']} ({each['rel_std']:.3g} %)")
    sentences = [f"poorly determined (30 % or more): {', '.join(names)}; {advice}" for advice, names in weak.items()]
    if document["without_effect"]:
        sentences.append(f"without effect on any motor, whatever the motion: {', '.join(document['without_effect'])}")
    sentences.append("these standard deviations hold for white noise; model errors add to them")
    shown = facts(
        {
            "period": f"{document['period']:.4g} s",
            "repetitions": document["repetitions"],
            "duration of a run": f"{document['duration']:.4g} s",
            "motions": "one for all runs" if document["motions"] == "one" else "one for each run",
        }
    )
    return Section("verdict", "Verdict", verdict("plain", words, sentences) + shown)


def _expected(entries: list[dict[str, Any]], sortable: str = "") -> str:
    some = any(each["assumed"] for each in entries)
    rows = [
        [
            text(each["name"], "mono"),
            number(each["value"]),
            number(each["std"], 2),
            number(each["rel_std"], 3),
            text(each["unit"], "unit"),
            *([text("assumed" if each["assumed"] else "given")] if some else []),
        ]
        for each in entries
    ]
    columns = [
        Column("name"),
        Column("prior value", True),
        Column("std to expect", True),
        Column("std, %", True),
        Column("unit"),
        *([Column("prior value is")] if some else []),
    ]
    return table(columns, rows, sortable=sortable)


def _motion(design: Design, arrays: Arrays) -> str:
    model = design.task.model
    motions = sampled_motions(design.task, design.x)
    buckets = buckets_for(len(motions) * len(ORDERS) * len(model.actuated))
    parts = []
    for k, (time, joints) in enumerate(motions):
        followed = ", ".join(f"run {run + 1}" for run in design.task.motions[k])
        parts.append(f"<h3>Motion {k + 1}, of {escape(followed)}</h3>" if len(motions) > 1 else "")
        colours = [(joint_label(joint), f"c{j % COLOURS}") for j, joint in enumerate(model.actuated)]
        parts += [zoom_tools(f"motion-{k}"), key(colours)]
        for order, (what, per) in enumerate(ORDERS):
            thinned, thin = envelope(time, np.ascontiguousarray(joints[order].T), buckets)
            for unit in ("rad", "m"):
                lines = [
                    Line(joint_label(joint), thin[:, j], f"c{j % COLOURS}", 1.3)
                    for j, joint in enumerate(model.actuated)
                    if (model.robot.joint(joint).kind == "revolute") == (unit == "rad")
                ]
                if lines:
                    parts.append(chart(arrays, thinned, lines, f"{what}, {unit}{per}", f"motion-{k}", height=190))
    return "\n".join(parts)


def _limits(document: dict[str, Any]) -> str:
    rows = [
        [text(each["limit"]), number(each["value"], 4), text(each["unit"], "unit"), _used(each["used"])]
        for each in document["limits"]
    ]
    columns = [Column("limit"), Column("value", True), Column("unit"), Column("used", True)]
    return table(columns, rows)


def _used(share: float) -> Cell:
    bar = (
        '<svg width="120" height="10" role="img" aria-hidden="true"><rect width="120" height="10" class="band"/>'
        f'<rect width="{120 * min(max(share, 0.0), 1.0):.0f}" height="10" style="fill:var(--predicted)"/></svg>'
    )
    return Cell(f"{100 * share:.1f} % {bar}", True, share)


def _masses(document: dict[str, Any]) -> Section | None:
    if not document["payload_masses"]:
        return None
    joints = [each["name"] for each in document["gains"]]
    rows = [
        [
            Cell(f"{each['mass']:g}", True, each["mass"]),
            number(each["rms"], 3),
            *(number(each["rel_std"][joint], 3) for joint in joints),
            text(", ".join(each["exceeded"]) or "none"),
        ]
        for each in document["payload_masses"]
    ]
    columns = [
        Column("payload, kg", True),
        Column("rms, %", True),
        *(Column(f"{joint_label(joint)}, %", True) for joint in joints),
        Column("limits exceeded"),
    ]
    return Section("masses", "Other payload masses", table(columns, rows))
