"""Moves between random points, and through given ones."""

from __future__ import annotations

import numpy as np
import pytest

from gtau.simulation.trajectories import Envelope, moves_through, point_to_point

WITHIN = Envelope(np.zeros(2), np.ones(2), np.array([1.0, 2.0]), np.array([4.0, 8.0]))


def test_moves_pass_their_points_with_a_rest_at_each() -> None:
    points = np.array([[0.0, 0.0], [1.0, 0.5], [-1.0, 0.0]])
    motion = moves_through(points, WITHIN, 0.3)
    for k, end in enumerate(motion.starts + motion.spans):
        q, qd, _ = motion(np.array([end, end + 0.25]))
        assert q == pytest.approx(np.tile(points[k + 1], (2, 1)))
        assert np.abs(qd).max() < 1e-9
    q, qd, qdd = motion(np.linspace(0.0, motion.starts[-1] + motion.spans[-1], 5000))
    assert np.all(np.abs(qd).max(axis=0) <= WITHIN.velocity * 1.001)
    assert np.all(np.abs(qdd).max(axis=0) <= WITHIN.acceleration * 1.001)


def test_random_moves_fill_a_duration_and_are_the_same_of_the_same_seed() -> None:
    motion, again = (point_to_point(WITHIN, 20.0, np.random.default_rng(3)) for _ in range(2))
    assert np.array_equal(motion.points, again.points)
    assert 15.0 < motion.starts[-1] + motion.spans[-1] <= 20.0
    assert np.abs(motion.points).max() <= 1.0
    assert len(point_to_point(WITHIN, 0.1, np.random.default_rng(3)).spans) == 1
