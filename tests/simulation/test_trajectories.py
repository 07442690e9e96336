"""Moves through given points."""

from __future__ import annotations

from itertools import cycle

import numpy as np

from gtau.simulation.trajectories import Envelope, through


def test_moves_pass_the_points_at_rest() -> None:
    within = Envelope(np.array([1.0, -0.5]), np.array([2.0, 0.1]), np.array([3.0, 1.0]), np.array([20.0, 5.0]))
    targets = [np.array([1.0, 0.0]), np.array([1.0, -1.0])]
    motion = through(within, 10.0, cycle(targets), rest=0.3)
    assert len(motion.starts) > 6
    for k, (start, span) in enumerate(zip(motion.starts, motion.spans, strict=True)):
        resting = np.array([start + span, start + span + 0.29])
        q, qd, qdd = motion(resting)
        assert np.allclose(q, within.center + within.reach * targets[k % 2])
        assert np.allclose([qd, qdd], 0.0, atol=1e-9)
    assert motion.starts[-1] + motion.spans[-1] <= 10.0
    _, qd, qdd = motion(np.arange(0.0, 10.0, 1e-3))
    used = np.maximum(np.abs(qd).max(axis=0) / within.velocity, np.abs(qdd).max(axis=0) / within.acceleration)
    assert 0.99 < used.max() < 1.001
