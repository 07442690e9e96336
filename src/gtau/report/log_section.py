"""The section on the logs: clock, repairs and spectra."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gtau.report.html.document import Section
from gtau.report.html.drawings import Panel, decades, panel_figure
from gtau.report.html.elements import Cell, Column, escape, number, paragraph, table, text
from gtau.report.style import joint_label
from gtau.robots.robot import Robot
from gtau.signals.run import Run

SPECTRAL_POINTS = 220


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
    return list(map(str, run.notes))


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
    low, high = decades(amplitude[amplitude > 0])
    panel = Panel(
        (float(frequency[0]), float(frequency[-1])), (low, high), "frequency, Hz", unit, log_x=True, log_y=True
    )
    panel.line(frequency, np.maximum(amplitude, low))
    for row, (name, value) in enumerate(edges):
        if frequency[0] < value < frequency[-1]:
            panel.rule(x=value, label=f"{name} {value:.3g} Hz", row=row)
    return panel_figure(title, panel.svg(title))
