"""Quantiles of numbers that go by."""

from __future__ import annotations

import numpy as np

COARSE = 44  # last bits of a float that do not count: bins 0.4 % wide


class Quantiles:
    """Counts of numbers >= 0 in bins 0.4 % wide, a row of them for each column.

    The bits of positive floats, read as an integer, stand in the order of the floats.
    """

    def __init__(self, columns: int):
        self._counts = np.zeros((columns, 1 << (63 - COARSE)), dtype=np.int64)

    def add(self, values: np.ndarray) -> None:
        """Count values (M, columns)."""
        bins = np.ascontiguousarray(values.T).view(np.int64) >> COARSE
        for counts, mine in zip(self._counts, bins, strict=True):
            low = int(mine.min(initial=len(counts) - 1))
            found = np.bincount(mine - low)
            counts[low : low + len(found)] += found

    def quantile(self, share: float) -> np.ndarray:
        """Values (columns,), to 0.4 %, below which a share of the numbers lies."""
        held = np.cumsum(self._counts, axis=1)
        found = np.argmax(held >= share * held[:, -1:], axis=1)
        return (found.astype(np.int64) << COARSE).view(float)
