"""The columns of a channel's equations, and the triangular factors of their rows.

Rows of runs, their factors and the blocks of the problem all end in the same four columns,

    [ model | known | v  v'  v'' ]

behind those of the model: of standard parameters and friction terms along a run, of the unknown ``theta`` in the
problem. ``known`` is the known torque added to that of the model; v is the signal with two time
derivatives.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

MODEL, KNOWN, SIGNAL, SIGNALS = slice(None, -4), -4, -3, slice(-3, None)
FIXED = 4  # columns behind those of the model
BLOCKS = 20  # of a run, which the jackknife leaves out in turn

ROWS = 1024  # reduced at once: few enough to stay in the cache


def delayed(d: float | np.ndarray) -> np.ndarray:
    """Compute the weights of v, v', v'' that make ``v(t - d)``, (..., 3)."""
    return np.stack([np.ones_like(d, dtype=float), -np.asarray(d), np.square(d) / 2], axis=-1)


def delayed_signal(rows: np.ndarray, d: float | np.ndarray) -> np.ndarray:
    """Compute the signal ``v(t - d)`` in rows (..., p, columns), (..., p); ``d`` is one delay or one a channel."""
    return np.asarray(np.einsum("...pk,...k->...p", rows[..., SIGNALS], delayed(d)))


def modelled(rows: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Compute the torques of parameters in rows (..., p, columns), the known part included, (..., p)."""
    return np.asarray(rows[..., MODEL] @ theta + rows[..., KNOWN])


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


def select_columns(R: np.ndarray, columns: Sequence[int]) -> np.ndarray:
    """Compute the triangular factor of some ``columns``, in order, of the rows with the triangular factor ``R``."""
    same = next((k for k, column in enumerate(columns) if column != k), len(columns))  # triangular as they are
    rest = triangle(R[same:, columns[same:]])
    found = np.zeros((len(R[:same]) + len(rest), len(columns)))
    found[:same], found[same:, same:] = R[:same, columns], rest
    return found


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
