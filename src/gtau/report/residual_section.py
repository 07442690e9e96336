"""The section on residuals: histogram, spectrum and autocorrelation."""

from __future__ import annotations

import numpy as np

from gtau.report.evidence import Evidence
from gtau.report.html.document import Section
from gtau.report.html.drawings import Panel, decades, panel_figure
from gtau.report.html.elements import escape, paragraph, plain
from gtau.report.residuals import autocorrelation, histogram, spectrum
from gtau.report.style import joint_label

SPECTRAL_POINTS = 220


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
    low, high = decades(amplitude[amplitude > 0])
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
