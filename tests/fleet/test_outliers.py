"""Outliers of a fleet: rates of false alarms, and what the deviations of the values do."""

from __future__ import annotations

import numpy as np
import pytest

from gtau.fleets.table import LEAST, FleetTable, Report, fleet_table

JOINTS = 3


def table_of(values: np.ndarray, std: np.ndarray) -> FleetTable:
    """Compare robots with gains (N,) or (JOINTS, N), whose standard deviations have 39 degrees of freedom."""
    reports = []
    for k, (gains, stds) in enumerate(zip(np.atleast_2d(values).T, np.atleast_2d(std).T, strict=True)):
        rows = [
            {"joint": f"{joint}", "value": gain, "std": gain_std, "unit": "N m/A", "freedom": 39.0}
            | {"outcome": "good", "why": ""}
            for joint, (gain, gain_std) in enumerate(zip(gains.tolist(), stds.tolist(), strict=True))
        ]
        reports.append(Report(f"{k}", {"robot": "arm", "drive_gains": rows}))
    return fleet_table(reports)


def outliers(values: np.ndarray, std: np.ndarray) -> list[bool]:
    return [gain.outlier for gain in table_of(values, std).gains]


def distances(values: np.ndarray, std: np.ndarray) -> list[float | None]:
    return [gain.z for gain in table_of(values, std).gains]


@pytest.mark.parametrize("spread", [0.0, 0.5, 5.0])
def test_a_fleet_without_outliers_seldom_shows_one(rng: np.random.Generator, spread: float) -> None:
    alarms, fleets, n = 0, 200, 30
    for _ in range(fleets):
        sigma = rng.uniform(0.5, 2.0, (JOINTS, n))
        std = sigma * np.sqrt(rng.chisquare(39, sigma.shape) / 39)
        values = 100 + np.hypot(sigma, spread) * rng.standard_normal(sigma.shape)
        alarms += any(outliers(values, std))
    assert alarms < 0.1 * fleets  # a rate of 0.05 gives more with a chance of 1e-3


def test_spread_and_median_are_recovered_with_a_third_wrong(rng: np.random.Generator) -> None:
    sigma = rng.uniform(0.5, 2.0, 3000)
    values = 100 + np.hypot(sigma, 3.0) * rng.standard_normal(3000)
    values[:1000] += rng.choice([-300, 300], 1000)
    (joint,) = table_of(values, sigma).joints
    assert joint.median == pytest.approx(100, abs=4 * joint.median_std)
    assert 3.0 < joint.spread < 7.0  # the wrong third widens the quartiles, and no more
    assert all(outliers(values, sigma)[:1000])


def test_the_standard_deviation_of_the_median_is_its_scatter(rng: np.random.Generator) -> None:
    sigma = rng.uniform(0.5, 2.0, 40)
    fleets = [table_of(np.hypot(sigma, 1.0) * rng.standard_normal(40), sigma) for _ in range(300)]
    joints = [fleet.joints[0] for fleet in fleets]
    scatter = np.std([joint.median for joint in joints])
    assert scatter == pytest.approx(np.mean([joint.median_std for joint in joints]), rel=0.15)


def test_a_value_of_large_standard_deviation_is_no_outlier() -> None:
    values, std = np.zeros(20) + 0.01 * np.arange(20), np.full(20, 0.05)
    values[7] = 1.0
    assert np.flatnonzero(outliers(values, std)).tolist() == [7]
    std[7] = 0.5
    assert not any(outliers(values, std))


def test_units_do_not_matter(rng: np.random.Generator) -> None:
    values, std = rng.standard_normal(20), rng.uniform(0.1, 1, 20)
    assert distances(1e6 * values, 1e6 * std) == pytest.approx(distances(values, std))
    assert np.negative(distances(-values, std)) == pytest.approx(distances(values, std))


def test_few_values_have_no_outliers() -> None:
    for n in (1, 2, LEAST - 1, LEAST):
        values = np.zeros(n)
        values[-1] = 1e3
        assert any(outliers(values, np.ones(n))) == (n == LEAST)


def test_equal_values_known_exactly() -> None:
    (joint,) = table_of(np.full(10, 2.0), np.zeros(10)).joints
    assert (joint.median, joint.spread) == (2.0, 0.0)
    assert not any(outliers(np.full(10, 2.0), np.zeros(10)))
