"""The motion of the whole tree along a window at every sample, made once for all hypotheses that need it."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from gtau.estimation.regression.rows import Labels
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.loops import Motion
from gtau.signals.preparation import InMemoryRun


@lru_cache(maxsize=2)  # hypotheses are tried window by window
def window_motion(model: InverseDynamics, window: InMemoryRun) -> Motion:
    """Compute configurations, velocities and accelerations of a ``model`` along a window.

    Raises
    ------
    GtauError
        Where the loops cannot be closed at a sample, or a pose is too close to a singularity.
    """
    return shifted_motion(model, window, None, None)


def shifted_motion(
    model: InverseDynamics, window: InMemoryRun, shift: np.ndarray | None, start: np.ndarray | None
) -> Motion:
    """Shift a motion by ``shift`` (n,), from a configuration ``start`` (n_c,) near the first one."""
    of = window.samples()
    labels = Labels(window.run.name, of.time)
    q, qd, qdd = (np.ascontiguousarray(each.T) for each in (of.q if shift is None else of.q + shift, of.qd, of.qdd))
    return model.rates(model.path(q, labels, start), qd, qdd, labels)
