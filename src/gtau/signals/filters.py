"""Speeds and accelerations from positions, without phase."""

from __future__ import annotations

from math import ceil

import numpy as np

from gtau.errors import GtauError
from gtau.signals.run import Run
from gtau.signals.storage import block

SPEED_POWER = 0.999  # part of a joint's speed power below its bandwidth
SIGNIFICANT = 15.0  # ratio to the mean that a spectral line of noise exceeds once in three million
LEAST_SIGNAL = 100.0  # least ratio of a motion's power to the noise's in its band; logs have 1e7, rest has 1
STENCIL = 2  # samples that a central difference reaches to either side
SEGMENT = 1 << 17  # samples of a periodogram, at most: those of a longer log are averaged
FORGOTTEN = 18.0  # periods of the cut-off after which a filter has forgotten where it began, to 1e-18


def joint_bandwidths(position: np.ndarray, rate: float) -> np.ndarray:
    """Highest frequency of each joint's motion.

    Below it lie 99.9 % of the power of the speed, counted over the spectral lines that stand out from
    the white noise and rounding of the position (measured at 0.25 to 0.45 of the sampling rate).

    Parameters
    ----------
    position : ndarray (N, n)
        Positions on a uniform grid.
    rate : float
        Sampling rate, Hz.

    Returns
    -------
    ndarray (n,)
        Hz; nan for a joint whose motion does not stand out from noise, or reaches beyond a fifth of the
        sampling rate.
    """
    from scipy.signal.windows import tukey

    speeds = len(position) - 2
    segments = -(-speeds // SEGMENT)
    length = min(speeds, SEGMENT)
    # The window keeps a log that begins or ends in motion from looking like a jump.
    window = tukey(length, 0.1)[:, None]
    power = np.zeros((length // 2 + 1, position.shape[1]))
    for start in np.linspace(0, speeds - length, segments).astype(int):
        part = block(position, start, start + length + 2)
        power += np.abs(np.fft.rfft((part[2:] - part[:-2]) * (rate / 2) * window, axis=0)) ** 2
    power /= segments
    frequency = np.fft.rfftfreq(length, 1 / rate)
    shape = np.sin(2 * np.pi * frequency / rate)[:, None] ** 2  # of white noise after the difference
    high = (frequency > 0.25 * rate) & (frequency < 0.45 * rate)
    # The mean of an exponential distribution is its median over ln 2; the median ignores single lines.
    noise = np.median(power[high] / shape[high], axis=0) / np.log(2) * shape
    held = np.cumsum(np.where(power > SIGNIFICANT * noise, power, 0.0), axis=0)
    found = np.argmax(held >= SPEED_POWER * held[-1], axis=0)
    joint = np.arange(position.shape[1])
    stands_out = held[found, joint] > LEAST_SIGNAL * np.cumsum(noise, axis=0)[found, joint]
    return np.where(stands_out & (found > 0) & (frequency[found] <= 0.2 * rate), frequency[found], np.nan)


def bandwidth(run: Run) -> float:
    """Bandwidth of a run, Hz: the largest of its joints' (see :func:`joint_bandwidths`).

    Raises
    ------
    GtauError
        No joint's motion stands out from noise.
    """
    found = joint_bandwidths(run.position, run.rate)
    if np.isnan(found).all():
        raise GtauError(
            f"run '{run.name}': no joint's motion stands out from the noise of its position; give a log of a moving "
            "robot, sampled at least ten times as fast as it moves."
        )
    return float(np.nanmax(found))


def cutoff_frequency(bandwidth: float, rate: float) -> float | None:
    """Cut-off of the position filter, Hz: ten times the bandwidth, at least 5 Hz.

    None, no filter, where that is not below 0.8 of the Nyquist frequency.
    """
    cutoff = max(10 * bandwidth, 5.0)
    return cutoff if cutoff < 0.4 * rate else None


def low_pass(x: np.ndarray, rate: float, cutoff: float) -> np.ndarray:
    """Zero-phase Butterworth low-pass along the first axis: order 4, forward and backward.

    The gain at frequency f is ``1 / (1 + (f / cutoff)^8)``: 1 - 1e-8 at a tenth of the cut-off.
    """
    from scipy.signal import butter, sosfiltfilt

    sos = butter(4, cutoff, fs=rate, output="sos")
    return sosfiltfilt(sos, x, axis=0, padlen=min(len(x) - 1, filter_edge(rate, cutoff)))


def filter_edge(rate: float, cutoff: float | None) -> int:
    """Samples at either end of a log on which its unknown past or future acts by more than 1e-3."""
    # The slowest poles of the filter decay as exp(-2.4 cutoff t).
    return STENCIL + (0 if cutoff is None else ceil(3 * rate / cutoff))


def filter_margin(rate: float, cutoff: float | None) -> int:
    """Samples to either side of one that act on its filtered position, speed and acceleration by more than 1e-18."""
    return STENCIL + (0 if cutoff is None else ceil(FORGOTTEN * rate / cutoff))


def differentiate(x: np.ndarray, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """First and second derivative along the first axis by central differences of fourth order.

    A sine of angular frequency w keeps its phase; its derivatives are too small by ``(w / rate)^4 / 30``
    and ``(w / rate)^4 / 90``: 0.04 and 0.01 % at a twentieth of the sampling rate. The two samples at
    either end repeat their neighbours' values.
    """
    y = x / 12.0
    first = (y[:-4] - 8 * y[1:-3] + 8 * y[3:-1] - y[4:]) * rate
    second = (-y[:-4] + 16 * y[1:-3] - 30 * y[2:-2] + 16 * y[3:-1] - y[4:]) * rate**2
    ends = [(STENCIL, STENCIL)] + [(0, 0)] * (x.ndim - 1)
    return np.pad(first, ends, mode="edge"), np.pad(second, ends, mode="edge")


def position_filter(
    position: np.ndarray, rate: float, cutoff: float | None, start: int = 0, stop: int | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Filtered positions, speeds and accelerations.

    Those of some samples are the same as those of the whole log, of which only what acts on them is read.

    Parameters
    ----------
    position : ndarray (N, n)
        Positions on a uniform grid, rad or m.
    rate : float
        Sampling rate, Hz.
    cutoff : float or None
        Cut-off of the low-pass, Hz; None for no filter.
    start, stop : int
        First sample wanted, and the one after the last; all of the log if left out.

    Returns
    -------
    q, qd, qdd : ndarray (stop - start, n)
        In the position's unit, per s and per s2.
    """
    stop = len(position) if stop is None else stop
    margin = filter_margin(rate, cutoff)
    begin = max(0, start - margin)
    x = block(position, begin, min(len(position), stop + margin))
    q = x if cutoff is None else low_pass(x, rate, cutoff)
    wanted = slice(start - begin, stop - begin)
    qd, qdd = differentiate(q, rate)
    return q[wanted], qd[wanted], qdd[wanted]
