"""The logs of an experiment before an identification: as data, as text and as figures."""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gtau.estimation.check_logs import ExperimentCheck, LogCheck
from gtau.estimation.diagnostics.geometry_findings import from_document as read_geometry
from gtau.estimation.diagnostics.geometry_findings import to_document as geometry_document
from gtau.estimation.grades import Grade, by_grade, from_document, to_document
from gtau.estimation.results.geometry_text import geometry_lines
from gtau.estimation.results.singularity_distances import write_distances
from gtau.estimation.results.summary import findings_lines, same_in_several
from gtau.estimation.thresholds.logs import NEAR_SINGULAR
from gtau.report.style import BLACK, LINES, has_matplotlib, joint_label, light_grid, new_figure, save_figure, styled
from gtau.robots.robot import Robot
from gtau.robots.units import command_unit
from gtau.signals.notes import Note
from gtau.signals.samples import counted
from gtau.signals.storage import block, spans

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH = 80
TYPES = {1: "type 1 (serial)", 2: "type 2 (parallel)"}


def describe_logs(checked: ExperimentCheck) -> dict[str, Any]:
    """Describe the check as a JSON document, SI units."""
    preparation = checked.preparation
    return {
        "robot": checked.robot.name,
        "worst": checked.worst.value if checked.notes else None,
        "findings": [to_document(note) for members in by_grade(checked.notes).values() for note in members],
        "preparation": preparation
        and {
            "bandwidth": preparation.bandwidth,
            "cutoff": preparation.cutoff,
            "decimation": preparation.decimator.factor,
            "decimator": preparation.decimator.kind,
        },
        "logs": [_describe(log, checked.robot) for log in checked.logs],
        "geometry": checked.geometry and geometry_document(checked.geometry),
    }


def _describe(log: LogCheck, robot: Robot) -> dict[str, Any]:
    run = log.run
    return {
        "log": run.name,
        "validation": log.validation,
        "payload": None if run.payload is None else {"name": run.payload.name, "mass": run.payload.mass},
        "samples": len(run.time),
        "rate": run.rate,
        "duration": float(run.time[-1] - run.time[0]),
        "rows": log.rows,
        "joints": [
            {
                "joint": each.joint,
                "moves": bool(np.isfinite(each.bandwidth)),
                "unit": _unit(robot, each.joint),
                "position": list(each.position),
                "speed": {"rms": each.speed_rms, "max": each.speed_max},
                "bandwidth": each.bandwidth if np.isfinite(each.bandwidth) else None,
                "command_unit": command_unit(robot, each.joint, run.kind),
                "command": {"rms": each.command_rms, "max": each.command_max},
                "usable": each.usable,
            }
            for each in log.joints
        ],
        "wrenches": [asdict(each) for each in log.wrenches],
        "singularities": [
            {"type": each.type, "distance": each.distance, "time": each.time, "pose": dict(each.pose)}
            for each in log.nearest
        ],
    }


def _unit(robot: Robot, joint: str) -> str:
    return "rad" if robot.joint(joint).kind == "revolute" else "m"


def log_page(document: dict[str, Any]) -> str:
    """Print the document."""
    lines = []
    if preparation := document["preparation"]:
        low_pass = "none" if preparation["cutoff"] is None else f"{preparation['cutoff']:.3g} Hz"
        lines += textwrap.wrap(
            f"{document['robot']}: bandwidth {preparation['bandwidth']:.3g} Hz, position filter {low_pass}, decimation "
            f"{preparation['decimation']} ({preparation['decimator']})",
            WIDTH,
        )
    for log in document["logs"]:
        lines += ["", *_log_lines(log)]
    if document["geometry"]:
        lines += ["", *geometry_lines(read_geometry(document["geometry"]))]
    notes = [from_document(each) for each in document["findings"]]
    if notes:
        lines += ["", *findings_lines(notes)]
    lines += ["", *textwrap.wrap(gate_words(notes), WIDTH)]
    return "\n".join(line.rstrip() for line in lines).lstrip("\n")


def gate_words(notes: Sequence[Note]) -> str:
    """Say in one sentence what to expect of an identification from these logs."""
    found = by_grade(same_in_several(notes))
    if stops := found.get(Grade.STOPS):
        return f"gtau identify will refuse these logs: {counted(len(stops), 'finding')} to resolve first."
    if mend := found.get(Grade.MEND):
        return f"gtau identify can read these logs; {counted(len(mend), 'finding')} worth mending before."
    return "gtau identify can use these logs as they are."


def _log_lines(log: dict[str, Any]) -> list[str]:
    payload = log["payload"]
    load = "no payload" if payload is None else f"payload '{payload['name']}'"
    if payload is not None:
        load += " of unknown mass" if payload["mass"] is None else f" of {payload['mass']:g} kg"
    lines = textwrap.wrap(
        f"{log['log']} ({'validation' if log['validation'] else 'identification'}, {load}): {log['samples']} samples "
        f"at {log['rate']:.5g} Hz, {log['duration']:.4g} s; {log['rows']} rows a joint",
        WIDTH,
    )
    lines.append(f"  {'joint':<22}{'position from':>14}{'to':>10}{'':5}{'speed rms':>10}{'max':>10}")
    for each in log["joints"]:
        low, high = each["position"]
        lines.append(
            f"  {each['joint']:<22}{low:>14.3g}{high:>10.3g} {each['unit']:<4}{each['speed']['rms']:>10.3g}"
            f"{each['speed']['max']:>10.3g} {each['unit']}/s"
        )
    command = {"A": "current", "N": "force"}.get(log["joints"][-1]["command_unit"], "torque")
    lines.append(f"  {'joint':<22}{f'{command} rms':>14}{'max':>10}{'':5}{'bandwidth':>10}{'rows used':>15}")
    for each in log["joints"]:
        bandwidth = "at rest   " if each["bandwidth"] is None else f"{each['bandwidth']:.3g} Hz"
        lines.append(
            f"  {each['joint']:<22}{each['command']['rms']:>14.3g}{each['command']['max']:>10.3g} "
            f"{each['command_unit']:<4}{bandwidth:>10}{100 * each['usable']:>13.0f} %"
        )
    for each in log["wrenches"]:
        line = (
            f"wrench on '{each['body']}': force {each['force_rms']:.3g} N, moment {each['moment_rms']:.3g} N m (rms) "
            f"about the origin of the {each['axes']}"
        )
        lines += textwrap.wrap(line, WIDTH, initial_indent="  ", subsequent_indent="    ")
    for each in log["singularities"]:
        line = f"nearest to a singularity of {TYPES[each['type']]}: {each['distance']:.2g} at {each['time']:.4g} s"
        if each["type"] == 2:  # those of type 1 do not matter to an identification
            line += "".join(f", q_{joint} = {value:.4g}" for joint, value in each["pose"].items())
        lines += textwrap.wrap(line, WIDTH, initial_indent="  ", subsequent_indent="    ")
    return lines


def log_figure(log: LogCheck, robot: Robot) -> Figure:
    """Draw the motion of the joints in a log, and its distances to singularities of both types."""
    units = {
        unit: [j for j, each in enumerate(log.joints) if _unit(robot, each.joint) == unit] for unit in ("rad", "m")
    }
    units = {unit: joints for unit, joints in units.items() if joints}
    time = log.distances.time - float(log.run.time[0])
    with styled():
        figure = new_figure(7.2, 2.5 + 2.0 * len(units))
        *positions, below = figure.subplots(len(units) + 1, 1, sharex=True)
        for axes, (unit, joints) in zip(positions, units.items(), strict=True):
            for j in joints:
                style = LINES[j % len(LINES)]
                axes.plot(*outline(time, log.position[:, j]), label=joint_label(log.joints[j].joint), **style)
            axes.set_ylabel(f"position, {unit}")
            light_grid(axes)
        positions[0].set_title(log.run.name)
        for values, name, style in zip(log.distances.values.T, TYPES.values(), LINES[:2], strict=True):
            times, drawn = outline(time, values)
            if not np.isnan(drawn).all():
                below.plot(times, drawn, label=name, **style)
        if robot.closures:  # other robots have no singularities of type 2, at which alone it matters
            below.axhline(NEAR_SINGULAR, color=BLACK, linewidth=0.8, linestyle=":", label=f"{NEAR_SINGULAR:g}, near")
        below.set_ylim(0.0, 1.05)
        below.set_ylabel("distance to singularity")
        below.set_xlabel("time from the start of the run, s")
        below.set_xlim(0.0, float(log.run.time[-1] - log.run.time[0]))
        below.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1, ncols=3)
        light_grid(below)
        handles = [line for axes in positions for line in axes.get_lines()]
        figure.legend(handles=handles, loc="outside upper center", ncols=3)
    return figure


def outline(time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Thin a line (K,) for a figure: of a long one the extremes of each of 2000 stretches."""
    size = -(-len(values) // 2000)
    if size <= 2:
        return time, values
    times, drawn = [], []
    for span in spans(len(values), size):
        part = block(values, *span)
        both = np.sort([part.argmin(), part.argmax()])
        times.append(block(time, *span)[both])
        drawn.append(part[both])
    return np.concatenate(times), np.concatenate(drawn)


def write_check(checked: ExperimentCheck, folder: Path) -> list[Path]:
    """Write a figure for each log, and the distances of all to singularities as ``singularities.parquet``.

    Without matplotlib only the latter; see :func:`gtau.report.style.skipped_figures`.

    Raises
    ------
    GtauError
        Where a file cannot be written.
    """
    written, used = [], Counter[str]()
    for log in checked.logs if has_matplotlib() else ():
        name = log.run.name
        used[name] += 1
        written.append(folder / (f"{name}.png" if used[name] == 1 else f"{name}-{used[name]}.png"))
        save_figure(log_figure(log, checked.robot), written[-1])
    written.append(folder / "singularities.parquet")
    write_distances([log.distances for log in checked.logs], written[-1])
    return written
