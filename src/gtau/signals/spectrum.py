"""Power spectra of second differences, in which motion and noise lie far apart."""

from __future__ import annotations

import numpy as np

from gtau.signals.storage import block

SEGMENT = 1 << 17  # maximum samples per periodogram: periodograms of a longer log are averaged
SEGMENTS = 16  # of a long log, spread over it
ENDS = 0.05  # of the samples, at either side, that a window fades in and out
TOP = 0.45  # of the rate at which signals change: highest frequency evaluated


def second_differences(values: np.ndarray, rate: float, updates: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute the spectra of the second derivatives of ``values`` (N, n), by differences.

    Returns frequencies (K,) up to ``TOP`` of the rate of ``updates`` (Hz), power densities (K, n), and the gains (K,)
    of a double difference.
    """
    count = len(values) - 2
    segments, length = min(-(-count // SEGMENT), SEGMENTS), min(count, SEGMENT)
    # the window keeps a log that begins or ends in motion from looking like a jump
    window = taper(length)[:, None]
    power = np.zeros((length // 2 + 1, values.shape[1]))
    for start in np.linspace(0, count - length, segments).astype(int):
        part = block(values, start, start + length + 2)
        power += np.abs(np.fft.rfft((part[2:] - 2 * part[1:-1] + part[:-2]) * (rate**2 * window), axis=0)) ** 2
    frequency = np.fft.rfftfreq(length, 1 / rate)
    used = slice(1, int(np.searchsorted(frequency, TOP * updates, side="right")))
    gain = (2 * rate * np.sin(np.pi * frequency[used] / rate)) ** 2
    return frequency[used], power[used] * (2 / (segments * rate * (window**2).sum())), gain


def taper(length: int) -> np.ndarray:
    """Compute the weights (length,) of a window with cosine ends (Tukey's)."""
    samples = np.arange(length)
    share = np.minimum(samples, samples[::-1]) / (ENDS * max(length - 1, 1))
    return 0.5 - 0.5 * np.cos(np.pi * np.minimum(share, 1.0))


def fast_length(length: int) -> int:
    """Return the length (at least this one, at most a sixteenth longer) of a quick Fourier transform."""
    unit = 1 << max(length.bit_length() - 5, 0)
    return -(-length // unit) * unit
