"""Zero-phase velocities and accelerations from positions."""

from __future__ import annotations

from math import ceil

import numpy as np

from gtau.signals.storage import block

STENCIL = 2  # samples that a central difference reaches to either side
# Periods of the cut-off after which a filter has forgotten its beginning to 1e-3: its slowest poles decay as
# exp(-2.4 cutoff t). With two periods errors of the Panda rise from 2.0 to 2.2 % (geometric mean).
EDGE = 3.0
# Cut-offs from this share of the sampling rate on, 0.8 of the Nyquist frequency, are no filter. One there would leave
# 94 % of the rms noise of the speeds and 64 % of that of the accelerations, of positions with white noise (one at 0.25:
# 57 and 21 %), while its ends cost rows all the same.
HIGHEST_CUTOFF = 0.4
LARGEST_ENDS = 0.12  # share of the samples that may be lost at both ends
FORGOTTEN = 18.0  # periods of the cut-off after which a filter has forgotten where it began, to 1e-18

Cutoff = float | tuple[float | None, ...] | None
"""Cut-off of a low-pass, Hz: of all columns, or of each; None for no filter."""


def cutoff_frequency(bandwidth: float, end: float, rate: float, seconds: float = np.inf) -> float | None:
    """Choose the cut-off of the position filter, Hz; None for no filter.

    Ten times the bandwidth, and at least 5 Hz, which keeps the motion to 1e-8. Where the ``end`` of the signal lies
    below that it is taken: motion and noise are as strong there, and Wiener's filter, which makes the error of the
    accelerations least, halves both, as this one does at its cut-off. But 2.5 times the bandwidth at least, where the
    gain at the bandwidth is 1 - 7e-4. Nor lower than where the filter's ends take 12 % of runs that last so many
    ``seconds`` on average: on two runs of 5 s of an xMate7, 2.5 Hz instead of 10 Hz raise the torque errors on a third
    from 17 to 28 % (geometric mean).

    Not above half the Nyquist frequency, where little noise is left to be filtered, and rows are not decimated: the
    torques would keep what the positions lose (on the UPV robot at 100 Hz, 34 Hz raise a leg's torque error from 11 to
    15 %).
    """
    ends = 2 * EDGE / (LARGEST_ENDS * seconds)
    cutoff = max(10 * bandwidth, 5.0, ends)
    narrow = max(min(cutoff, end), 2.5 * bandwidth, ends)
    cutoff = narrow if narrow < 0.25 * rate else cutoff
    return below_nyquist(cutoff, rate)


def below_nyquist(cutoff: float, rate: float) -> float | None:
    """Return the cut-off (Hz), or None where it is too near the Nyquist frequency for a filter to help."""
    return cutoff if cutoff < HIGHEST_CUTOFF * rate else None


def low_pass(x: np.ndarray, rate: float, cutoff: float) -> np.ndarray:
    """Filter along the first axis by a zero-phase Butterworth low-pass: order 4, forward and backward.

    The gain at frequency f is ``1 / (1 + (f / cutoff)^8)``: 1 - 1e-8 at a tenth of the cut-off.
    """
    from scipy.signal import butter, sosfiltfilt

    sos = butter(4, cutoff, fs=rate, output="sos")
    return sosfiltfilt(sos, x, axis=0, padlen=min(len(x) - 1, filter_edge(rate, cutoff)))


def smooth_path(position: np.ndarray, rate: float, cutoff: Cutoff, start: int, stop: int) -> np.ndarray:
    """Smooth a stretch of positions by a Gaussian with a gain of 1 / sqrt(2) at the cut-off.

    Its weights are positive, so that the path reverses only where the logged one does. :func:`low_pass`
    rings where a joint stops, on a UR10e by 1.4e-4 rad, twice the width of its presliding.
    """
    from scipy.ndimage import gaussian_filter1d

    if isinstance(cutoff, tuple):
        columns = [smooth_path(position[:, [j]], rate, each, start, stop) for j, each in enumerate(cutoff)]
        return np.hstack(columns)
    if cutoff is None:
        return block(position, start, stop)
    spread = np.sqrt(np.log(2)) / (2 * np.pi) * rate / cutoff  # samples
    radius = ceil(4 * spread)
    begin = max(0, start - radius)
    x = block(position, begin, min(len(position), stop + radius))
    smooth: np.ndarray = gaussian_filter1d(x, spread, axis=0, mode="nearest", radius=radius)
    return smooth[start - begin : stop - begin]


def _lowest(cutoff: Cutoff) -> float | None:
    given = [each for each in (cutoff if isinstance(cutoff, tuple) else (cutoff,)) if each is not None]
    return min(given, default=None)


def filter_edge(rate: float, cutoff: Cutoff) -> int:
    """Count samples at either end of a log that its unknown past or future affects by more than 1e-3."""
    cutoff = _lowest(cutoff)
    return STENCIL + (0 if cutoff is None else ceil(EDGE * rate / cutoff))


def filter_margin(rate: float, cutoff: Cutoff) -> int:
    """Count samples on either side of one that affect its filtered motion by more than 1e-18."""
    cutoff = _lowest(cutoff)
    return STENCIL + (0 if cutoff is None else ceil(FORGOTTEN * rate / cutoff))


def differentiate(x: np.ndarray, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Compute first and second derivative along the first axis by central differences of fourth order.

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
    position: np.ndarray, rate: float, cutoff: Cutoff, start: int = 0, stop: int | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute filtered positions, speeds and accelerations.

    A stretch of the result equals that of the whole log; only samples within reach of the filters are read.

    Parameters
    ----------
    position : ndarray (N, n)
        Positions on a uniform grid, rad or m.
    rate : float
        Sampling rate, Hz.
    cutoff : float, tuple or None
        Cut-off of the low-pass, Hz, of all columns or of each; None for no filter.
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
    if isinstance(cutoff, tuple):
        columns = zip(x.T, cutoff, strict=True)
        q = np.stack([column if each is None else low_pass(column, rate, each) for column, each in columns], axis=1)
    else:
        q = x if cutoff is None else low_pass(x, rate, cutoff)
    wanted = slice(start - begin, stop - begin)
    qd, qdd = differentiate(q, rate)
    return q[wanted], qd[wanted], qdd[wanted]
