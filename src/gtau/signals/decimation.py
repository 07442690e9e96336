"""Parallel decimation: one low-pass for the command and for every column of the regressor (paper, eqs. 19-20).

Decimators stream. `Decimator.blocks` cuts a log into overlapping blocks; the columns of one block at a time
are computed and handed to `Decimator.apply`, and the outputs are those of the whole log.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from math import ceil
from typing import Literal

import numpy as np

MAX_FACTOR = 20
PASSED = 0.8  # cut-off of the low-pass, as a share of the new Nyquist frequency, as in MATLAB's ``decimate``


@dataclass(frozen=True)
class Block:
    """Stretch of a log (``samples``), its ``outputs`` (by number), and the sample of the first output."""

    samples: slice
    outputs: slice
    first: int


@dataclass(frozen=True)
class Decimator:
    """Zero-phase low-pass that keeps every ``factor``-th sample.

    ``fir`` is a Kaiser-windowed sinc of 3 ``factor`` samples with unit gain at zero frequency: an output
    depends only on the samples of its ``support``. ``chebyshev`` is MATLAB's ``decimate``, the
    paper's way: Chebyshev I of order 8, ripple 0.05 dB, forward and backward; its response never ends, and
    180 ``factor`` samples of warm-up leave 1e-13 of it. Both cut off at 0.8 of the new Nyquist frequency,
    ``PASSED``. With factor 1 nothing is filtered.
    """

    factor: int
    kind: Literal["fir", "chebyshev"] = "fir"

    def cutoff(self, rate: float) -> float:
        """Compute the cut-off of the low-pass, Hz, for a log sampled at ``rate`` (Hz)."""
        return PASSED / 2 * rate / self.factor if self.factor > 1 else rate / 2

    @property
    def support(self) -> int:
        """Number of samples that a log needs on either side of an output."""
        if self.factor == 1:
            return 0
        return ceil(1.5 * self.factor) if self.kind == "fir" else self.factor

    @property
    def guard(self) -> int:
        """Number of samples on either side of an output that must be usable.

        The part of the ``fir`` beyond ``factor`` samples has 0.5 to 1.5 % of its weight, in lobes of both signs; the
        response of ``chebyshev`` is infinite.
        """
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

    def blocks(self, n: int, size: int) -> Iterator[Block]:
        """Cut a log of `n` samples into blocks of at most `size` outputs, in order."""
        outputs = self.outputs(n)
        for start in range(0, outputs, size):
            stop = min(start + size, outputs)
            first, last = (self.support + self.factor * k for k in (start, stop - 1))
            begin = max(0, first - self.warm_up)
            yield Block(slice(begin, min(n, last + self.warm_up + 1)), slice(start, stop), first - begin)

    def apply(self, columns: np.ndarray, block: Block | None = None) -> np.ndarray:
        """Compute the outputs of a block.

        Parameters
        ----------
        columns : ndarray (..., M)
            Columns at the samples of the block.
        block : Block, optional
            One of `blocks`; without it the columns are those of a whole log.

        Returns
        -------
        ndarray (..., outputs)
            Columns at the instants of the outputs.
        """
        if block is None:
            instants = self.instants(columns.shape[-1])
            block = Block(slice(0, columns.shape[-1]), slice(0, len(instants)), self.support)
        count = block.outputs.stop - block.outputs.start
        last = block.first + (count - 1) * self.factor + 1
        if self.factor == 1 or count == 0:
            return columns[..., block.first : last]
        if self.kind == "chebyshev":
            from scipy.signal import sosfiltfilt

            return sosfiltfilt(_chebyshev(self.factor), columns, axis=-1)[..., block.first : last : self.factor]
        from scipy.signal import upfirdn

        # The padded kernel puts the outputs on multiples of the factor, the only ones upfirdn computes.
        taps = _kernel(self.factor)
        skipped = (len(taps) - 1) // self.factor
        return upfirdn(taps, columns, down=self.factor, axis=-1)[..., skipped : skipped + count]

    def smooth(self, columns: np.ndarray, first: int, count: int) -> np.ndarray:
        """Filter without decimation: compute the outputs at ``count`` samples of a block from its ``first`` on.

        Beyond the ends of the log its last sample is repeated; see :meth:`near`.

        Parameters
        ----------
        columns : ndarray (..., M)
            Columns at the samples of the block, with up to ``warm_up`` samples on either side.

        Returns
        -------
        ndarray (..., count)
            Columns at these samples.
        """
        if self.factor == 1 or self.kind == "chebyshev":
            from scipy.signal import sosfiltfilt

            filtered = columns if self.factor == 1 else sosfiltfilt(_chebyshev(self.factor), columns, axis=-1)
            return filtered[..., first : first + count]
        from scipy.signal import oaconvolve

        lacking = max(self.support - first, 0), max(first + count + self.support - columns.shape[-1], 0)
        ends = [(0, 0)] * (columns.ndim - 1)
        seen = np.pad(columns, [*ends, lacking], mode="edge")[..., first + lacking[0] - self.support :]
        taps = np.trim_zeros(_kernel(self.factor), "f")
        taps = np.reshape(taps, (1,) * (columns.ndim - 1) + (-1,))
        return oaconvolve(seen[..., : count + 2 * self.support], taps, mode="valid", axes=-1)

    def near(self, usable: np.ndarray) -> np.ndarray:
        """Mark the samples (N,) or (N, n) with no unusable sample and no end of the log within ``guard``."""
        ends = [(self.guard + 1, self.guard), *[(0, 0)] * (usable.ndim - 1)]
        masked = np.cumsum(~np.pad(usable, ends), axis=0)
        return masked[2 * self.guard + 1 :] == masked[: -2 * self.guard - 1]

    def keep(self, usable: np.ndarray) -> np.ndarray:
        """Mark the outputs, (outputs,) or (outputs, n), with no unusable sample, (N,) or (N, n), within ``guard``."""
        return self.near(usable)[self.instants(len(usable))]


@lru_cache
def _kernel(factor: int) -> np.ndarray:
    """Compute the taps of the FIR, preceded by zeros so that its length less one is a multiple of `factor`."""
    from scipy.signal import firwin

    half = ceil(1.5 * factor)
    # beta = 5: side lobes 50 dB down, and a main lobe as narrow as so short a filter allows.
    taps = firwin(2 * half + 1, PASSED / factor, window=("kaiser", 5.0))
    return np.concatenate([np.zeros(-2 * half % factor), taps])


@lru_cache
def _chebyshev(factor: int) -> np.ndarray:
    from scipy.signal import cheby1

    return cheby1(8, 0.05, PASSED / factor, output="sos")


def decimation_factor(rate: float, bandwidth: float, most: int = MAX_FACTOR) -> int:
    """Choose the factor that leaves five samples in a period of the fastest motion.

    ``floor(0.4 rate / (2 bandwidth))``, at least 1 and at most ``most``; both in Hz. The low-pass then cuts off at
    twice the bandwidth.
    """
    return int(min(max(PASSED / 2 * rate // (2 * bandwidth), 1), most))
