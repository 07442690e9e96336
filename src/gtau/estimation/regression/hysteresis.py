"""Hysteresis of a path: elements that bend before they slide."""

from __future__ import annotations

import numpy as np


def stop(q: np.ndarray, widths: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Follow positions by elements of some widths: friction before sliding (Prandtl and Ishlinskii; Maxwell slip).

    An element of width ``w`` holds ``z``, between -1 and 1: ``z <- clip(z + dq / w, -1, 1)``. It is a spring as long
    as the joint stays within ``w`` of where it stopped, and slips beyond, where ``z = sign(dq)``. Neither rate nor
    noise of the speed matters. Between its turning points a path is monotone, and ``z`` has a closed form.

    From positions ``q`` (N,) in the unit of the ``widths`` (w,) and states ``start`` (w,) at the first one it returns
    the states (w, N).
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


def _turns(step: np.ndarray) -> np.ndarray:
    """Find the reversals of a path that may rest: at rest it keeps the direction of its last step."""
    moved = np.flatnonzero(step)
    return moved[1:][step[moved[1:]] * step[moved[:-1]] < 0]
