"""Zero-phase filters: velocities and accelerations from positions, and parallel decimation (paper, eqs. 19-20).

Parallel decimation is one low-pass for the command and for every column of the regressor. Decimators stream:
`Decimator.blocks` cuts the outputs of a log into blocks; the columns at the `samples` of one block at a time are
computed and handed to `Decimator.apply`, and the outputs equal the outputs of the whole log.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil
from typing import Literal

import numpy as np

from gtau.signals.run import Run
from gtau.signals.storage import block, spans

STENCIL = 2  # samples that a central difference reaches to either side
EDGE = 3.0  # periods of the cut-off after which a filter has forgotten its beginning to 1e-3
HIGHEST_CUTOFF = 0.4  # of the sampling rate: a filter above leaves nearly all noise, while its ends cost rows
LARGEST_ENDS = 0.12  # share of the samples that may be lost at both ends
FORGOTTEN = 18.0  # periods of the cut-off after which a filter has forgotten where it began, to 1e-18

Cutoff = float | tuple[float | None, ...] | None
"""Cut-off of a low-pass, Hz: of all columns, or of each; None for no filter."""


def cutoff_frequency(
    bandwidth: float, end: float, rate: float, seconds: float = np.inf, updates: float = np.inf
) -> float | None:
    """Choose the cut-off of the position filter, Hz; None for no filter.

    Ten times the bandwidth, and at least 5 Hz, keeps the motion to 1e-8. If the signal ends below that, the cut-off is
    the ``end``, where motion and noise are equally strong: Wiener's filter, which minimises the error of the
    accelerations, halves both there, as this filter does at its cut-off. The cut-off is at least 2.5 times the
    bandwidth, where the gain at the bandwidth is 1 - 7e-4, and high enough that the ends of the filter take at most
    ``LARGEST_ENDS`` of runs with a mean duration of ``seconds``. Nothing is filtered above half the Nyquist frequency,
    where little noise remains and rows are not decimated: the torques would keep what the positions lose.
    """
    ends = cutoff_at_ends(seconds)
    cutoff = max(10 * bandwidth, 5.0, ends)
    narrow = max(min(cutoff, end), 2.5 * bandwidth, ends)
    cutoff = narrow if narrow < 0.25 * rate else cutoff
    return below_nyquist(cutoff, rate, updates)


def cutoff_at_ends(seconds: float) -> float:
    """Return the lowest cut-off (Hz) that discards at most ``LARGEST_ENDS`` of a log of this length (``seconds``)."""
    return 2 * EDGE / (LARGEST_ENDS * seconds)


def below_nyquist(cutoff: float, rate: float, updates: float = np.inf) -> float | None:
    """Return the cut-off (Hz), or None where it is too near the Nyquist frequency for a filter to help.

    Signals that are held, and change at the rate of ``updates`` (Hz), have images above, which are always filtered.
    """
    highest = HIGHEST_CUTOFF * min(rate, updates)
    return cutoff if cutoff < highest else highest if updates < HIGHEST_CUTOFF * rate else None


def low_pass(x: np.ndarray, rate: float, cutoff: float) -> np.ndarray:
    """Filter along the first axis by a zero-phase Butterworth low-pass: order 4, forward and backward.

    The gain at frequency f is ``1 / (1 + (f / cutoff)^8)``: 1 - 1e-8 at a tenth of the cut-off.
    """
    from gtau.model.kernel import recur

    edge, y = min(len(x) - 1, filter_edge(rate, cutoff)), x.reshape(len(x), -1).T.copy()
    # each end is continued by its point reflection
    y = np.concatenate([2 * y[:, :1] - y[:, edge:0:-1], y, 2 * y[:, -1:] - y[:, -2 : -edge - 2 : -1]], axis=1)
    k, damping = np.tan(np.pi * cutoff / rate), 2 * np.sin(np.pi / 8 * np.array([1, 3]))
    gain, one = k**2 / (1 + damping * k + k**2), np.ones(2)
    poles = np.array([2 * (1 - k**-2) * one, (1 - damping * k + k**2) / k**2])
    sections = (gain * np.array([one, 2 * one, one, *poles])).T.copy()
    for _ in range(2):
        recur(sections, y)
        y = y[:, ::-1].copy()
    return np.ascontiguousarray(y[:, edge : edge + len(x)].T).reshape(x.shape)


def smooth_path(position: np.ndarray, rate: float, cutoff: Cutoff, start: int, stop: int) -> np.ndarray:
    """Smooth a stretch of positions by a Gaussian with a gain of 1 / sqrt(2) at the cut-off.

    Its weights are positive, so the path reverses only where the logged path does. :func:`low_pass` rings where a joint
    stops, on a UR10e by 1.4e-4 rad, twice the width of its presliding.
    """
    from scipy.ndimage import gaussian_filter1d

    if isinstance(cutoff, tuple):
        columns = [smooth_path(position[:, [j]], rate, frequency, start, stop) for j, frequency in enumerate(cutoff)]
        return np.hstack(columns)
    if cutoff is None:
        return block(position, start, stop)
    spread = np.sqrt(np.log(2)) / (2 * np.pi) * rate / cutoff  # samples
    radius = ceil(4 * spread)
    begin = max(0, start - radius)
    x = block(position, begin, min(len(position), stop + radius))
    smooth: np.ndarray = gaussian_filter1d(x, spread, axis=0, mode="nearest", radius=radius)
    return smooth[start - begin : stop - begin]


def filter_edge(rate: float, cutoff: Cutoff, periods: float = EDGE) -> int:
    """Count the samples at either end of a log that lack of data beyond changes, by more than 1e-3 for ``periods``."""
    given = [frequency for frequency in (cutoff if isinstance(cutoff, tuple) else (cutoff,)) if frequency is not None]
    return STENCIL + (ceil(periods * rate / min(given)) if given else 0)


def differentiate(x: np.ndarray, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Compute first and second derivative along the first axis by central differences of fourth order.

    A sine of angular frequency w keeps its phase; its derivatives are too small by ``(w / rate)^4 / 30`` and
    ``(w / rate)^4 / 90``: 0.04 and 0.01 % at a twentieth of the sampling rate. Two samples at either end repeat their
    neighbours' values.
    """
    y = x / 12.0
    first, second = np.empty_like(y), np.empty_like(y)
    first[2:-2] = (y[:-4] - 8 * y[1:-3] + 8 * y[3:-1] - y[4:]) * rate
    second[2:-2] = (-y[:-4] + 16 * y[1:-3] - 30 * y[2:-2] + 16 * y[3:-1] - y[4:]) * rate**2
    for derivative in (first, second):
        derivative[:STENCIL], derivative[-STENCIL:] = derivative[STENCIL], derivative[-STENCIL - 1]
    return first, second


def position_filter(
    position: np.ndarray, rate: float, cutoff: Cutoff, start: int = 0, stop: int | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute filtered positions, speeds and accelerations, each (stop - start, n), of positions (N, n).

    ``rate`` and ``cutoff`` (of all columns or of each; None for no filter) are in Hz. A part from ``start`` to before
    ``stop`` equals the same part of the filtered log; only samples within reach of the filters are read.
    """
    stop = len(position) if stop is None else stop
    margin = filter_edge(rate, cutoff, FORGOTTEN)
    begin = max(0, start - margin)
    x = block(position, begin, min(len(position), stop + margin))
    if isinstance(cutoff, tuple):
        q = x.copy()
        for j, frequency in enumerate(cutoff):
            if frequency is not None:
                q[:, j] = low_pass(x[:, j], rate, frequency)
    else:
        q = x if cutoff is None else low_pass(x, rate, cutoff)
    wanted = slice(start - begin, stop - begin)
    qd, qdd = differentiate(q, rate)
    return q[wanted], qd[wanted], qdd[wanted]


MAX_FACTOR = 20
PASSED = 0.8  # cut-off of the low-pass, as a share of the new Nyquist frequency, as in MATLAB's ``decimate``


@dataclass(frozen=True)
class Decimator:
    """Zero-phase low-pass that keeps every ``factor``-th sample.

    ``fir`` is a Kaiser-windowed sinc of 3 ``factor`` samples with unit gain at zero frequency: an output depends only
    on the samples of its ``support``. ``chebyshev`` is MATLAB's ``decimate``, as in the paper: Chebyshev I of order 8,
    ripple 0.05 dB, forward and backward; after 180 ``factor`` samples of warm-up 1e-13 of its response remains. Both
    cut off at ``PASSED``, 0.8 of the new Nyquist frequency. With factor 1 nothing is filtered.
    """

    factor: int
    kind: Literal["fir", "chebyshev"] = "fir"

    def cutoff(self, rate: float) -> float:
        """Compute the cut-off of the low-pass, Hz, for a log sampled at ``rate`` (Hz)."""
        return PASSED / 2 * rate / self.factor if self.factor > 1 else rate / 2

    @cached_property
    def kernel(self) -> np.ndarray:
        """Taps of the FIR: 3 ``factor`` and one or two more."""
        half = ceil(1.5 * self.factor)
        # beta = 5: side lobes 50 dB down, and a main lobe as narrow as so short a filter allows.
        taps = np.sinc(PASSED / self.factor * np.arange(-half, half + 1)) * np.kaiser(2 * half + 1, 5.0)
        return taps / taps.sum()

    def _chebyshev(self, columns: np.ndarray) -> np.ndarray:
        from scipy.signal import cheby1, sosfiltfilt

        return sosfiltfilt(cheby1(8, 0.05, PASSED / self.factor, output="sos"), columns, axis=-1)

    @property
    def support(self) -> int:
        """Number of samples that a log needs on either side of an output."""
        if self.factor == 1:
            return 0
        return ceil(1.5 * self.factor) if self.kind == "fir" else self.factor

    @property
    def guard(self) -> int:
        """Number of samples on either side of an output that must be usable."""
        # Beyond, the FIR has 0.5 to 1.5 % of its weight, in lobes of both signs; Chebyshev's response is infinite.
        return self.factor if self.factor > 1 else 0

    @property
    def warm_up(self) -> int:
        """Number of samples on either side of an output from which it is computed, fewer at the ends of a log."""
        return 180 * self.factor if self.kind == "chebyshev" and self.factor > 1 else self.support

    def instants(self, n: int) -> np.ndarray:
        """List the sample of each output, (outputs,), for a log of `n` samples."""
        return np.arange(self.support, n - self.support, self.factor)

    def outputs(self, n: int) -> int:
        """Count the outputs of a log of `n` samples."""
        return max(0, -(-(n - 2 * self.support) // self.factor))

    def blocks(self, n: int, size: int) -> Iterator[slice]:
        """Cut the outputs of a log of `n` samples into blocks of at most `size`, in order."""
        return (slice(*span) for span in spans(self.outputs(n), size))

    def samples(self, outputs: slice, n: int) -> slice:
        """Return the samples from which a block of outputs is computed, for a log of `n` samples."""
        first, last = (self.support + self.factor * k for k in (outputs.start, outputs.stop - 1))
        return slice(max(0, first - self.warm_up), min(n, last + self.warm_up + 1))

    def at(self, outputs: slice) -> slice:
        """Return the places of the outputs of a block among its :meth:`samples`."""
        first = min(self.support + self.factor * outputs.start, self.warm_up)
        return slice(first, first + (outputs.stop - outputs.start - 1) * self.factor + 1, self.factor)

    def apply(self, columns: np.ndarray, outputs: slice | None = None) -> np.ndarray:
        """Compute the outputs (..., outputs) of columns (..., M) at the samples of a block, or of a whole log."""
        outputs = outputs or slice(0, self.outputs(columns.shape[-1]))
        count, at = outputs.stop - outputs.start, self.at(outputs)
        if self.factor == 1 or count == 0:
            return columns[..., at]
        if self.kind == "chebyshev":
            return self._chebyshev(columns)[..., at]
        # an output needs three blocks of ``factor`` samples, each times its taps, and one or two samples after them
        rows = columns[..., : (count + 2) * self.factor].reshape(*columns.shape[:-1], -1, self.factor)
        parts = rows @ self.kernel[: 3 * self.factor].reshape(3, self.factor).T
        made = sum(parts[..., k : k + count, k] for k in range(3))
        for k in range(3 * self.factor, len(self.kernel)):
            made += self.kernel[k] * columns[..., k :: self.factor][..., :count]
        return made

    def smooth(self, columns: np.ndarray, first: int, count: int) -> np.ndarray:
        """Filter without decimation: compute the outputs at ``count`` samples of a block from its ``first`` on.

        The columns (..., M) have up to ``warm_up`` samples on either side. Beyond the ends of the log its last sample
        is repeated; see :meth:`near`.
        """
        if self.factor == 1 or self.kind == "chebyshev":
            return (columns if self.factor == 1 else self._chebyshev(columns))[..., first : first + count]
        lacking = max(self.support - first, 0), max(first + count + self.support - columns.shape[-1], 0)
        ends = [(0, 0)] * (columns.ndim - 1)
        seen = np.pad(columns, [*ends, lacking], mode="edge")[..., first + lacking[0] - self.support :]
        whole = count + 2 * self.support
        unit = 1 << max(whole.bit_length() - 5, 0)
        size = -(-whole // unit) * unit  # at most a sixteenth longer, which is quick to transform
        product = np.fft.rfft(seen[..., :whole], size) * np.fft.rfft(self.kernel, size)
        return np.fft.irfft(product, size)[..., 2 * self.support : whole]

    def near(self, usable: np.ndarray) -> np.ndarray:
        """Mark the samples (N,) or (N, n) with no unusable sample and no end of the log within ``guard``."""
        from scipy.ndimage import minimum_filter1d

        return minimum_filter1d(usable, 2 * self.guard + 1, axis=0, mode="constant", cval=False)

    def keep(self, usable: np.ndarray, outputs: slice | None = None) -> np.ndarray:
        """Mark the outputs of a block or a log, (K,) or (K, n), with no unusable sample, (N,) or (N, n), in reach."""
        return self.near(usable)[self.at(outputs or slice(0, self.outputs(len(usable))))]


def decimation_factor(rate: float, bandwidth: float, most: int = MAX_FACTOR) -> int:
    """Choose the factor that leaves five samples in a period of the fastest motion.

    ``floor(0.4 rate / (2 bandwidth))``, at least 1 and at most ``most``; both in Hz. The low-pass then cuts off at
    twice the bandwidth.
    """
    return int(min(max(PASSED / 2 * rate // (2 * bandwidth), 1), most))


SPEED_FRACTION = 0.05  # of a joint's rms speed


@dataclass(frozen=True)
class Preparation:
    """Preparation of the runs of an experiment.

    ``bandwidth`` of the motion and ``cutoff`` of the position filter (None: no filter) are in Hz. The ``decimator``
    suits runs with this ``rate`` (Hz, of the slowest run; 0 if unknown); other runs are decimated to the same row rate.
    A joint's row is left out where its speed is below the ``speed_fraction`` of its rms speed. ``given`` names the
    settings made by hand. ``prediction_cutoffs`` (Hz) and ``position_noise`` of each joint, where they are known, are
    for predicted torques: see :func:`gtau.uses.identify.with_prediction_cutoffs` and
    :func:`gtau.signals.preparation.bandwidth.position_noise`.
    """

    bandwidth: float
    cutoff: float | None
    decimator: Decimator
    speed_fraction: float = SPEED_FRACTION
    rate: float = 0.0
    given: tuple[str, ...] = ()
    prediction_cutoffs: tuple[float | None, ...] = ()
    position_noise: tuple[float, ...] = ()

    def at(self, rate: float) -> Preparation:
        """Adapt the preparation to runs with another sampling ``rate`` (Hz): same filter, same row rate."""
        if not self.rate or abs(rate / self.rate - 1) < 0.1:
            return self
        factor = max(1, round(self.decimator.factor * rate / self.rate))
        cutoff = self.cutoff
        if "position_filter" not in self.given:
            cutoff = max(10 * self.bandwidth, 5.0) if cutoff is None else cutoff
        cutoff = None if cutoff is None else below_nyquist(cutoff, rate)
        return replace(self, cutoff=cutoff, decimator=replace(self.decimator, factor=factor), rate=rate)


def valid_samples(run: Run, preparation: Preparation, start: int, stop: int) -> np.ndarray:
    """Mark where speeds and accelerations depend on valid samples only (stop - start, n)."""
    from scipy.ndimage import minimum_filter1d

    samples, edge = len(run.time), filter_edge(run.rate, preparation.cutoff)
    begin, number = max(0, start - STENCIL), np.arange(start, stop)
    valid = block(run.valid, begin, min(samples, stop + STENCIL))
    near = minimum_filter1d(valid, 2 * STENCIL + 1, axis=0, mode="nearest")[start - begin : stop - begin]
    return near & ((number >= edge) & (number < samples - edge))[:, None]
