"""How far samples are from a smooth motion through their neighbours."""

from __future__ import annotations

import numpy as np

REACH = 2  # samples to either side of which a prediction is made
# Standard deviation of a sample's distance from the cubic through its four neighbours, at a regular rate, in standard
# deviations of white noise: sqrt(1 + 2 (4^2 + 1) / 36).
WHITE = 1.394


def cubic_residuals(instants: np.ndarray, position: np.ndarray, period: float) -> np.ndarray:
    """Compute how far positions are from the cubics through two neighbours on either side.

    Parameters
    ----------
    instants : ndarray
        (N,) Times of the samples, s.
    position : ndarray
        (N, n) Positions, rad or m.
    period : float
        Usual step, s.

    Returns
    -------
    ndarray
        (N - 4, n) Of all samples but the first two and the last two.
    """
    around = [slice(k, len(position) - 2 * REACH + k) for k in (0, 1, 3, 4)]
    apart = np.array([instants[each] for each in around]) - instants[REACH:-REACH]
    apart += 1e-9 * period * np.array([-2, -1, 1, 2])[:, None]  # stamps that are the same
    predicted = np.zeros_like(position[REACH:-REACH])
    for a, at in enumerate(around):
        weight = np.prod([apart[b] / (apart[b] - apart[a]) for b in range(4) if b != a], axis=0)
        predicted += weight[:, None] * position[at]
    return np.asarray(position[REACH:-REACH] - predicted)
