"""The section on the motion: the robot, the path of its payload, and distances to singular poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gtau.estimation.results.singularity_distances import Distances, NearestPose
from gtau.report.evidence import Evidence, body_path
from gtau.report.html.document import Section
from gtau.report.html.drawings import Panel, panel_figure
from gtau.report.html.elements import Column, escape, folded, number, paragraph, table, text
from gtau.report.html.series import COLOURS, Arrays, Line, buckets_for, chart, envelope, key

KINDS = ("type 1 (serial)", "type 2 (parallel)")  # of singularities


def motion_section(evidence: Evidence, arrays: Arrays) -> Section:
    """Show the robot, the path of the body that carries the payload, and distances to singular poses."""
    from gtau.report.robot_drawing import robot_drawing

    result = evidence.result
    parts = [f'<figure class="panel robot">{robot_drawing(result.robot)}</figure>']
    used = any(run.used for run in evidence.runs)
    shown = [run for run in evidence.runs if run.used == used][:COLOURS]
    paths = [(run.run.name, body_path(result, run.run)[1]) for run in shown]
    if paths:
        parts.append(f"<h3>Path of the frame of ‘{escape(result.robot.tool)}’, the body that carries the payload</h3>")
        parts.append(path_panels(paths))
    starts = {run.run.name: float(run.run.time[0]) for run in evidence.runs}
    if used:
        parts.append(distances_part(result.singularities, result.distances, starts, arrays))
    return Section("robot", "Robot and motion", "\n".join(part for part in parts if part))


def path_panels(paths: Sequence[tuple[str, np.ndarray]]) -> str:
    """Draw paths (P, 3), m, of runs by name, in three projections of equal scale."""
    points = np.concatenate([path for _, path in paths])
    centre, half = (points.max(axis=0) + points.min(axis=0)) / 2, 0.55 * float(np.ptp(points, axis=0).max()) or 0.5
    panels = []
    for a, b in ((0, 1), (0, 2), (1, 2)):
        panel = Panel(
            (centre[a] - half, centre[a] + half),
            (centre[b] - half, centre[b] + half),
            f"{'xyz'[a]}, m",
            f"{'xyz'[b]}, m",
            (300.0, 300.0 - 8.0 - 44.0 + 40.0),
        )
        for k, (_, path) in enumerate(paths):
            panel.line(path[:, a], path[:, b], f"c{k % COLOURS}", width=1.0)
        panels.append(panel_figure(f"{'xyz'[a]}–{'xyz'[b]} plane of the base", panel.svg("Path")))
    legend = key([(name, f"c{k % COLOURS}") for k, (name, _) in enumerate(paths)])
    return legend + f'<div class="panels">{"".join(panels)}</div>'


def distances_part(
    nearest: Sequence[NearestPose], distances: Sequence[Distances], starts: Mapping[str, float], arrays: Arrays
) -> str:
    """Show where runs come nearest to singular poses, and the distances along them; ``starts`` (s) by name."""
    if not nearest:
        return ""
    rows = [
        [
            text(each.run),
            text(KINDS[each.type - 1]),
            number(each.distance, 3),
            number(each.time, 4),
            text(", ".join(f"{joint} {value:.3g}" for joint, value in each.pose.items())),
        ]
        for each in nearest
    ]
    columns = [
        Column("run"),
        Column("singularity"),
        Column("nearest distance", True),
        Column("at, s", True),
        Column("pose, rad or m"),
    ]
    parts = [
        "<h3>Distance to singular poses</h3>",
        paragraph("Reciprocal condition numbers: 1 at best, 0 at a singular pose.", "soft"),
        table(columns, rows),
    ]
    buckets = buckets_for(2 * max(len(distances), 1) * 4)
    parts.append(key([(name, f"c{t}") for t, name in enumerate(KINDS) if any(each.type == t + 1 for each in nearest)]))
    for k, each in enumerate(distances):
        time, thin = envelope(each.time - starts.get(each.run, 0.0), each.values, buckets)
        lines = [Line(name, thin[:, t], f"c{t}", 1.4) for t, name in enumerate(KINDS) if np.isfinite(thin[:, t]).any()]
        if lines:
            drawn = chart(arrays, time, lines, "distance", f"distance-{k}", height=130, from_zero=True)
            parts.append(folded(each.run, drawn, shown=k == 0))
    return "\n".join(parts)
