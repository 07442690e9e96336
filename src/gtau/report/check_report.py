"""The report of a check: what the logs hold, before anything is identified from them."""

from __future__ import annotations

import numpy as np

from gtau.estimation.check_logs import ExperimentCheck, LogCheck
from gtau.estimation.grades import Grade
from gtau.report import provenance
from gtau.report.evidence import payload_words
from gtau.report.findings_section import notes_section
from gtau.report.geometry_section import geometry_section
from gtau.report.html.document import Section
from gtau.report.html.elements import Cell, Column, folded, number, table, text, verdict
from gtau.report.html.series import COLOURS, Arrays, Line, buckets_for, chart, envelope, key, zoom_tools
from gtau.report.identification_report import page
from gtau.report.log_page import gate_words
from gtau.report.log_section import logs_section
from gtau.report.motion_section import distances_part
from gtau.report.provenance import Provenance
from gtau.report.robot_drawing import robot_drawing
from gtau.report.style import joint_label
from gtau.robots.robot import Robot
from gtau.robots.units import command_unit
from gtau.signals.samples import counted


def check_report(checked: ExperimentCheck, of: Provenance) -> str:
    """Render the report of a check as the text of one HTML file."""
    arrays, preparation = Arrays(), checked.preparation
    starts = {log.run.name: float(log.run.time[0]) for log in checked.logs}
    nearest = [each for log in checked.logs for each in log.nearest]
    distances = [log.distances for log in checked.logs]
    robot = f'<figure class="panel robot">{robot_drawing(checked.robot)}</figure>'
    sections = (
        _verdict(checked),
        notes_section(checked.notes),
        Section("joints", "Joints", "\n".join(_joints(log, checked.robot) for log in checked.logs)),
        Section("motion", "Motion", _motion(checked, arrays)),
        Section("robot", "Robot and singular poses", robot + distances_part(nearest, distances, starts, arrays)),
        logs_section([log.run for log in checked.logs], checked.robot, preparation.bandwidth, preparation.cutoff)
        if preparation
        else None,
        geometry_section(checked.geometry, arrays),
        provenance.section(of),
    )
    lead = [f"{len(checked.logs)} logs; nothing has been identified from them yet."]
    return page(f"Logs of {checked.robot.name}", lead, sections, arrays)


def _verdict(checked: ExperimentCheck) -> Section:
    used = [log for log in checked.logs if not log.validation]
    seconds = sum(float(log.run.time[-1] - log.run.time[0]) for log in used)
    colour = {Grade.STOPS: "bad", Grade.MEND: "weak", Grade.INFORMATION: "good"}[checked.worst]
    said = [f"{counted(len(used), 'run')} of {seconds:.4g} s in all for the identification"]
    return Section("verdict", "Verdict", verdict(colour, gate_words(checked.notes), said))


def _joints(log: LogCheck, robot: Robot) -> str:
    rows = []
    for each in log.joints:
        unit, (low, high) = _unit(robot, each.joint), each.position
        rows.append(
            [
                text(joint_label(each.joint), "unit"),
                Cell(f"{low:.3g} to {high:.3g} {unit}".replace("-", "\N{MINUS SIGN}"), True, high - low),
                number(each.speed_rms, 3),
                number(each.speed_max, 3),
                text(f"{unit}/s", "unit"),
                number(each.bandwidth if np.isfinite(each.bandwidth) else None, 3, "at rest"),
                number(each.command_rms, 3),
                number(each.command_max, 3),
                text(command_unit(robot, each.joint, log.run.kind), "unit"),
                Cell(f"{100 * each.usable:.0f}", True, each.usable),
            ]
        )
    command = "current" if log.run.kind == "current" else "torque"
    columns = [
        Column("joint"),
        Column("position", True),
        Column("speed rms", True),
        Column("max", True),
        Column("unit"),
        Column("bandwidth, Hz", True),
        Column(f"{command} rms", True),
        Column("max", True),
        Column("unit"),
        Column("samples used, %", True),
    ]
    purpose = "validation" if log.validation else "identification"
    words = f"{log.run.name} ({purpose}, {payload_words(log.run)})"
    return folded(words, table(columns, rows), shown=True)


def _motion(checked: ExperimentCheck, arrays: Arrays) -> str:
    buckets = buckets_for(len(checked.logs) * len(checked.robot.actuated))
    parts = []
    for k, log in enumerate(checked.logs):
        time, thin = envelope(log.distances.time - float(log.run.time[0]), log.position, buckets)
        colours = [(joint_label(each.joint), f"c{j % COLOURS}") for j, each in enumerate(log.joints)]
        drawn = [zoom_tools(f"motion-{k}"), key(colours)]
        for unit in ("rad", "m"):
            lines = [
                Line(joint_label(each.joint), thin[:, j], f"c{j % COLOURS}", 1.3)
                for j, each in enumerate(log.joints)
                if _unit(checked.robot, each.joint) == unit
            ]
            if lines:
                drawn.append(chart(arrays, time, lines, f"position, {unit}", f"motion-{k}", height=210))
        parts.append(folded(log.run.name, "\n".join(drawn), shown=k == 0))
    return "\n".join(parts)


def _unit(robot: Robot, joint: str) -> str:
    return "rad" if robot.joint(joint).kind == "revolute" else "m"
