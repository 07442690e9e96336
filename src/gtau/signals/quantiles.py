"""Quantiles of numbers that go by."""

from __future__ import annotations

from collections.abc import Callable, Iterable

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
        """Compute values (columns,), to 0.4 %, below which a share of the numbers lies."""
        held = np.cumsum(self._counts, axis=1)
        found = np.argmax(held >= share * held[:, -1:], axis=1)
        return _least(found)

    def around_median(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Find for each column the bins with the middle numbers, from a least number to before another, NaN left out.

        With how many numbers there are, and how many below.
        """
        held = np.cumsum(self._counts[:, : int(np.array(np.inf).view(np.int64) >> COARSE) + 1], axis=1)
        count = held[:, -1]
        first, last = (np.argmax(held > k[:, None], axis=1) for k in ((count - 1) // 2, count // 2))
        below = np.where(first > 0, np.take_along_axis(held, np.maximum(first - 1, 0)[:, None], axis=1)[:, 0], 0)
        return _least(first), _least(last + 1), count, below


def medians(parts: Callable[[], Iterable[np.ndarray]]) -> np.ndarray:
    """Compute medians of the columns of numbers >= 0 in ``parts()`` (., columns), in two passes; NaN is left out."""
    counts = None
    for part in parts():
        counts = Quantiles(part.shape[1]) if counts is None else counts
        counts.add(part)
    if counts is None:
        raise ValueError("there are no numbers")
    least, most, count, below = counts.around_median()
    middle: list[list[np.ndarray]] = [[] for _ in least]
    for part in parts():
        for of, column, low, high in zip(middle, part.T, least, most, strict=True):
            of.append(column[(column >= low) & (column < high)])
    found = []
    for of, total, lower in zip(middle, count.tolist(), below.tolist(), strict=True):
        inside = np.sort(np.concatenate(of))
        found.append(inside[[(total - 1) // 2 - lower, total // 2 - lower]].mean() if total else np.nan)
    return np.array(found)


def _least(bins: np.ndarray) -> np.ndarray:
    """Find the least number in each bin."""
    return (bins.astype(np.int64) << COARSE).view(float)
