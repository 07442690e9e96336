"""Detectors of a change: the closed form against matrices, run lengths against tables and simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gtau.watch import detectors
from gtau.watch.detectors import KAPPA, MEMORY, Chart, add, combined, cusum_limit, evidence, run_length


def chart_of(values: np.ndarray, learning: int, weights: np.ndarray | None = None) -> Chart:
    chart = Chart(learning)
    for k, value in enumerate(values):
        chart = add(chart, float(value), 1.0 if weights is None else float(weights[k]))
    return chart


def by_matrices(x: np.ndarray, weights: np.ndarray, learning: int) -> float:
    """The e-detector from the definition: generalised least squares with the covariance written out."""
    n = len(x)
    root = np.sqrt(weights)
    V = MEMORY ** np.abs(np.subtract.outer(np.arange(n), np.arange(n))) * root * root[:, None]
    white = np.linalg.inv(np.linalg.cholesky(V))
    y, h = white @ x, white @ np.ones(n)
    S0, total = y @ y - (h @ y) ** 2 / (h @ h), 0.0
    for j in range(learning, n):
        step = white @ (np.arange(n) >= j).astype(float)
        step = step - h * (h @ step) / (h @ h)
        r = step @ step
        left = S0 - (step @ y) ** 2 / r * r * KAPPA**2 / (1 + r * KAPPA**2)
        total += (1 + r * KAPPA**2) ** -0.5 * (S0 / left) ** ((n - 1) / 2)
    return float(np.log(total))


def test_the_closed_form_is_that_of_the_definition(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    x, weights = rng.normal(size=40), rng.uniform(1.0, 9.0, 40)
    for n in (7, 12, 40):
        chart = chart_of(x[:n], 6, weights[:n])
        assert evidence(chart).log_e == pytest.approx(by_matrices(x[:n], weights[:n], 6), rel=1e-9)
    moved = evidence(chart_of(3.0 + 1e-3 * x, 6, weights))  # neither the mean nor the scale matters
    assert moved.log_e == pytest.approx(evidence(chart_of(x, 6, weights)).log_e, rel=1e-6)
    # condensed: the same sums, but changes are sought among the last logs only
    monkeypatch.setattr(detectors, "WINDOW", 16)
    short = chart_of(x, 6, weights)
    assert len(short.x) <= 20
    assert evidence(short).log_e == pytest.approx(by_matrices(x, weights, 40 - len(short.x)), rel=1e-9)


def test_run_lengths_of_a_cusum_are_those_of_the_tables() -> None:
    # Montgomery, Introduction to Statistical Quality Control, table 9.3: k = 1/2, two-sided
    for limit, healthy, shifted in ((4.0, 168.0, 8.38), (5.0, 465.0, 10.4)):
        assert run_length(limit) / 2 == pytest.approx(healthy, rel=0.02)
        assert run_length(limit, shift=1.0) == pytest.approx(shifted, rel=0.02)
        assert cusum_limit(run_length(limit) / 2) == pytest.approx(limit, rel=1e-6)


@pytest.mark.parametrize("memory", [0.0, MEMORY])
def test_false_alarms_come_no_sooner_than_stated(memory: float, rng: np.random.Generator) -> None:
    stated, lengths = 12.0, []
    for _ in range(50):
        charts, u = [Chart(8)] * 2, rng.normal(size=2)
        for t in range(1, 108):
            charts = [add(chart, float(value)) for chart, value in zip(charts, u, strict=True)]
            u = memory * u + np.sqrt(1 - memory**2) * rng.normal(size=2)
            if t > 8 and combined(np.array([evidence(chart).log_e for chart in charts])) >= np.log(stated):
                break
        lengths.append(t - 8)  # cut at 99, which makes the mean smaller
    mean, error = np.mean(lengths), np.std(lengths) / np.sqrt(len(lengths))
    assert mean - 2 * error > stated


def test_a_shift_is_found_and_dated(rng: np.random.Generator) -> None:
    x = rng.normal(size=24)
    x[20:] += 8.0
    found = evidence(chart_of(x, 10))
    assert found.log_e > np.log(1e4)
    assert found.start == 20
    assert found.earliest <= 20 <= found.latest
    assert max(chart_of(x, 10).cusum) > cusum_limit(1e3)
    falling = chart_of(-x, 10)
    assert evidence(falling).log_e == pytest.approx(found.log_e)
    assert evidence(replace(falling, rising=True)).log_e < 3.0  # of a residual only growth counts
    assert evidence(chart_of(np.full(24, 2.5), 10)).start is None  # a chart without any scatter says nothing
