"""Show torque residuals: histogram, spectrum and autocorrelation, without masked samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gtau.estimation.results.result import IdentifiedModel
from gtau.report.chart import Axis, Chart, Panel, Series, colour
from gtau.report.evidence import RunEvidence
from gtau.report.page import Section, Text, joint_label, section
from gtau.robots.parameter import torque_unit

SEGMENT = 256  # most samples in a segment of the spectrum
FEWEST = 16  # samples needed for a statistic
LAGS = 40

Residuals = Sequence[tuple[np.ndarray, np.ndarray]]
"""Times (K,) in s on a uniform grid and residuals (K,) of each run, NaN where masked."""


def residuals_section(result: IdentifiedModel, runs: Sequence[RunEvidence]) -> Section | None:
    """Show the residuals of each joint over all runs used."""
    used = [run for run in runs if run.used and run.prediction is not None]
    if not used:
        return None
    joints = used[0].prediction.joints if used[0].prediction else ()
    residuals = {joint: [(run.time, run.residuals[:, j]) for run in used] for j, joint in enumerate(joints)}
    units = {joint: torque_unit(result.robot, joint) for joint in joints}
    words = (
        "Over all runs used, without masked samples. White residuals have a flat spectrum and an autocorrelation "
        "within the band; for other residuals the block jackknife corrects the standard deviations."
    )
    panels = residual_panels(residuals, units)
    chart = Chart(panels, columns=3) if panels else None
    return section("Residuals", Text(words), chart, id="residuals")


def residual_panels(residuals: Mapping[str, Residuals], units: Mapping[str, str]) -> tuple[Panel, ...]:
    """Draw histograms, spectra (a panel per unit) and autocorrelations of the residuals of joints."""
    bars: list[Series] = []
    lags: list[Series] = []
    spectra: dict[str, list[Series]] = {}
    band = 0.0
    for j, (joint, runs) in enumerate(residuals.items()):
        label = joint_label(joint)
        if (bins := histogram(runs)) is not None:
            bars.append(Series(label, *bins, colour(j), "steps"))
        if (densities := spectrum(runs)) is not None and (densities[1] > 0).any():
            frequency, density = (part[densities[1] > 0] for part in densities)
            spectra.setdefault(units[joint], []).append(Series(label, frequency, np.sqrt(density), colour(j)))
        if (correlation := autocorrelation(runs)) is not None:
            lag, value, white_band = correlation
            lags.append(Series(label, lag, value, colour(j)))
            band = max(band, white_band)
    panels = []
    if bars:
        x = np.linspace(-4.0, 4.0, 90)
        normal = Series("normal density", x, np.exp(-(x**2) / 2) / np.sqrt(2 * np.pi), "soft", width=0.8)
        axis = Axis("residual / standard deviation", limits=(-4.5, 4.5))
        panels.append(Panel(axis, Axis("density"), (*bars, normal), "Histogram", height=2))
    for unit, lines in spectra.items():
        axis, density_axis = Axis("frequency, Hz"), Axis(f"{unit}/√Hz", log=True)
        panels.append(Panel(axis, density_axis, tuple(lines), "Amplitude spectral density", height=2))
    if lags:
        title = "Autocorrelation; band: white noise"
        panels.append(Panel(Axis("lag, s"), Axis("autocorrelation"), tuple(lags), title, band=(-band, band), height=2))
    return tuple(panels)


def moments(residuals: Residuals) -> tuple[float, float] | None:
    """Compute mean and standard deviation of the unmasked residuals; None if there are too few."""
    values = _kept(residuals)
    return (float(values.mean()), float(values.std())) if len(values) >= FEWEST and np.ptp(values) else None


def _kept(residuals: Residuals) -> np.ndarray:
    return np.concatenate([values[np.isfinite(values)] for _, values in residuals]) if residuals else np.zeros(0)


def histogram(residuals: Residuals) -> tuple[np.ndarray, np.ndarray] | None:
    """Compute bin edges (B + 1,) and density (B,) of the unmasked residuals, in standard deviations about the mean."""
    values = _kept(residuals)
    if (centre := moments(residuals)) is None:
        return None
    bins = int(np.clip(np.sqrt(len(values)), 8, 40))
    low, high = np.quantile(values, [0.001, 0.999])
    density, edges = np.histogram(np.clip(values, low, high), bins=bins, range=(low, high), density=True)
    mean, std = centre
    return (edges - mean) / std, density * std


def _centred(residuals: Residuals) -> list[tuple[float, np.ndarray, np.ndarray]]:
    """List step (s), residuals about the mean (K,) and unmasked samples (K,) of each run that is long enough."""
    centred = []
    for time, values in residuals:
        kept = np.isfinite(values)
        if kept.sum() >= FEWEST:
            step = (time[-1] - time[0]) / (len(time) - 1)
            centred.append((step, np.where(kept, values - values[kept].mean(), 0.0), kept))
    return centred


def spectrum(residuals: Residuals) -> tuple[np.ndarray, np.ndarray] | None:
    """Compute frequencies (F,), Hz, and Welch's one-sided power spectral density (F,) over all runs.

    Masked residuals count as zero, and the density is scaled by the share of unmasked ones.
    """
    from scipy.signal import welch

    runs = _centred(residuals)
    if not runs:
        return None
    length = min(SEGMENT, *(len(values) for _, values, _ in runs))
    total, weight, frequency = np.zeros(length // 2 + 1), 0.0, np.zeros(0)
    for step, values, kept in runs:
        frequency, density = welch(values, 1 / step, nperseg=length, detrend=False)
        total += kept.sum() * density / kept.mean()
        weight += kept.sum()
    return frequency[1:], total[1:] / weight


def autocorrelation(residuals: Residuals) -> tuple[np.ndarray, np.ndarray, float] | None:
    """Compute lags (L,), s, autocorrelation (L,) over pairs of unmasked residuals, and the 95 % band of white noise."""
    from scipy.special import ndtri

    runs = _centred(residuals)
    if not runs:
        return None
    lags = min(LAGS, min(len(values) for _, values, _ in runs) // 2)
    products, pairs = np.zeros(lags + 1), np.zeros(lags + 1)
    for _, values, kept in runs:
        for lag in range(lags + 1):
            stop = len(values) - lag
            products[lag] += values[:stop] @ values[lag:]
            pairs[lag] += np.count_nonzero(kept[:stop] & kept[lag:])
    variance = products[0] / pairs[0]
    if not variance > 0:
        return None
    step = np.median([step for step, _, _ in runs])
    value, band = products / np.maximum(pairs, 1) / variance, float(ndtri(0.975) / np.sqrt(pairs[0]))
    return step * np.arange(lags + 1), value, band
