"""Show logs before an identification and in its report: motion, distances to singular poses, clock and preparation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from gtau.estimation.check_logs import WEIGHING, CheckedExperiment, LogCheck
from gtau.estimation.diagnostics.geometry import to_document as geometry_document
from gtau.estimation.results.result import IdentifiedModel
from gtau.findings import Finding, Grade, by_severity, counted, moment, note_document
from gtau.report.chart import TIME, Axis, Chart, Panel, Rule, Series, colour
from gtau.report.html import Inputs
from gtau.report.page import Column, ColumnOf, Facts, Kind, Page, Section, Table, Text, joint_label, table_of
from gtau.report.robot import distances_panels, geometry_section, singularities_section
from gtau.report.torques import payload_words
from gtau.robots.parameter import command_unit
from gtau.robots.robot import Robot
from gtau.signals.preparation.filters import Preparation
from gtau.signals.reading.experiment import Experiment, read_experiment
from gtau.signals.reading.logs import logged_instants
from gtau.signals.run import Run
from gtau.signals.storage import block, spans

SHARES = {"accuracy": "accuracy, relative", "reduction_loss": "reduction loss, %"}  # names of statistics
APART = 4  # most findings of one kind on different logs that are listed one by one
LOWEST = 1e-9  # of the peak of a spectrum; lower values are rounding errors
FREQUENCY = Axis("frequency, Hz", log=True)


def findings_section(notes: Sequence[Finding]) -> Section:
    """List findings, the worst first."""
    nothing = Text("Nothing in the logs was repaired or left out.")
    return Section("Findings", findings_table(notes) if notes else nothing, id="notes")


def findings_table(notes: Sequence[Finding]) -> Table:
    """Tabulate findings, the worst first."""
    rows = [
        (grade.value, note.source, _where(note), note.what, note.advice)
        for grade, members in by_severity(same_in_several(notes)).items()
        for note in members
    ]
    columns = (
        Column("grade", Kind.BADGE),
        Column("log or robot"),
        Column("where", wide=True),
        Column("what was found", Kind.SENTENCE),
        Column("what to do", Kind.SENTENCE),
    )
    return Table(columns, rows, listed=True)


def _where(note: Finding) -> str:
    share = None if note.share is None else f"{100 * note.share:.2g} % of the samples"
    time = None if note.time is None else moment(note.time, 4)
    return ", ".join(part for part in (note.joint and joint_label(note.joint), time, share) if part)


def same_in_several(notes: Sequence[Finding]) -> list[Finding]:
    """Merge equal findings on several logs, and findings of one kind on many logs into the worst, without time."""
    alike: dict[tuple[str, str], list[Finding]] = {}
    for note in notes:
        alike.setdefault((note.what, note.advice), []).append(note)
    groups: dict[tuple[str, ...], list[Finding]] = {}
    for same in alike.values():
        sources = ", ".join(dict.fromkeys(note.source for note in same if note.source))
        note = replace(same[0], source=sources, time=None) if len(same) > 1 else same[0]
        groups.setdefault((note.kind, note.joint, note.advice), []).append(note)
    merged = []
    for group in groups.values():
        on_logs = [note for note in group if note.source]
        if len(on_logs) > APART:
            worst = max(on_logs, key=lambda note: note.share or 0.0)
            merged.append(replace(worst, source=f"{worst.source} and {len(on_logs) - 1} more", time=None))
            group = [note for note in group if not note.source]
        merged += group
    return merged


def joint_panels(
    robot: Robot, joints: Sequence[str], time: np.ndarray, values: np.ndarray, what: str, height: float, per: str = ""
) -> list[Panel]:
    """Draw a quantity (K, n) of joints over time, in one panel for rotations and one for translations."""
    lines: dict[str, list[Series]] = {"rad": [], "m": []}
    for j, joint in enumerate(joints):
        lines[robot.joint(joint).unit].append(Series(joint_label(joint), time, values[:, j], colour(j)))
    drawn = [(Axis(f"{what}, {unit}{per}"), tuple(series)) for unit, series in lines.items() if series]
    return [Panel(TIME, axis, series, height=height) for axis, series in drawn]


def seconds(run: Run) -> float:
    """Return the duration of a run, s."""
    return float(run.time[-1] - run.time[0])


def logs_section(runs: Sequence[Run]) -> Section | None:
    """Show clock and repairs of logs."""
    if not runs:
        return None
    listed = table_of(
        runs,
        (Column("log"), "name"),
        (Column("samples", Kind.NUMBER, 8), lambda run: len(run.time)),
        (Column("rate, Hz", Kind.NUMBER, 5), "rate"),
        (Column("duration, s", Kind.NUMBER), seconds),
        (Column("repaired, %", Kind.SHARE, 2), lambda run: 1 - valid_share(run)),
        (Column("clock and repairs"), lambda run: "; ".join(map(str, run.notes)) or "uniform clock, no repairs"),
    )
    return Section("Clock and repairs of the logs", listed, id="logs")


def valid_share(run: Run) -> float:
    """Compute the share of samples, over all joints, that were not repaired."""
    return float(np.sum([np.sum(block(run.valid, *span)) for span in spans(len(run.valid))])) / run.valid.size


def preparation_words(preparation: Preparation, digits: int = 3) -> tuple[str, str, str]:
    """Describe bandwidth of the motion, position filter and decimation."""
    decimator, cutoff = preparation.decimator, preparation.cutoff
    return f"{preparation.bandwidth:.{digits}g} Hz", _low_pass(cutoff, digits), f"{decimator.factor} ({decimator.kind})"


def _low_pass(cutoff: float | None, digits: int = 4) -> str:
    return "none" if cutoff is None else f"{cutoff:.{digits}g} Hz"


def settings_of(result: IdentifiedModel) -> dict[str, str]:
    """List the settings of an identification by name."""
    preparation = result.preparation
    bandwidth, low_pass, decimation = preparation_words(preparation, 4)
    return {
        "estimator": result.method,
        "bandwidth of the motion": bandwidth,
        "position filter": low_pass,
        "position filter of predictions": ", ".join(map(_low_pass, preparation.prediction_cutoffs)) or low_pass,
        "decimation": decimation,
        "rows masked below": f"{100 * preparation.speed_fraction:g} % of the rms speed",
        **{SHARES.get(name, name.replace("_", " ")): f"{value:.4g}" for name, value in result.statistics.items()},
    }


def inputs_of(path: Path, experiment: Experiment | None = None, runs: bool = True) -> Inputs:
    """List an experiment file, its robot file and its logs; without ``runs`` only the validation logs."""
    experiment = experiment or read_experiment(path)
    source = experiment.robot
    robot = Path(source if isinstance(source, str) else source.file)
    listed: Sequence = (*(experiment.runs if runs else ()), *experiment.validation)
    logs = tuple(("log", log) for run in listed for log in run.log)
    return (("experiment", path), *((("robot", robot),) if robot.exists() else ()), *logs)


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
        "duration": seconds(run),
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
    prepared = [Section(log.run.name, preparation_chart(log), folded=True) for log in checked.logs]
    logs = table_of(
        checked.logs,
        (Column("log"), "run.name"),
        (Column("used for"), _purpose),
        (Column("payload"), lambda log: payload_words(log.run).removeprefix("payload ")),
        (Column("samples", Kind.NUMBER, 8), lambda log: len(log.run.time)),
        (Column("rate, Hz", Kind.NUMBER, 5), "run.rate"),
        (Column("duration, s", Kind.NUMBER), lambda log: seconds(log.run)),
        (Column("rows a joint", Kind.NUMBER), "rows"),
        (Column("repaired, %", Kind.SHARE, 2, wide=True), lambda log: 1 - valid_share(log.run)),
    )
    settings = None
    if preparation is not None:
        bandwidth, cutoff, decimation = preparation_words(preparation)
        settings = Facts({"bandwidth": bandwidth, "position filter": cutoff, "decimation": decimation})
    return Page(
        f"Logs of {robot.name}",
        _verdict(checked),
        findings_section(checked.notes),
        Section("Logs", logs, settings, id="logs") if checked.logs else None,
        Section("Joints", *(_joints(log, robot) for log in checked.logs), id="joints"),
        Section("Robot and singular poses", robot, singularities_section(nearest), id="robot"),
        geometry_section(checked.geometry),
        Section("Motion", *motions, id="motion"),
        Section("Preparation", *prepared, id="preparation"),
    )


def _verdict(checked: CheckedExperiment) -> Section:
    used = [log for log in checked.logs if not log.validation]
    style: Any = {Grade.ERROR: "bad", Grade.WARNING: "weak", Grade.INFORMATION: "good"}[checked.worst]
    time = sum(seconds(log.run) for log in used)
    runs = f"{counted(len(used), 'run')} of {time:.4g} s in all for the identification"
    return Section("Verdict", Text(expectation(checked.notes), (runs,) * bool(used), style), id="verdict")


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
    title = f"{log.run.name} ({_purpose(log)}, {payload_words(log.run)})"
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
    panels = joint_panels(robot, joints, log.distances["time"] - start, log.position, "position", 2.1)
    distances = distances_panels([(log.run.name, start, log.distances)])
    return Chart((*panels, *(replace(panel, title="") for panel in distances)), log.run.name, live=True)


def unique_names(names: Sequence[str]) -> list[str]:
    """Add a number to repeated names."""
    return [name if names.index(name) == k else f"{name}-{names[: k + 1].count(name)}" for k, name in enumerate(names)]


def preparation_chart(log: LogCheck) -> Chart:
    """Draw the spectra of the joints in a log, the steps of its clock, and the rows used."""
    preparation = log.preparation
    marks = {
        "bandwidth": preparation.bandwidth,
        "position filter": preparation.cutoff,
        "Nyquist of the rows": log.run.rate / preparation.decimator.factor / 2,
    }
    rules = tuple(Rule(x=mark, label=f"{name} {mark:.3g} Hz") for name, mark in marks.items() if mark is not None)
    titles = {"speed": "Power of the velocities", "acceleration": "Power of the accelerations; dots: noise dominates"}
    share = Axis("share of the peak", log=True)
    drawn = {kind: tuple(_shares(log, kind)) for kind in titles}
    panels = [Panel(FREQUENCY, share, drawn[kind], title, rules, height=2.3) for kind, title in titles.items()]
    return Chart((*panels, *([_steps(log.run)] if log.run.log.paths else []), _used(log)), log.run.name)


def _shares(log: LogCheck, kind: str) -> Iterator[Series]:
    """Draw the power spectrum of each joint, with a dot where noise starts to dominate the acceleration."""
    for j, joint in enumerate(log.joints):
        spectrum = joint.spectrum
        density, frequency = getattr(spectrum, kind), spectrum.frequency
        shown = density > LOWEST * density.max()
        if not shown.any():
            continue
        share = density / density.max()
        yield Series(joint_label(joint.joint), frequency[shown], share[shown], colour(j))
        if spectrum.moves and kind == "acceleration":
            k = int(np.argmin(np.abs(frequency - spectrum.end)))
            yield Series("", frequency[k : k + 1], share[k : k + 1], colour(j), "points", width=3.0)


def _steps(run: Run) -> Panel:
    """Draw the steps of the time column over time, in sampling periods."""
    log = run.log
    assert log.signals is not None and log.units is not None  # noqa: PT018 (it has files)
    stamps = logged_instants(log.paths[0], log.signals, log.units.scale(log.signals)[2])
    begin, end, period = float(run.time[0]), float(run.time[-1]), 1 / run.rate
    stamps = stamps[(stamps >= begin - period) & (stamps <= end + period)]  # drops NaN, too
    time, steps = stamps[1:], np.diff(stamps) / period
    top = max(2.0, 1.1 * float(steps.max(initial=0.0)))
    series = Series("", time - begin, steps, "soft", width=0.6)
    return Panel(TIME, Axis("step, samples", limits=(0.0, top)), (series,), "Steps of the time column", height=1.2)


def _used(log: LogCheck) -> Panel:
    """Draw the decimated rows used of each joint as bars, with gaps at reversals, rests and masked samples."""
    time, series = log.distances["time"] - float(log.run.time[0]), []
    for j in range(len(log.run.joints)):
        edges = np.flatnonzero(np.diff(np.r_[False, log.used[:, j], False]))
        ends = np.column_stack([time[edges[::2]], time[np.minimum(edges[1::2], len(time) - 1)]])
        series.append(Series("", ends, np.array([float(j)]), colour(j), "spans"))
    count = len(log.run.joints)
    names = {float(j): joint_label(joint) for j, joint in enumerate(log.run.joints)}
    return Panel(
        Axis(TIME.label, limits=(0.0, seconds(log.run))),
        Axis("", limits=(count - 0.5, -0.5), names=names),
        tuple(series),
        "Rows used, without reversals, rests, gaps and clipped commands",
        height=0.6 + 0.16 * count,
    )
