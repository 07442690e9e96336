"""The bandwidth of a motion is found whatever noise its position has, and rest is told from motion."""

from __future__ import annotations

import numpy as np
import pytest

from gtau.errors import GtauError
from gtau.signals.preparation.bandwidth import choose_preparation, spectra
from gtau.signals.run import SEGMENT, Run

LINES = np.array([0.1, 0.2, 0.3, 0.5, 0.8])  # Hz


def run_of(position: np.ndarray, rate: float) -> Run:
    joints = tuple(f"j{i}" for i in range(position.shape[1]))
    return Run("r", joints, np.arange(len(position)) / rate, position, np.ones_like(position))


def motion(time: np.ndarray) -> np.ndarray:
    """A periodic exciting motion of 0.1 to 0.8 Hz, rad."""
    return sum(np.sin(2 * np.pi * f * time + 7 * f) / (1 + 10 * f) for f in LINES)


def noisy(kind: str, rate: float, rng: np.random.Generator) -> np.ndarray:
    """The motion (N, 1) with noise of a kind."""
    time = np.arange(int(40 * rate)) / rate
    white = rng.standard_normal(time.size)
    if kind == "white":
        return (motion(time) + 1e-3 * white)[:, None]
    if kind == "12 bits":
        quantum = 2 * np.pi / 4096
        return (np.round(motion(time) / quantum) * quantum)[:, None]
    if kind == "jitter":
        return motion(time + 0.3 / rate * white)[:, None]
    if kind == "stale":
        q = motion(time)
        stale = np.flatnonzero(rng.random(time.size - 1) < 0.05) + 1
        q[stale] = q[stale - 1]
        return q[:, None]
    if kind == "filtered":  # noise of an anti-aliasing filter: above its cut-off it falls faster than f^4
        from scipy.signal import butter, sosfiltfilt

        return (motion(time) + sosfiltfilt(butter(4, 0.3 * rate, fs=rate, output="sos"), 1e-3 * white))[:, None]
    return motion(time)[:, None]


@pytest.mark.parametrize("rate", [20.0, 100.0, 1000.0, 4000.0])
@pytest.mark.parametrize("kind", ["none", "white", "12 bits", "jitter", "stale", "filtered"])
def test_the_bandwidth_is_that_of_the_motion(kind: str, rate: float, rng: np.random.Generator) -> None:
    (spectrum,) = spectra(run_of(noisy(kind, rate, rng), rate))
    assert spectrum.moves
    assert 0.75 < spectrum.bandwidth < 1.0
    assert spectrum.end > 0.8


def test_a_hump_of_noise_above_the_valley_is_no_motion() -> None:
    rate = 200.0
    time = np.arange(6000) / rate
    beat = 3e-3 * np.sin(2 * np.pi * 45 * time) * motion(time + 0.1)  # polling beats: 8 % of the speed's power
    share = np.var(np.diff(beat)) / np.var(np.diff(motion(time)))
    assert share > 0.01
    (spectrum,) = spectra(run_of((motion(time) + beat * np.sqrt(0.01 / share))[:, None], rate))
    assert spectrum.bandwidth < 1.0


def test_a_chirp_ends_where_it_ends(rng: np.random.Generator) -> None:
    from scipy.signal import chirp

    rate = 200.0
    time = np.arange(int(20 * rate)) / rate
    position = 0.3 * chirp(time, 0.1, 20, 10.0) + 2e-4 * rng.standard_normal(time.size)
    (spectrum,) = spectra(run_of(position[:, None], rate))
    assert spectrum.bandwidth == pytest.approx(10, rel=0.1)


def test_a_harmonic_far_above_the_others_is_motion(rng: np.random.Generator) -> None:
    rate = 1000.0
    time = np.arange(20000) / rate
    position = np.sin(2 * np.pi * 0.3 * time) + 0.02 * np.sin(2 * np.pi * 6 * time) + 1e-5 * rng.standard_normal(20000)
    (spectrum,) = spectra(run_of(position[:, None], rate))
    assert spectrum.bandwidth == pytest.approx(6, abs=0.3)  # a line is as wide as the window makes it


def test_rest_is_told_from_motion(rng: np.random.Generator) -> None:
    rate, samples = 95.0, 4000
    time = np.arange(samples) / rate
    drift = 1e-4 * np.round(0.5 + 0.4 * rng.standard_normal(samples) + np.sin(0.1 * time))
    shaken = 3e-4 * np.sin(2 * np.pi * 1.3 * time) + 1e-4 * rng.standard_normal(samples)
    joints = spectra(run_of(np.column_stack([motion(time), drift, shaken, np.full(samples, 0.1)]), rate))
    assert [joint.moves for joint in joints] == [True, False, False, False]
    assert np.isnan(joints[1].bandwidth)
    with pytest.raises(GtauError, match="no joint's motion exceeds its position noise"):
        choose_preparation([run_of(np.column_stack([drift, shaken]), rate)])


def test_a_long_log_has_the_bandwidth_of_its_parts(rng: np.random.Generator) -> None:
    rate = 1000.0
    time = np.arange(3 * SEGMENT // 2) / rate
    position = (motion(time) + 1e-5 * rng.standard_normal(time.size))[:, None]
    (whole,), (part,) = spectra(run_of(position, rate)), spectra(run_of(position[: SEGMENT // 2], rate))
    assert whole.bandwidth == pytest.approx(part.bandwidth, abs=0.05)
