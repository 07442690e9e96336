"""The triangular factor, the statistic that all estimators work on."""

from __future__ import annotations

import numpy as np


def triangle(*blocks: np.ndarray) -> np.ndarray:
    """Triangular factor R (min(r, c), c) of the stacked ``blocks`` (., c): ``R^T R = A^T A``.

    Of triangular factors it is the factor of all the rows behind them.
    """
    stacked = blocks[0] if len(blocks) == 1 else np.concatenate(blocks)
    return np.asarray(np.linalg.qr(stacked, mode="r"))


def leave_one_out(factors: list[np.ndarray]) -> list[np.ndarray]:
    """Merged triangular factor of all but each one of ``factors``, each (., c), from running merges."""
    empty = np.zeros((0, factors[0].shape[1]))

    def running(parts: list[np.ndarray]) -> list[np.ndarray]:
        merged = [empty]
        for part in parts[:-1]:
            merged.append(triangle(merged[-1], part))
        return merged

    ahead, behind = running(factors), running(factors[::-1])[::-1]
    return [triangle(a, b) for a, b in zip(ahead, behind, strict=True)]
