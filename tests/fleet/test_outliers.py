"""Outliers of a fleet: rates of false alarms, and what the deviations of the values do."""

from __future__ import annotations

import numpy as np
import pytest

from gtau.fleet.gains import LEAST, distances

JOINTS = 3


def found(values: np.ndarray, std: np.ndarray, tests: int = 0):
    return distances(values, std, np.full(len(values), 39.0), tests or len(values))


@pytest.mark.parametrize("spread", [0.0, 0.5, 5.0])
def test_a_fleet_without_outliers_seldom_shows_one(rng: np.random.Generator, spread: float) -> None:
    alarms, fleets, n = 0, 200, 30
    for _ in range(fleets):
        sigma = rng.uniform(0.5, 2.0, (JOINTS, n))
        std = sigma * np.sqrt(rng.chisquare(39, sigma.shape) / 39)
        values = 100 + np.hypot(sigma, spread) * rng.standard_normal(sigma.shape)
        alarms += any(found(v, s, JOINTS * n).outlier.any() for v, s in zip(values, std, strict=True))
    assert alarms < 0.1 * fleets  # a rate of 0.05 gives more with a chance of 1e-3


def test_spread_and_median_are_recovered_with_a_third_wrong(rng: np.random.Generator) -> None:
    sigma = rng.uniform(0.5, 2.0, 3000)
    values = 100 + np.hypot(sigma, 3.0) * rng.standard_normal(3000)
    values[:1000] += rng.choice([-300, 300], 1000)
    result = found(values, sigma)
    assert result.median == pytest.approx(100, abs=4 * result.median_std)
    assert 3.0 < result.spread < 7.0  # the wrong third widens the quartiles, and no more
    assert result.outlier[:1000].all()


def test_the_standard_deviation_of_the_median_is_its_scatter(rng: np.random.Generator) -> None:
    sigma = rng.uniform(0.5, 2.0, 40)
    results = [found(np.hypot(sigma, 1.0) * rng.standard_normal(40), sigma) for _ in range(300)]
    scatter = np.std([each.median for each in results])
    assert scatter == pytest.approx(np.mean([each.median_std for each in results]), rel=0.15)


def test_a_value_of_large_standard_deviation_is_no_outlier() -> None:
    values, std = np.zeros(20) + 0.01 * np.arange(20), np.full(20, 0.05)
    values[7] = 1.0
    assert np.flatnonzero(found(values, std).outlier).tolist() == [7]
    std[7] = 0.5
    assert not found(values, std).outlier.any()


def test_units_do_not_matter(rng: np.random.Generator) -> None:
    values, std = rng.standard_normal(20), rng.uniform(0.1, 1, 20)
    assert found(1e6 * values, 1e6 * std).z == pytest.approx(found(values, std).z)
    assert found(-values, std).z == pytest.approx(-found(values, std).z)


def test_few_values_have_no_outliers() -> None:
    for n in (1, 2, LEAST - 1, LEAST):
        values = np.zeros(n)
        values[-1] = 1e3
        assert found(values, np.ones(n)).outlier.any() == (n == LEAST)


def test_equal_values_known_exactly() -> None:
    result = found(np.full(10, 2.0), np.zeros(10))
    assert (result.median, result.spread) == (2.0, 0.0)
    assert not result.outlier.any()
