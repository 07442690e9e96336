"""Positions from accelerations by integration: they drift, but the model looks at their accelerations alone."""

from __future__ import annotations

import numpy as np


class DeadReckoning:
    """Integrates accelerations block by block, from rest at the origin.

    Between samples the acceleration changes linearly; one that is missing repeats the one before.
    """

    def __init__(self) -> None:
        self._time: float | None = None
        self._a, self._v, self._p = np.zeros((3, 3))

    def positions(self, time: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Compute the next positions (M, 3), m, from accelerations ``a`` (M, 3), m/s2, at ``time`` (M,), s."""
        if not len(time):
            return np.zeros((0, 3))
        missing = ~np.isfinite(a).all(axis=1)
        last = np.maximum.accumulate(np.where(missing, 0, np.arange(len(a)) + 1))
        a = np.vstack([self._a, a])[last]
        before = np.nan if self._time is None else self._time
        step = np.nan_to_num(np.diff(time, prepend=before))[:, None]
        earlier = np.vstack([self._a if self._time is not None else a[0], a[:-1]])
        v = self._v + np.cumsum((earlier + a) / 2 * step, axis=0)
        p = self._p + np.cumsum(np.vstack([self._v, v[:-1]]) * step + (2 * earlier + a) / 6 * step**2, axis=0)
        known = np.isfinite(time)
        if known.any():
            self._time = float(time[known][-1])
        self._a, self._v, self._p = a[-1], v[-1], p[-1]
        return p
