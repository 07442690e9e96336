"""Time series and residual statistics of the reports."""

from __future__ import annotations

from base64 import b64decode

import numpy as np
import pytest

from gtau.report.html.document import Page, Section, render
from gtau.report.html.drawings import Interval, Panel, interval_rows, ticks
from gtau.report.html.series import Arrays, Line, buckets_for, chart, envelope, stretches
from gtau.report.residuals import autocorrelation, histogram, spectrum


def test_an_envelope_keeps_every_extreme_in_its_place(rng: np.random.Generator) -> None:
    time = np.arange(10_007) / 1000
    values = rng.normal(size=(len(time), 3))
    values[4321, 1] = 50.0
    values[77, 2] = -40.0
    thin_time, thin = envelope(time, values, 500)
    assert len(thin_time) == len(thin) <= 1000
    assert np.all(np.diff(thin_time) >= 0)
    np.testing.assert_array_equal(np.nanmax(thin, axis=0), values.max(axis=0))
    np.testing.assert_array_equal(np.nanmin(thin, axis=0), values.min(axis=0))
    spike = thin_time[np.argmax(thin[:, 1])]
    assert abs(spike - time[4321]) < 2 * len(time) / 500 / 1000
    kept_time, kept = envelope(time[:900], values[:900], 500)
    np.testing.assert_array_equal(kept, values[:900])
    np.testing.assert_array_equal(kept_time, time[:900])


def test_an_envelope_leaves_gaps_open() -> None:
    values = np.ones((4000, 1))
    values[1000:2000] = np.nan
    _, thin = envelope(np.arange(4000.0), values, 400)
    assert np.isnan(thin[200:400]).all()
    assert np.isfinite(thin[:190]).all()


def test_stretches_that_are_masked() -> None:
    time = np.arange(10.0)
    masked = np.array([1, 1, 0, 0, 1, 0, 1, 0, 0, 1], dtype=bool)
    np.testing.assert_array_equal(stretches(time, masked, 0.5), [0, 2, 4, 5, 6, 7, 9, 9])
    np.testing.assert_array_equal(stretches(time, masked, 1.5), [0, 2, 4, 7, 9, 9])
    assert stretches(time, np.zeros(10, dtype=bool), 1.0).size == 0


def test_two_runs_of_six_joints_stay_below_5_mb(rng: np.random.Generator) -> None:
    arrays, charts = Arrays(), []
    buckets = buckets_for(2 * 6 * 3)
    for run in range(2):
        time, values = envelope(np.arange(60_000) / 1000, rng.normal(size=(60_000, 18)), buckets)
        for j in range(6):
            lines = [Line(str(k), values[:, 6 * k + j], "predicted") for k in range(3)]
            charts.append(chart(arrays, time, lines, "N m", f"run {run}"))
    text = render(Page("size", [], [Section("s", "s", "".join(charts))], arrays))
    assert 7e5 < len(text) < 5e6
    assert len(arrays.packed) == 37  # both runs share their time
    key = arrays.put(values[:, 0])
    np.testing.assert_array_equal(np.frombuffer(b64decode(arrays.packed[key]), "<f4"), values[:, 0].astype("f4"))


def test_autocorrelation_of_a_first_order_process_with_masked_samples(rng: np.random.Generator) -> None:
    series = []
    for _ in range(4):
        values = np.zeros(20_000)
        for k in range(1, len(values)):
            values[k] = 0.7 * values[k - 1] + rng.normal()
        values[rng.random(len(values)) < 0.3] = np.nan
        series.append((np.arange(len(values)) / 50, values))
    found = autocorrelation(series)
    assert found is not None
    np.testing.assert_allclose(found.value[:6], 0.7 ** np.arange(6), atol=0.03)
    assert found.lag[1] == pytest.approx(1 / 50)
    assert found.band == pytest.approx(1.96 / np.sqrt(0.7 * 80_000), rel=0.02)


def test_power_of_the_spectrum_is_the_variance_with_masked_samples(rng: np.random.Generator) -> None:
    values = rng.normal(scale=3.0, size=40_000)
    values[rng.random(len(values)) < 0.4] = np.nan
    found = spectrum([(np.arange(len(values)) / 200, values)])
    assert found is not None
    assert found.density.sum() * (found.frequency[1] - found.frequency[0]) == pytest.approx(9.0, rel=0.05)


def test_a_histogram_is_a_density_with_the_deviation_of_what_is_kept(rng: np.random.Generator) -> None:
    values = rng.normal(loc=0.5, scale=2.0, size=20_000)
    values[::7] = np.nan
    found = histogram([(np.arange(20_000.0), values)])
    assert found is not None
    assert np.sum(found.density * np.diff(found.edges)) == pytest.approx(1.0)
    assert found.std == pytest.approx(np.nanstd(values))
    assert histogram([(np.arange(5.0), np.ones(5))]) is None


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (-0.46, 0.46), (8.1, 11.6), (-3e-6, 1e-6), (0.0, 12345.0)])
def test_ticks_are_round_and_enough(low: float, high: float) -> None:
    found = ticks(low, high, 5)
    assert 3 <= len(found) <= 5
    assert low - 1e-9 <= found[0]
    assert found[-1] <= high * (1 + 1e-9) + 1e-12
    np.testing.assert_allclose(np.diff(found), found[1] - found[0])


def test_intervals_share_one_scale() -> None:
    bars, axis = interval_rows([Interval(1.0, (0.5, 1.5), other=3.0), Interval(2.0)], zero=0.0)
    assert len(bars) == 2
    assert bars[0].count("<circle") == bars[1].count("<circle") == 1
    assert "M-5 0L0 -5" in bars[0]  # the diamond
    assert axis.count("<text") >= 3


def test_a_line_breaks_where_a_value_is_missing() -> None:
    panel = Panel((0.0, 3.0), (0.0, 1.0))
    panel.line(np.arange(4.0), np.array([0.0, np.nan, 0.5, 1.0]))
    assert panel.marks[0].count("M") == 2
