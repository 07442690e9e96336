"""Show torque residuals with masked samples: histogram, spectrum and autocorrelation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gtau.estimation.results.result import Result
from gtau.report.chart import Axis, Chart, Panel, Series, colour
from gtau.report.evidence import RunEvidence
from gtau.report.page import Column, Kind, Section, Text, joint_label, section, table
from gtau.robots.parameter import torque_unit

SEGMENT = 256  # samples of a segment of the spectrum, at most
FEWEST = 16  # samples that a statistic needs
LAGS = 40

Residuals = Sequence[tuple[np.ndarray, np.ndarray]]
"""Of each run, times (K,) in s on a uniform grid and residuals (K,), NaN where they are masked."""


def residuals_section(result: Result, runs: Sequence[RunEvidence]) -> Section | None:
    """Show histogram, spectrum and autocorrelation of the residuals of each joint, over all runs used."""
    used = [each for each in runs if each.used and each.prediction is not None]
    if not used:
        return None
    joints = used[0].prediction.joints if used[0].prediction else ()
    found = {joint: [(each.time, each.residuals[:, j]) for each in used] for j, joint in enumerate(joints)}
    units = {joint: torque_unit(result.robot, joint) for joint in joints}
    words = (
        "Over all runs used, masked samples left out. White residuals have a flat spectrum and an autocorrelation "
        "within the band; where they do not, the block jackknife accounts for it in the standard deviations."
    )
    panels = residual_panels(found, units)
    chart = Chart(panels, columns=3) if panels else None
    rows = [(joint_label(joint), *(moments(each) or (None, None)), units[joint]) for joint, each in found.items()]
    columns = (Column("joint"), Column("mean", Kind.NUMBER, 2), Column("std", Kind.NUMBER, 3), Column("unit"))
    return section("Residuals", Text(words), chart, table(columns, rows), id="residuals")


def residual_panels(found: Mapping[str, Residuals], units: Mapping[str, str]) -> tuple[Panel, ...]:
    """Draw histograms, spectra (one panel for each unit) and autocorrelations of residuals by joint."""
    bars: list[Series] = []
    lags: list[Series] = []
    spectra: dict[str, list[Series]] = {}
    band = 0.0
    for j, (joint, residuals) in enumerate(found.items()):
        label = joint_label(joint)
        if (bins := histogram(residuals)) is not None:
            bars.append(Series(label, *bins, colour(j), "steps"))
        if (spectrum_ := spectrum(residuals)) is not None and (spectrum_[1] > 0).any():
            frequency, density = (each[spectrum_[1] > 0] for each in spectrum_)
            spectra.setdefault(units[joint], []).append(Series(label, frequency, np.sqrt(density), colour(j)))
        if (correlation := autocorrelation(residuals)) is not None:
            lag, value, of_white = correlation
            lags.append(Series(label, lag, value, colour(j)))
            band = max(band, of_white)
    panels = []
    if bars:
        x = np.linspace(-4.0, 4.0, 90)
        normal = Series("normal density", x, np.exp(-(x**2) / 2) / np.sqrt(2 * np.pi), "soft", width=0.8)
        axis = Axis("residual / standard deviation", limits=(-4.5, 4.5))
        panels.append(Panel(axis, Axis("density"), (*bars, normal), "Histogram", height=2))
    for unit, lines in spectra.items():
        axis = Axis("frequency, Hz")
        panels.append(Panel(axis, Axis(f"{unit}/√Hz", log=True), tuple(lines), "Amplitude spectral density", height=2))
    if lags:
        title = "Autocorrelation; band: white noise, 95 %"
        panels.append(Panel(Axis("lag, s"), Axis("autocorrelation"), tuple(lags), title, band=(-band, band), height=2))
    return tuple(panels)


def moments(residuals: Residuals) -> tuple[float, float] | None:
    """Compute mean and standard deviation of the residuals that are kept; None where there are too few."""
    values = _kept(residuals)
    return (float(values.mean()), float(values.std())) if len(values) >= FEWEST and np.ptp(values) else None


def _kept(residuals: Residuals) -> np.ndarray:
    return np.concatenate([values[np.isfinite(values)] for _, values in residuals]) if residuals else np.zeros(0)


def histogram(residuals: Residuals) -> tuple[np.ndarray, np.ndarray] | None:
    """Compute edges (B + 1,) and density (B,) of the residuals that are kept, in standard deviations about the mean.

    None where there are too few.
    """
    found, values = moments(residuals), _kept(residuals)
    if found is None:
        return None
    bins = int(np.clip(np.sqrt(len(values)), 8, 40))
    low, high = np.quantile(values, [0.001, 0.999])
    density, edges = np.histogram(np.clip(values, low, high), bins=bins, range=(low, high), density=True)
    mean, std = found
    return (edges - mean) / std, density * std


def _long_enough(residuals: Residuals) -> list[tuple[np.ndarray, np.ndarray]]:
    return [(time, values) for time, values in residuals if np.isfinite(values).sum() >= FEWEST]


def spectrum(residuals: Residuals) -> tuple[np.ndarray, np.ndarray] | None:
    """Compute Welch's spectrum over all runs, masked residuals as zero, scaled by the share that is kept.

    Returns frequencies (F,), Hz, and the one-sided power spectral density (F,); None where there are too few samples.
    """
    from scipy.signal import welch

    whole = _long_enough(residuals)
    if not whole:
        return None
    length = min(SEGMENT, *(len(values) for _, values in whole))
    total, weight, frequency = np.zeros(length // 2 + 1), 0.0, np.zeros(0)
    for time, values in whole:
        kept = np.isfinite(values)
        rate = (len(time) - 1) / (time[-1] - time[0])
        filled = np.where(kept, values - values[kept].mean(), 0.0)
        frequency, density = welch(filled, rate, nperseg=length, detrend=False)
        total += kept.sum() * density / kept.mean()
        weight += kept.sum()
    return frequency[1:], total[1:] / weight


def autocorrelation(residuals: Residuals) -> tuple[np.ndarray, np.ndarray, float] | None:
    """Compute the autocorrelation over all runs, from the pairs of residuals that are both kept.

    Returns lags (L,), s, the autocorrelation (L,), and the 95 % band of white noise about zero; None where there are
    too few samples.
    """
    from scipy.special import ndtri

    whole = _long_enough(residuals)
    if not whole:
        return None
    lags = min(LAGS, min(len(values) for _, values in whole) // 2)
    products, pairs = np.zeros(lags + 1), np.zeros(lags + 1)
    for _, values in whole:
        kept = np.isfinite(values)
        filled = np.where(kept, values - values[kept].mean(), 0.0)
        for lag in range(lags + 1):
            stop = len(values) - lag
            products[lag] += filled[:stop] @ filled[lag:]
            pairs[lag] += np.count_nonzero(kept[:stop] & kept[lag:])
    step = np.median([(time[-1] - time[0]) / (len(time) - 1) for time, _ in whole])
    variance = products[0] / pairs[0]
    if not variance > 0:
        return None
    value = products / np.maximum(pairs, 1) / variance
    return step * np.arange(lags + 1), value, float(ndtri(0.975) / np.sqrt(pairs[0]))
