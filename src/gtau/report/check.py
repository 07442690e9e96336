"""Show the logs of an experiment before an identification, as page, JSON document and files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

from gtau.estimation.check_logs import WEIGHING, CheckedExperiment, LogCheck
from gtau.estimation.diagnostics.geometry import to_document as geometry_document
from gtau.findings import Finding, Grade, by_severity, counted, note_document
from gtau.report import motion
from gtau.report.chart import Chart
from gtau.report.evidence import findings_section, preparation_words, same_in_several
from gtau.report.page import Column, ColumnOf, Facts, Kind, Page, Section, Text, joint_label, table_of
from gtau.report.robot import geometry_section
from gtau.robots.parameter import command_unit
from gtau.robots.robot import Robot


def check_document(checked: CheckedExperiment) -> dict[str, Any]:
    """Describe the check as a JSON document in SI units."""
    preparation = checked.preparation
    return {
        "robot": checked.robot.name,
        "worst": checked.worst.value if checked.notes else None,
        "findings": [note_document(note) for members in by_severity(checked.notes).values() for note in members],
        "preparation": preparation
        and {
            "bandwidth": preparation.bandwidth,
            "cutoff": preparation.cutoff,
            "decimation": preparation.decimator.factor,
            "decimator": preparation.decimator.kind,
        },
        "logs": [_log_document(log, checked.robot) for log in checked.logs],
        "geometry": checked.geometry and geometry_document(checked.geometry),
    }


def _log_document(log: LogCheck, robot: Robot) -> dict[str, Any]:
    run = log.run
    return {
        "log": run.name,
        "validation": log.validation,
        "payload": None if run.payload is None else {"name": run.payload.name, "mass": run.payload.mass},
        "samples": len(run.time),
        "rate": run.rate,
        "duration": motion.seconds(run),
        "rows": log.rows,
        "joints": [
            {
                "joint": joint.joint,
                "moves": joint.spectrum.moves,
                "unit": robot.joint(joint.joint).unit,
                "position": list(joint.position),
                "speed": {"rms": joint.speed_rms, "max": joint.speed_max},
                "bandwidth": joint.bandwidth if joint.spectrum.moves else None,
                "command_unit": command_unit(robot, joint.joint, run.kind),
                "command": {"rms": joint.command_rms, "max": joint.command_max},
                "usable": joint.usable,
            }
            for joint in log.joints
        ],
        "wrenches": [asdict(wrench) for wrench in log.wrenches],
        "singularities": [
            {"type": pose.type, "distance": pose.distance, "time": pose.time, "pose": dict(pose.pose)}
            for pose in log.nearest
        ],
    }


def check_page(checked: CheckedExperiment) -> Page:
    """Show the contents of the logs, and whether an identification can use them."""
    robot, preparation = checked.robot, checked.preparation
    nearest = [pose for log in checked.logs for pose in log.nearest]
    motions = [Section(log.run.name, motion_chart(log, robot), folded=k > 0) for k, log in enumerate(checked.logs)]
    prepared = [Section(log.run.name, motion.preparation_chart(log), folded=True) for log in checked.logs]
    logs = table_of(
        checked.logs,
        (Column("log"), "run.name"),
        (Column("used for"), _purpose),
        (Column("payload"), lambda log: motion.payload_words(log.run).removeprefix("payload ")),
        (Column("samples", Kind.NUMBER, 8), lambda log: len(log.run.time)),
        (Column("rate, Hz", Kind.NUMBER, 5), "run.rate"),
        (Column("duration, s", Kind.NUMBER), lambda log: motion.seconds(log.run)),
        (Column("rows a joint", Kind.NUMBER), "rows"),
        (Column("repaired, %", Kind.SHARE, 2, wide=True), lambda log: 1 - motion.valid_share(log.run)),
    )
    settings = None
    if preparation is not None:
        bandwidth, cutoff, decimation = preparation_words(preparation)
        settings = Facts({"bandwidth": bandwidth, "position filter": cutoff, "decimation": decimation})
    return Page(
        f"Logs of {checked.robot.name}",
        _verdict(checked),
        findings_section(checked.notes),
        Section("Logs", logs, settings, id="logs") if checked.logs else None,
        Section("Joints", *(_joints(log, checked.robot) for log in checked.logs), id="joints"),
        Section("Robot and singular poses", robot, motion.singularities_section(nearest), id="robot"),
        geometry_section(checked.geometry),
        Section("Motion", *motions, id="motion"),
        Section("Preparation", *prepared, id="preparation"),
    )


def _verdict(checked: CheckedExperiment) -> Section:
    used = [log for log in checked.logs if not log.validation]
    style = {Grade.ERROR: "bad", Grade.WARNING: "weak", Grade.INFORMATION: "good"}[checked.worst]
    time = sum(motion.seconds(log.run) for log in used)
    runs = f"{counted(len(used), 'run')} of {time:.4g} s in all for the identification"
    said = (runs,) if used else ()
    return Section("Verdict", Text(expectation(checked.notes), said, style), id="verdict")  # type: ignore[arg-type]


def expectation(notes: Sequence[Finding]) -> str:
    """State in one sentence whether an identification can use these logs."""
    listed = by_severity(same_in_several(notes))
    command = "gtau payload" if any(note.kind == WEIGHING for note in notes) else "gtau identify"
    if errors := listed.get(Grade.ERROR):
        return f"{command} will refuse these logs: {counted(len(errors), 'error')} to resolve first."
    if warnings := listed.get(Grade.WARNING):
        return f"{command} can read these logs; {counted(len(warnings), 'warning')} to look into first."
    return f"{command} can use these logs as they are."


def _purpose(log: LogCheck) -> str:
    return "validation" if log.validation else "identification"


def _joints(log: LogCheck, robot: Robot) -> Section:
    units = {joint.joint: robot.joint(joint.joint).unit for joint in log.joints}
    speeds = {joint: f"{unit}/s" for joint, unit in units.items()}
    commands = {joint: command_unit(robot, joint, log.run.kind) for joint in units}
    kind = {"A": "current", "N": "force"}.get(commands[log.joints[-1].joint], "torque")
    listed = table_of(
        log.joints,
        (Column("joint"), lambda joint: joint_label(joint.joint)),
        (Column(f"position{_shared(units)}", Kind.INTERVAL), "position"),
        (Column(f"speed rms{_shared(speeds)}", Kind.NUMBER, 3), "speed_rms"),
        (Column(f"max{_shared(speeds)}", Kind.NUMBER, 3, wide=True), "speed_max"),
        *_unit_column(speeds),
        (Column("bandwidth, Hz", Kind.NUMBER, 3, missing="at rest"), "bandwidth"),
        (Column(f"{kind} rms{_shared(commands)}", Kind.NUMBER, 3), "command_rms"),
        (Column(f"max{_shared(commands)}", Kind.NUMBER, 3), "command_max"),
        *_unit_column(commands),
        (Column("rows used, %", Kind.SHARE, decimals=0), "usable"),
    )
    wrenches = table_of(
        log.wrenches,
        (Column("wrench on"), "body"),
        (Column("force rms, N", Kind.NUMBER, 3), "force_rms"),
        (Column("moment rms, N m", Kind.NUMBER, 3), "moment_rms"),
        (Column("about the origin of the"), "axes"),
    )
    title = f"{log.run.name} ({_purpose(log)}, {motion.payload_words(log.run)})"
    return Section(title, listed, wrenches if log.wrenches else None, folded=False)


def _shared(units: Mapping[str, str]) -> str:
    """Return the unit for the title of a column, if the joints share one."""
    return f", {next(iter(units.values()))}" if len(set(units.values())) == 1 else ""


def _unit_column(units: Mapping[str, str]) -> list[ColumnOf]:
    """Return the column of units, if they differ."""
    return [] if _shared(units) else [(Column("unit"), lambda joint: units[joint.joint])]


def motion_chart(log: LogCheck, robot: Robot) -> Chart:
    """Draw the positions of the joints in a log, and the distances to singular poses."""
    start, joints = float(log.run.time[0]), [joint.joint for joint in log.joints]
    panels = motion.joint_panels(robot, joints, log.distances["time"] - start, log.position, "position", 2.1)
    distances = motion.distances_panels([(log.run.name, start, log.distances)])
    return Chart((*panels, *(replace(panel, title="") for panel in distances)), log.run.name, live=True)


def unique_names(names: Sequence[str]) -> list[str]:
    """Add a number to repeated names."""
    return [name if names.index(name) == k else f"{name}-{names[: k + 1].count(name)}" for k, name in enumerate(names)]
