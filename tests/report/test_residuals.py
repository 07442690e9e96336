"""Residual statistics of the reports."""

from __future__ import annotations

import numpy as np
import pytest

from gtau.estimation.results.estimate import TorqueError
from gtau.report.identification import _largest
from gtau.report.torques import histogram, spectrum


def test_power_of_the_spectrum_is_the_variance_with_masked_samples(rng: np.random.Generator) -> None:
    values = rng.normal(scale=3.0, size=40_000)
    values[rng.random(len(values)) < 0.4] = np.nan
    found = spectrum([(np.arange(len(values)) / 200, values)])
    assert found is not None
    frequency, density = found
    assert density.sum() * (frequency[1] - frequency[0]) == pytest.approx(9.0, rel=0.05)


def test_a_histogram_is_a_density_with_the_deviation_of_what_is_kept(rng: np.random.Generator) -> None:
    values = rng.normal(loc=0.5, scale=2.0, size=20_000)
    values[::7] = np.nan
    residuals = [(np.arange(20_000.0), values)]
    found = histogram(residuals)
    assert found is not None
    edges, density = found
    assert np.sum(density * np.diff(edges)) == pytest.approx(1.0)
    middles = (edges[1:] + edges[:-1]) / 2  # in standard deviations about the mean
    assert np.sum(density * np.diff(edges) * middles**2) == pytest.approx(1.0, rel=0.03)
    few = [(np.arange(5.0), np.ones(5))]
    assert histogram(few) is None


def test_the_tile_of_the_largest_error_in_band_counts_reversals_too() -> None:
    errors = [
        TorqueError("a", 1.0, 100.0, "N m", 7.0, 100.0, 9.0, 100.0),
        TorqueError("b", 2.0, 100.0, "N m", 3.0, 100.0, 4.0, 100.0),
    ]
    assert _largest(errors, in_band=True) == "7.00 % (a)"
    assert _largest(errors) == "2.00 % (b)"
