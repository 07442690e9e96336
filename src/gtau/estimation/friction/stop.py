"""The stop operator: friction before sliding, driven by position (Prandtl and Ishlinskii; the Maxwell slip element).

An element of width ``w`` holds ``z``, between -1 and 1: ``z <- clip(z + dq / w, -1, 1)``. It is a spring as long as the
joint stays within ``w`` of where it stopped, and slips beyond, where ``z = sign(dq)``. It does not depend on time, so
that neither rate nor noise of the speed matters; a position rounded by an encoder is a path like any other.
"""

from __future__ import annotations

import numpy as np


def stop(q: np.ndarray, widths: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Follow positions by elements of some widths.

    Between its turning points a path is monotone, and ``z`` has a closed form there: only those are visited one by one.

    Parameters
    ----------
    q : ndarray (N,)
        Positions, rad or m.
    widths : ndarray (w,)
        Widths, in the same unit.
    start : ndarray (w,)
        States at the first position.

    Returns
    -------
    ndarray (w, N)
        States at every position; the first are ``start``.
    """
    step = np.sign(np.diff(q))
    turns = np.flatnonzero(step[1:] * step[:-1] < 0) + 1 if step.all() else _turns(step)
    edges = np.concatenate([[0], turns, [len(q) - 1]])
    states = np.empty((len(edges), len(widths)))
    states[0] = start
    ways = np.diff(q[edges])[:, None] / widths
    for k, way in enumerate(ways):
        states[k + 1] = np.minimum(np.maximum(states[k] + way, -1.0), 1.0)
    stretch = np.searchsorted(turns, np.arange(len(q)), side="right")
    way = (q - q[edges[stretch]]) / widths[:, None]
    return np.clip(states[stretch].T + way, -1.0, 1.0)


class Follower:
    """Elements of some widths along a path in blocks, which may overlap: states continue from block to block.

    They begin at 0: where a joint rests, nothing says which way it came, and one that moves slips after its width.
    """

    def __init__(self, widths: np.ndarray) -> None:
        self._widths, self._time, self._states = widths, np.zeros(0), np.zeros((len(widths), 0))

    def __call__(self, time: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Follow positions (N,) at times (N,), s: states (w, N)."""
        known = int(np.searchsorted(self._time, time[0]))
        start = self._states[:, known] if known < len(self._time) else np.zeros(len(self._widths))
        self._time, self._states = time, stop(q, self._widths, start)
        return self._states


def _turns(step: np.ndarray) -> np.ndarray:
    """Find the reversals of a path that may rest: at rest it keeps the direction of its last step."""
    moved = np.flatnonzero(step)
    return moved[1:][step[moved[1:]] * step[moved[:-1]] < 0]
