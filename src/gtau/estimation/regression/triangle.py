"""The triangular factor, the statistic that all estimators work on."""

from __future__ import annotations

import numpy as np

ROWS = 1024  # reduced at once: few enough to stay in the cache


def triangle(*blocks: np.ndarray) -> np.ndarray:
    """Compute the triangular factor R (min(r, c), c) of the stacked ``blocks`` (., c): ``R^T R = A^T A``.

    Of triangular factors it is the factor of all the rows behind them.
    """
    stacked = blocks[0] if len(blocks) == 1 else np.concatenate(blocks)
    height = max(ROWS, 4 * stacked.shape[1])
    R = np.linalg.qr(stacked[:height], mode="r")
    for start in range(height, len(stacked), height):
        R = np.linalg.qr(np.concatenate([R, stacked[start : start + height]]), mode="r")
    return np.asarray(R)


def leave_one_out(factors: list[np.ndarray]) -> list[np.ndarray]:
    """Merge all but each one of the triangular ``factors``, each (., c), by running merges."""
    empty = np.zeros((0, factors[0].shape[1]))

    def running(parts: list[np.ndarray]) -> list[np.ndarray]:
        merged = [empty]
        for part in parts[:-1]:
            merged.append(triangle(merged[-1], part))
        return merged

    ahead, behind = running(factors), running(factors[::-1])[::-1]
    return [triangle(a, b) for a, b in zip(ahead, behind, strict=True)]
