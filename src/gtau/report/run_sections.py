"""Sections on runs: torques, residuals, logs, motion and singular poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gtau.estimation.results.singularity_distances import Distances, NearestPose
from gtau.report.evidence import Evidence, RunEvidence, body_path
from gtau.report.html.document import Section
from gtau.report.html.drawings import Panel, panel_figure
from gtau.report.html.elements import Cell, Column, escape, folded, number, paragraph, plain, table, text
from gtau.report.html.series import (
    Arrays,
    Line,
    buckets_for,
    chart,
    envelope,
    key,
    stretches,
    zoom_tools,
)
from gtau.report.residuals import autocorrelation, histogram, spectrum
from gtau.report.style import joint_label
from gtau.robots.robot import Robot
from gtau.signals.run import Run

OPEN_RUNS = 1  # of the runs used, and of the others: shown unfolded
SPECTRAL_POINTS = 220
KINDS = ("type 1 (serial)", "type 2 (parallel)")  # of singularities
COLOURS = 8  # of lines in the style sheet
GROUPS = (("runs used", True), ("validation", False))
SERIES_A_JOINT = 3  # measured, predicted, residual


def errors_table(runs: Sequence[RunEvidence]) -> str:
    """Tabulate torque errors of each joint on each run, away from reversals and over all samples."""
    rows = []
    whole = any(error.relative_all is not None for run in runs for error in run.errors)
    for run in runs:
        for error in run.errors:
            over_all = error.relative_all
            rows.append(
                [
                    text(run.run.name),
                    text("used" if run.used else "validation"),
                    text(error.joint),
                    number(error.rms, 3),
                    number(error.signal, 3),
                    text(error.unit),
                    Cell(f"{error.relative:.2f}", True, error.relative),
                    *([Cell("–" if over_all is None else f"{over_all:.2f}", True, over_all)] if whole else []),
                ]
            )
    columns = [
        Column("run"),
        Column(""),
        Column("joint"),
        Column("error rms", True),
        Column("torque rms", True),
        Column("unit"),
        Column("error, % away from reversals", True),
        *([Column("error, % over all samples", True)] if whole else []),
    ]
    return table(columns, rows)


def joint_errors_table(evidence: Evidence) -> str:
    """Tabulate the largest torque error of each joint on the runs used, and on those kept for validation."""
    groups = [(words, [run for run in evidence.runs if run.used == used]) for words, used in GROUPS]
    groups = [(words, [run for run in runs if run.errors]) for words, runs in groups]
    groups = [(words, runs) for words, runs in groups if runs]
    rows = []
    for joint in evidence.joints:
        cells = []
        for _, runs in groups:
            errors = [error for run in runs for error in run.errors if error.joint == joint]
            whole = [error.relative_all for error in errors if error.relative_all is not None]
            cells += [_largest([error.relative for error in errors]), _largest(whole)]
        rows.append([text(joint_label(joint), "unit"), *cells])
    columns = [Column("largest torque error, %")]
    for words, _ in groups:
        columns += [Column(f"{words}: away from reversals", True), Column(f"{words}: over all samples", True)]
    return table(columns, rows)


def _largest(values: Sequence[float]) -> Cell:
    return Cell(f"{max(values):.2f}", True, max(values)) if values else Cell("–", True)


def torques_section(evidence: Evidence, arrays: Arrays) -> Section | None:
    """Show measured and predicted torques of every joint along every run, used and not used."""
    if not evidence.runs:
        return None
    series = sum(SERIES_A_JOINT * len(evidence.joints) for run in evidence.runs if run.prediction is not None)
    buckets = buckets_for(series)
    shown, opened = [], {True: 0, False: 0}
    for k, run in enumerate(evidence.runs):
        label = f"{run.run.name} ({'used' if run.used else 'validation, not used'}; {run.payload})"
        if run.prediction is None:
            shown.append(folded(label, paragraph(f"Not predicted: {run.refusal}")))
            continue
        opened[run.used] += 1
        content = _torque_charts(evidence, run, f"torques-{k}", buckets, arrays)
        shown.append(folded(label, content, shown=opened[run.used] <= OPEN_RUNS))
    of_current = evidence.result.kind == "current"
    measured = "measured (current × gain)" if of_current else "measured"
    legend = key(
        [
            (measured, "measured"),
            ("predicted", "predicted"),
            ("residual", "residual"),
            ("masked: near a reversal, a gap or a repaired sample", "shade"),
        ]
    )
    words = (
        "A small residual does not prove the gains, as both sides carry them. In the shaded stretches the friction "
        "model does not hold or samples are missing; identification leaves them out."
    )
    every = folded("Torque errors of every run", errors_table(evidence.runs))
    return Section(
        "torques",
        "Torques",
        paragraph(words) + joint_errors_table(evidence) + every + legend + "\n".join(shown),
    )


def _torque_charts(evidence: Evidence, run: RunEvidence, group: str, buckets: int, arrays: Arrays) -> str:
    prediction = run.prediction
    assert prediction is not None
    n = len(prediction.joints)
    rest = prediction.measured - prediction.predicted
    columns = np.column_stack([prediction.measured, prediction.predicted, rest])
    time, thin = envelope(run.time, columns, buckets)
    shortest = float(run.time[-1] - run.time[0]) / 1000
    parts = [zoom_tools(group)]
    if run.cut:
        parts.append(paragraph(f"Only the first {run.time[-1]:.4g} s of this long run are shown.", "soft"))
    errors = {error.joint: error for error in run.errors}
    for j, joint in enumerate(prediction.joints):
        error = errors.get(joint)
        words = joint_label(joint)
        if error is not None:
            whole = error.relative_all
            words += f": residual {error.relative:.2f} %" + (
                "" if whole is None else f" away from reversals, {whole:.2f} % over all samples"
            )
        masked = stretches(run.time, ~prediction.keep[:, j], shortest)
        unit = evidence.units[evidence.joints.index(joint)]
        parts.append(f"<h4>{escape(words)}</h4>")
        parts.append(
            chart(
                arrays,
                time,
                [
                    Line("measured", thin[:, j], "measured", 2.6),
                    Line("predicted", thin[:, n + j], "predicted", 1.2),
                ],
                unit,
                group,
                masked=masked,
                last=False,
            )
        )
        parts.append(
            chart(
                arrays,
                time,
                [Line("residual", thin[:, 2 * n + j], "residual")],
                unit,
                group,
                height=125,
                masked=masked,
                last=True,
            )
        )
    return "\n".join(parts)


def residuals_section(evidence: Evidence) -> Section | None:
    """Show histogram, spectrum and autocorrelation of the residuals of each joint, over all runs used."""
    if not any(run.used and run.prediction is not None for run in evidence.runs):
        return None
    parts = [
        paragraph(
            "Over all runs used, masked samples left out. White residuals have a flat spectrum and an autocorrelation "
            "within the band; where they do not, the standard deviations account for it by the block jackknife."
        )
    ]
    for j, joint in enumerate(evidence.joints):
        series, unit = evidence.residuals(j), evidence.units[j]
        panels = [
            panel
            for panel in (_histogram(series, unit), _spectrum(series, unit), _autocorrelation(series))
            if panel is not None
        ]
        if panels:
            parts.append(f'<h3>{escape(joint_label(joint))}</h3><div class="panels">{"".join(panels)}</div>')
    return Section("residuals", "Residuals", "\n".join(parts))


def _histogram(series: list[tuple[np.ndarray, np.ndarray]], unit: str) -> str | None:
    found = histogram(series)
    if found is None:
        return None
    x = np.linspace(found.edges[0], found.edges[-1], 90)
    curve = found.normal(x)
    top = 1.08 * float(max(found.density.max(), curve.max()))
    panel = Panel((found.edges[0], found.edges[-1]), (0.0, top), f"residual, {unit}", "density")
    panel.bars(found.edges, found.density)
    panel.line(x, curve, "residual")
    title = f"Histogram and normal density; std {plain(found.std, 3)} {unit}"
    return panel_figure(title, panel.svg(title))


def _spectrum(series: list[tuple[np.ndarray, np.ndarray]], unit: str) -> str | None:
    found = spectrum(series)
    if found is None or not (found.density > 0).any():
        return None
    amplitude = np.sqrt(found.density)
    low, high = _decades(amplitude[amplitude > 0])
    panel = Panel((0.0, float(found.frequency[-1])), (low, high), "frequency, Hz", f"{unit}/√Hz", log_y=True)
    panel.line(found.frequency, np.maximum(amplitude, low))
    return panel_figure("Amplitude spectral density", panel.svg("Amplitude spectral density of the residuals"))


def _autocorrelation(series: list[tuple[np.ndarray, np.ndarray]]) -> str | None:
    found = autocorrelation(series)
    if found is None:
        return None
    low = min(-0.25, float(found.value.min()) - 0.05)
    panel = Panel((0.0, float(found.lag[-1])), (low, 1.0), "lag, s", "autocorrelation")
    panel.band(-found.band, found.band)
    panel.rule(y=0.0)
    panel.line(found.lag, found.value)
    return panel_figure("Autocorrelation; band: white noise, 95 %", panel.svg("Autocorrelation of the residuals"))


def _decades(values: np.ndarray) -> tuple[float, float]:
    """Choose a range of whole decades around positive values, at most six of them."""
    high = 10.0 ** np.ceil(np.log10(values.max()))
    low = 10.0 ** np.floor(np.log10(values.min()))
    return float(max(low, high * 1e-6)), float(high)


def logs_section(runs: Sequence[Run], robot: Robot, bandwidth: float, cutoff: float | None) -> Section | None:
    """Show clock, repairs and spectra of the logs."""
    if not runs:
        return None
    rows = [
        [
            text(run.name),
            number(float(len(run.time)), 8),
            number(run.rate, 5),
            number(float(run.time[-1] - run.time[0]), 4),
            Cell(f"{100 * float(1 - np.mean(run.valid)):.2g}", True),
            text("; ".join(clock_notes(run)) or "uniform clock, no repairs"),
        ]
        for run in runs
    ]
    columns = [
        Column("log"),
        Column("samples", True),
        Column("rate, Hz", True),
        Column("duration, s", True),
        Column("repaired, %", True),
        Column("clock and repairs"),
    ]
    parts = [table(columns, rows), f"<h3>Spectra of {escape(runs[0].name)}</h3>"]
    command = "current, A/√Hz" if runs[0].kind == "current" else "torque"
    edges = [("bandwidth", bandwidth), *([("filter", cutoff)] if cutoff else [])]
    panels = []
    for j, joint in enumerate(runs[0].joints):
        unit = "rad" if robot.joint(joint).kind == "revolute" else "m"
        panels.append(_log_spectrum(runs[0], j, f"{joint_label(joint)}: speed", f"{unit}/s/√Hz", edges, speed=True))
        panels.append(_log_spectrum(runs[0], j, f"{joint_label(joint)}: {command.split(',')[0]}", command, edges))
    words = (
        "Amplitude spectral densities of the speeds, differentiated from the logged positions, and of the commands. "
        "Rules mark the bandwidth of the motion and the cut-off frequency of the position filter."
    )
    parts.append(paragraph(words, "soft"))
    parts.append(f'<div class="panels">{"".join(panel for panel in panels if panel)}</div>')
    return Section("logs", "Clock and spectra of the logs", "\n".join(parts))


def clock_notes(run: Run) -> list[str]:
    """List the repairs of a run as it was read."""
    return list(run.notes)


def _log_spectrum(
    run: Run, j: int, title: str, unit: str, edges: Sequence[tuple[str, float]], speed: bool = False
) -> str | None:
    from scipy.signal import welch

    values = np.asarray(run.position[:, j] if speed else run.command[:, j], dtype=float)
    if speed:
        values = np.gradient(values, 1 / run.rate)
    if len(values) < 64 or not np.ptp(values):
        return None
    frequency, density = welch(values, run.rate, nperseg=min(2048, len(values) // 4))
    amplitude = np.sqrt(density[1:])
    frequency = frequency[1:]
    at = np.unique(np.geomspace(1, len(frequency), SPECTRAL_POINTS).astype(int) - 1)
    amplitude, frequency = amplitude[at], frequency[at]
    if not (amplitude > 0).any():
        return None
    low, high = _decades(amplitude[amplitude > 0])
    panel = Panel(
        (float(frequency[0]), float(frequency[-1])), (low, high), "frequency, Hz", unit, log_x=True, log_y=True
    )
    panel.line(frequency, np.maximum(amplitude, low))
    for row, (name, value) in enumerate(edges):
        if frequency[0] < value < frequency[-1]:
            panel.rule(x=value, label=f"{name} {value:.3g} Hz", row=row)
    return panel_figure(title, panel.svg(title))


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
