"""Piecewise linear functions, as columns of hats."""

from __future__ import annotations

import numpy as np


def hats(x: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Evaluate the hats at ``knots`` (m, n), evenly spaced, along values (N, n) of n joints: (m, n, N)."""
    width = np.maximum(knots[1] - knots[0], 1e-300)
    return np.maximum(0.0, 1 - np.abs(x.T[None] - knots[:, :, None]) / width[None, :, None])
