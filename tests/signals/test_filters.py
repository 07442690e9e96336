"""Filters have no phase and the gain they say; streamed decimation is that of the whole; masks are exact."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from gtau.estimation.regression.rows import stop
from gtau.signals.preparation.filters import (
    Decimator,
    cutoff_frequency,
    decimation_factor,
    differentiate,
    filter_edge,
    low_pass,
    position_filter,
    smooth_path,
)


def phasor(x: np.ndarray, time: np.ndarray, frequency: float) -> complex:
    """Amplitude and phase of a sampled sine, sin(2 pi f t) being 1."""
    basis = np.column_stack([np.sin(2 * np.pi * frequency * time), np.cos(2 * np.pi * frequency * time)])
    sine, cosine = np.linalg.lstsq(basis, x, rcond=None)[0]
    return complex(sine, cosine)


@pytest.mark.parametrize("frequency", [1.0, 5.0, 20.0])
def test_low_pass_has_its_gain_and_no_phase(frequency: float) -> None:
    rate, cutoff = 1000.0, 10.0
    time = np.arange(8000) / rate
    y = low_pass(np.sin(2 * np.pi * frequency * time)[:, None], rate, cutoff)[2000:-2000, 0]
    # The bilinear transform bends the frequency axis.
    bent = np.tan(np.pi * frequency / rate) / np.tan(np.pi * cutoff / rate)
    assert phasor(y, time[2000:-2000], frequency) == pytest.approx(1 / (1 + bent**8), abs=1e-8)


@pytest.mark.parametrize(("frequency", "rate"), [(1.0, 95.0), (4.0, 95.0), (50.0, 1000.0)])
def test_derivatives_have_no_phase_and_the_error_they_say(frequency: float, rate: float) -> None:
    time = np.arange(2000) / rate
    w = 2 * np.pi * frequency
    first, second = differentiate(np.sin(w * time)[:, None], rate)
    inner = slice(2, -2)
    velocity = phasor(first[inner, 0], time[inner], frequency) / (1j * w)
    acceleration = phasor(second[inner, 0], time[inner], frequency) / -(w**2)
    step = w / rate
    assert velocity == pytest.approx(1 - step**4 / 30, abs=step**6)
    assert acceleration == pytest.approx(1 - step**4 / 90, abs=step**6)


def test_derivatives_of_a_quartic_are_exact() -> None:
    rate = 10.0
    time = np.arange(20) / rate
    x = time**4 - 2 * time**3 + time
    first, second = differentiate(x, rate)
    np.testing.assert_allclose(first[2:-2], (4 * time**3 - 6 * time**2 + 1)[2:-2], atol=1e-10)
    np.testing.assert_allclose(second[2:-2], (12 * time**2 - 12 * time)[2:-2], atol=1e-9)


def test_edges_cover_what_the_filter_does_not_know() -> None:
    rate, cutoff = 1000.0, 20.0
    time = np.arange(6000) / rate
    position = np.sin(2 * np.pi * 1.5 * time + 0.4)[:, None]
    inner, part = position_filter(position, rate, cutoff), slice(1000, 5000)
    (q, qd, qdd), edge = position_filter(position[part], rate, cutoff), filter_edge(rate, cutoff)
    used = slice(edge, -edge)
    for whole, cut, tolerance in zip(inner, (q, qd, qdd), (1e-4, 1e-3, 3e-3), strict=True):
        scale = np.abs(whole[part]).max()
        np.testing.assert_allclose(cut[used], whole[part][used], atol=tolerance * scale)


def test_rules_of_thumb() -> None:
    assert cutoff_frequency(0.3, 20.0, 95.0) == 5.0
    assert cutoff_frequency(7.0, 100.0, 1000.0) == 70.0
    assert cutoff_frequency(7.0, 25.0, 1000.0) == 25.0
    assert cutoff_frequency(7.0, 7.0, 1000.0) == 17.5  # not within the motion
    assert cutoff_frequency(1.0, 2.5, 1000.0, seconds=5.0) == pytest.approx(10.0)  # its ends are then 0.6 s of 5 s
    assert cutoff_frequency(4.0, 36.0, 95.0) is None
    assert cutoff_frequency(13.7, 25.0, 100.0) is None  # not a little below the Nyquist frequency
    assert [decimation_factor(1000, f) for f in (0.1, 12, 100, 400)] == [20, 16, 2, 1]
    assert decimation_factor(1000, 0.5, 400) == 400


KINDS = [
    ("fir", 1),
    ("fir", 2),
    ("fir", 7),
    ("fir", 10),
    ("fir", 20),
    ("chebyshev", 1),
    ("chebyshev", 5),
    ("chebyshev", 10),
]


@pytest.mark.parametrize(("kind", "factor"), KINDS)
def test_streamed_outputs_are_those_of_the_whole(kind: str, factor: int, rng: np.random.Generator) -> None:
    decimator = Decimator(factor, kind)  # type: ignore[arg-type]
    columns = rng.standard_normal((3, 6013))
    whole = decimator.apply(columns)
    instants = decimator.instants(6013)
    assert whole.shape == (3, len(instants))
    blocks = list(decimator.blocks(6013, 37))
    parts = [decimator.apply(columns[:, decimator.samples(outputs, 6013)], outputs) for outputs in blocks]
    np.testing.assert_allclose(np.hstack(parts), whole, atol=1e-15 if kind == "fir" else 1e-12)
    assert [outputs.start for outputs in blocks] == list(range(0, len(instants), 37))
    numbers = np.arange(6013)
    places = [numbers[decimator.samples(outputs, 6013)][decimator.at(outputs)] for outputs in blocks]
    np.testing.assert_array_equal(np.concatenate(places), instants)
    usable = rng.random((6013, 2)) > 1e-3
    kept = [decimator.keep(usable[decimator.samples(outputs, 6013)], outputs) for outputs in blocks]
    np.testing.assert_array_equal(np.concatenate(kept), decimator.keep(usable))


def test_a_log_too_short_has_no_outputs() -> None:
    decimator = Decimator(10)
    assert list(decimator.blocks(30, 8)) == []
    assert decimator.apply(np.ones((2, 30))).shape == (2, 0)
    assert decimator.keep(np.ones(30, dtype=bool)).shape == (0,)
    assert decimator.apply(np.ones((2, 31))).shape == (2, 1)


@pytest.mark.parametrize("factor", [2, 3, 10, 20])
def test_fir_is_a_symmetric_convolution_of_unit_gain(factor: int, rng: np.random.Generator) -> None:
    decimator = Decimator(factor)
    x = rng.standard_normal(1000)
    impulse = np.zeros((2 * decimator.support + 1, 2 * decimator.support + 1))
    np.fill_diagonal(impulse, 1.0)
    taps = decimator.apply(impulse)[:, 0]
    np.testing.assert_allclose(taps, taps[::-1], atol=1e-16)
    assert taps.sum() == pytest.approx(1, abs=1e-14)
    assert np.all(taps != 0)
    np.testing.assert_allclose(decimator.apply(x), np.convolve(x, taps, "valid")[::factor], atol=1e-14)


@pytest.mark.parametrize("kind", ["fir", "chebyshev"])
def test_decimation_has_no_phase_and_removes_what_would_alias(kind: str) -> None:
    decimator = Decimator(10, kind)  # type: ignore[arg-type]
    time = np.arange(20000) / 1000.0
    kept = decimator.instants(20000)
    inner = slice(50, -50)
    for frequency, bound in ((2.0, None), (10.0, None), (101.3, 0.005), (333.3, 0.005)):
        y = decimator.apply(np.sin(2 * np.pi * frequency * time))
        response = phasor(y[inner], time[kept][inner], frequency)
        if bound is None:
            assert abs(response.imag) < 1e-8
            assert 0.5 < response.real < 1.001
        else:
            assert np.abs(y[inner]).max() < bound


def test_chebyshev_is_the_decimate_of_scipy(rng: np.random.Generator) -> None:
    x = rng.standard_normal((2, 5000))
    decimator = Decimator(10, "chebyshev")
    expected = signal.decimate(x, 10, axis=-1)  # its outputs stand at 0, 10, ...; ours at 10, 20, ...
    outputs = decimator.apply(x)
    np.testing.assert_allclose(outputs, expected[:, 1 : 1 + outputs.shape[1]], atol=1e-13)


@pytest.mark.parametrize(("kind", "factor"), KINDS)
def test_mask_covers_what_counts_of_the_filter(kind: str, factor: int) -> None:
    decimator = Decimator(factor, kind)  # type: ignore[arg-type]
    n = 400
    instants = decimator.instants(n)
    for bad in (0, 57, 200, 399):
        usable = np.ones((n, 2), dtype=bool)
        usable[bad, 1] = False
        kept = decimator.keep(usable)
        assert kept[:, 0].all()
        np.testing.assert_array_equal(kept[:, 1], np.abs(instants - bad) > decimator.guard)
        assert decimator.guard == (0 if factor == 1 else factor)


@pytest.mark.parametrize("factor", [2, 3, 7, 20, 100])
def test_what_the_mask_leaves_of_unusable_samples_weighs_little(factor: int) -> None:
    decimator = Decimator(factor)
    n = 6 * factor + 1
    outputs = decimator.apply(np.eye(n))  # weights of every sample in every output
    far = np.abs(np.arange(n)[:, None] - decimator.instants(n)) > decimator.guard
    assert np.abs(np.where(far, outputs, 0.0)).sum(axis=0).max() < 0.02
    assert np.abs(np.where(far, outputs, 0.0)).sum(axis=0).min() > 0.0


def test_a_smooth_path_turns_nowhere_but_where_the_joint_does(rng: np.random.Generator) -> None:
    """A joint that stops at once rests there: a low-pass that swings would take its friction through a reversal."""
    rate, cutoff, time = 500.0, 5.0, np.arange(2000) / 500.0
    q = np.interp(time, [0, 1, 2, 3, 4], [0.0, 0.3, 0.3, 0.8, 0.8])[:, None]
    path = smooth_path(q, rate, cutoff, 0, len(q))
    assert (np.diff(path, axis=0) >= -1e-12).all()
    swinging = low_pass(q, rate, cutoff)
    resting, widths = (time > 1.4) & (time < 1.6), np.array([2e-3])
    assert np.allclose(stop(path[:, 0], widths, np.zeros(1))[0, resting], 1.0)
    assert (stop(swinging[:, 0], widths, np.zeros(1))[0, resting] < 0.6).all()


def test_a_smooth_path_has_its_gain_and_no_phase_and_is_the_same_in_blocks() -> None:
    rate, cutoff, time = 500.0, 5.0, np.arange(4000) / 500.0
    q = np.sin(2 * np.pi * cutoff * time)[:, None]
    path = smooth_path(q, rate, cutoff, 0, len(q))
    np.testing.assert_allclose(path[1000:-1000], np.sqrt(0.5) * q[1000:-1000], atol=2e-4)
    parts = [smooth_path(q, rate, cutoff, k, k + 1000) for k in range(0, 4000, 1000)]
    np.testing.assert_allclose(np.concatenate(parts), path, atol=1e-12)
    np.testing.assert_array_equal(smooth_path(q, rate, None, 5, 9), q[5:9])
