"""Statistics of torque residuals with masked samples: histogram, spectrum and autocorrelation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

SEGMENT = 256  # samples of a segment of the spectrum, at most
FEWEST = 16  # samples that a statistic needs
LAGS = 40

Series = Sequence[tuple[np.ndarray, np.ndarray]]
"""Of each run, times (K,) in s on a uniform grid and residuals (K,), NaN where they are masked."""


@dataclass(frozen=True, eq=False)
class Histogram:
    """Density (B,) between ``edges`` (B + 1,), and the normal density of the same mean and standard deviation."""

    edges: np.ndarray
    density: np.ndarray
    mean: float
    std: float

    def normal(self, x: np.ndarray) -> np.ndarray:
        """Evaluate the normal density at ``x``."""
        z = (x - self.mean) / self.std
        return np.asarray(np.exp(-(z**2) / 2) / (self.std * np.sqrt(2 * np.pi)))


@dataclass(frozen=True, eq=False)
class Spectrum:
    """One-sided power spectral density (F,) at ``frequency`` (F,) in Hz."""

    frequency: np.ndarray
    density: np.ndarray


@dataclass(frozen=True, eq=False)
class Autocorrelation:
    """Autocorrelation (L,) at ``lag`` (L,) in s, and the 95 % band of white noise about zero."""

    lag: np.ndarray
    value: np.ndarray
    band: float


def histogram(series: Series) -> Histogram | None:
    """Compute the histogram of the residuals that are kept; None where there are too few."""
    values = np.concatenate([values[np.isfinite(values)] for _, values in series]) if series else np.zeros(0)
    if len(values) < FEWEST or not np.ptp(values):
        return None
    bins = int(np.clip(np.sqrt(len(values)), 8, 40))
    low, high = np.quantile(values, [0.001, 0.999])
    density, edges = np.histogram(np.clip(values, low, high), bins=bins, range=(low, high), density=True)
    return Histogram(edges, density, float(values.mean()), float(values.std()))


def spectrum(series: Series) -> Spectrum | None:
    """Compute Welch's spectrum over all runs, masked residuals as zero, scaled by the share that is kept."""
    from scipy.signal import welch

    whole = [(time, values) for time, values in series if np.isfinite(values).sum() >= FEWEST]
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
    return Spectrum(frequency[1:], total[1:] / weight)


def autocorrelation(series: Series) -> Autocorrelation | None:
    """Compute the autocorrelation over all runs, from the pairs of residuals that are both kept."""
    whole = [(time, values) for time, values in series if np.isfinite(values).sum() >= FEWEST]
    if not whole:
        return None
    from scipy.special import ndtri

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
    return Autocorrelation(step * np.arange(lags + 1), value, float(ndtri(0.975) / np.sqrt(pairs[0])))
