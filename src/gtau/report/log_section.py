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
from gtau.signals.storage import block, sizes, spans

SPECTRAL_POINTS = 220
SEGMENT = 2048  # samples of a segment of Welch's method, at most
FEWEST = 64  # samples of a signal that has a spectrum


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
            Cell(f"{100 * (1 - _valid_share(run)):.2g}", True),
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


def _valid_share(run: Run) -> float:
    return float(np.sum([np.sum(block(run.valid, *span)) for span in spans(len(run.valid))])) / run.valid.size


def _density(run: Run, j: int, speed: bool) -> tuple[np.ndarray, np.ndarray] | None:
    """Compute frequencies, Hz, and the power spectral density of a joint by Welch's method, block by block.

    None where the signal is constant, or too short.
    """
    from scipy.signal import welch

    whole, samples = run.position if speed else run.command, len(run.time)
    if samples < FEWEST:
        return None
    size = min(SEGMENT, samples // 4)
    step, segments = size - size // 2, 1 + (samples - size) // (size - size // 2)
    total, low, high, frequency = np.zeros(size // 2 + 1), np.inf, -np.inf, np.zeros(0)
    for first, last in spans(segments, max(sizes().block // step, 1)):
        begin, end = first * step, (last - 1) * step + size
        around = slice(max(begin - 1, 0), min(end + 1, samples))  # for the differences at the ends of the block
        values = np.asarray(block(whole, around.start, around.stop)[:, j], dtype=float)
        if speed:
            values = np.gradient(values, 1 / run.rate)
        values = values[begin - around.start : end - around.start]
        low, high = min(low, float(values.min())), max(high, float(values.max()))
        frequency, density = welch(values, run.rate, nperseg=size)
        total += (last - first) / segments * density
    return (frequency, total) if high > low else None


def _log_spectrum(
    run: Run, j: int, title: str, unit: str, edges: Sequence[tuple[str, float]], speed: bool = False
) -> str | None:
    found = _density(run, j, speed)
    if found is None:
        return None
    frequency, density = (each[1:] for each in found)
    amplitude = np.sqrt(density)
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
