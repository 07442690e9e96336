"""Accelerations integrated twice, block by block."""

from __future__ import annotations

import numpy as np
import pytest

from gtau.signals.dead_reckoning import DeadReckoning


def test_blocks_are_the_whole_and_positions_those_of_their_accelerations(rng: np.random.Generator) -> None:
    time = np.cumsum(rng.uniform(0.004, 0.006, 2000))
    w = np.array([2.0, 5.0, 9.0])
    a = -(w**2) * np.sin(w * time[:, None])
    whole = DeadReckoning().positions(time, a)
    pieces = DeadReckoning()
    blocks = zip(np.split(time, [7, 7, 900]), np.split(a, [7, 7, 900]), strict=True)
    parts = [pieces.positions(*each) for each in blocks]
    assert np.concatenate(parts) == pytest.approx(whole, abs=1e-12)
    exact = np.sin(w * time[:, None])
    start, speed = exact[0], w * np.cos(w * time[0])
    assert whole == pytest.approx(exact - start - speed * (time - time[0])[:, None], abs=2e-2)


def test_a_missing_sample_repeats_the_one_before() -> None:
    time, a = np.arange(6.0), np.ones((6, 3))
    a[3] = np.nan
    assert DeadReckoning().positions(time, a)[:, 0] == pytest.approx(time**2 / 2)
