"""Runs prepared for the model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gtau.errors import GtauError
from gtau.signals.preparation.bandwidth import choose_preparation, moving_spectra
from gtau.signals.preparation.prepared_run import prepare
from gtau.signals.run import Run, read_run

RATE = 1000.0


def run_with_rest(name: str = "r", rate: float = RATE) -> Run:
    """Two sines of 8 s with a smooth start and stop between 2 s of rest, and a joint that stands still."""
    time = np.arange(int(12 * rate)) / rate
    window = np.clip(np.minimum(time - 2, 10 - time), 0, 1)
    window = window**3 * (10 - 15 * window + 6 * window**2)
    w = 2 * np.pi * np.array([0.5, 1.2])
    position = np.column_stack([window * np.sin(w[0] * time), 0.2 * window * np.cos(w[1] * time), 0.7 + 0 * time])
    position = np.round(position / 1e-5) * 1e-5
    command = np.column_stack([np.cos(w[0] * time), np.sin(w[1] * time), np.sin(9 * time)])
    return Run(name, ("a", "b", "c"), time, position, command)


def test_preparation_of_a_run() -> None:
    run = run_with_rest()
    preparation = choose_preparation([run])
    assert 1.2 <= preparation.bandwidth < 3
    # the encoders' noise counts, but torques of the rows keep nothing that the positions lose
    assert preparation.cutoff == pytest.approx(2 * preparation.decimator.cutoff(preparation.rate))
    assert preparation.decimator.factor > 20
    prepared = prepare(run, preparation).samples()
    assert tuple(map(str, prepare(run, preparation).notes)) == ("joint 'c' hardly moves: its rows are left out",)
    # Rest is cut off, the motion is not.
    assert 2.0 < prepared.time[0] < 2.4
    assert 9.6 < prepared.time[-1] < 10.0
    steady = (prepared.time > 3.2) & (prepared.time < 8.8)
    t = prepared.time[steady]
    w = np.pi
    np.testing.assert_allclose(prepared.q[steady, 0], np.sin(w * t), atol=1e-4)
    np.testing.assert_allclose(prepared.qd[steady, 0], w * np.cos(w * t), atol=2e-3)
    np.testing.assert_allclose(prepared.qdd[steady, 0], -(w**2) * np.sin(w * t), atol=0.1)
    np.testing.assert_allclose(prepared.command_d[steady, 0], -w * np.sin(w * t), atol=1e-6)
    np.testing.assert_allclose(prepared.command_dd[steady, 0], -(w**2) * np.cos(w * t), atol=1e-4)


def test_rows_are_masked_on_their_own_joints_reversals() -> None:
    run = run_with_rest()
    prepared = prepare(run, choose_preparation([run])).samples()
    rms = np.sqrt(np.mean(prepared.qd**2, axis=0))
    expected = np.abs(prepared.qd[:, :2]) >= 0.05 * rms[:2]
    np.testing.assert_array_equal(prepared.usable[:, :2], expected)
    assert (prepared.usable[:, 0] != prepared.usable[:, 1]).any()
    assert not prepared.usable[:, 2].any()
    sign = np.sign(prepared.qd[:, 0])
    changes = np.flatnonzero(np.diff(sign) != 0)
    assert len(changes) > 5
    assert not prepared.usable[changes, 0].any()


def test_gaps_and_edges_are_masked() -> None:
    run = run_with_rest()
    valid = np.ones(run.position.shape, dtype=bool)
    valid[5000:5003] = False
    cut = slice(4000, 8000)  # begins and ends in motion
    parts = {name: getattr(run, name)[cut] for name in ("time", "position", "command")}
    prepared = prepare(replace(run, valid=valid[cut], **parts), choose_preparation([run])).samples()
    masked = np.flatnonzero(~prepared.usable[:, 0] & (np.abs(prepared.qd[:, 0]) > 1.0))
    assert np.round(prepared.time[masked] * RATE).astype(int).tolist() == list(range(4998, 5005))
    edge = 3 / choose_preparation([run]).cutoff  # type: ignore[operator]
    assert prepared.time[0] >= 4.0 + edge
    assert prepared.time[-1] <= 8.0 - edge


def test_all_runs_share_one_preparation() -> None:
    slow, fast = run_with_rest("slow"), run_with_rest("fast")
    fast = replace(fast, time=fast.time / 1.05)
    shared = choose_preparation([slow, fast])
    assert shared.bandwidth == choose_preparation([fast]).bandwidth > choose_preparation([slow]).bandwidth
    assert choose_preparation([slow], decimator="chebyshev").decimator.kind == "chebyshev"


def test_runs_of_different_rates_share_filter_and_rate_of_rows() -> None:
    whole, half = run_with_rest(), run_with_rest("half", 500.0)
    shared = choose_preparation([whole, half])
    assert shared.rate == half.rate
    assert shared.at(half.rate) is shared
    fast = shared.at(whole.rate)
    assert fast.cutoff == shared.cutoff
    assert fast.decimator.factor == 2 * shared.decimator.factor


def test_a_run_at_rest_is_refused() -> None:
    run = run_with_rest()
    at_rest = replace(run, position=np.full_like(run.position, 0.3))
    preparation = choose_preparation([run])
    with pytest.raises(GtauError, match="no joint's motion exceeds its position noise"):
        choose_preparation([at_rest])
    with pytest.raises(GtauError, match="no joint moves"):
        prepare(at_rest, preparation)


UR10E = {
    "time": "1",
    "position": {f"j{i}": str(1 + i) for i in range(1, 7)},
    "current": {f"j{i}": str(13 + i) for i in range(1, 7)},
}


def test_ur10e_speeds_are_those_of_its_controller(shared: Path) -> None:
    path = shared / "ur10e" / "ur-20_02_19_14harm50sec.csv"
    run = read_run(path, UR10E)
    prepared = prepare(run, choose_preparation([run])).samples()
    logged = np.loadtxt(path, delimiter=",", usecols=(0, *range(7, 13)))
    reported = np.column_stack([np.interp(prepared.time, logged[:, 0], each) for each in logged[:, 1:].T])
    inner = slice(50, -50)
    error = (prepared.qd - reported)[inner].std(axis=0) / reported[inner].std(axis=0)
    assert error.max() < 0.01
    assert prepared.usable.mean(axis=0).min() > 0.85


def test_ur10e_at_rest_and_one_joint_at_a_time(shared: Path) -> None:
    with pytest.raises(GtauError, match="no joint's motion exceeds its position noise"):
        choose_preparation([read_run(shared / "ur10e" / "ur-20_01_17-p1.csv", UR10E)])
    run = read_run(shared / "ur10e" / "jointwise" / "ur-20_01_22-joint_2.csv", UR10E)
    prepared = prepare(run, choose_preparation([run])).samples()
    assert prepared.usable.any(axis=0).tolist() == [False, True, False, False, False, False]


def test_rows_end_where_noise_takes_over() -> None:
    """Twelve bits at 50 Hz: accelerations beyond some 6 Hz are noise, and rows up to 10 Hz bias what they hold."""
    time = np.arange(1500) / 50
    parts = ((0.6, 0.2), (0.2, 1.35), (0.05, 2.15), (0.03, 3.45))
    sines = [size * np.sin(2 * np.pi * f * time + f) for size, f in parts]
    step = 2 * np.pi / 4096
    coarse, fine = (
        Run("r", ("a",), time, np.round(np.sum(sines, axis=0)[:, None] / step) * step, np.sin(9 * time)[:, None])
        for step in (step, step / 256)
    )
    factors = [choose_preparation([run]).decimator.factor for run in (coarse, fine)]
    assert factors[0] > factors[1]
    chosen = choose_preparation([coarse])
    assert 1.2 * chosen.bandwidth < chosen.decimator.cutoff(50.0) < 2 * chosen.bandwidth


def test_rows_end_where_noise_takes_over_although_reversals_cost_samples() -> None:
    """18 bits at 200 Hz: accelerations are noise from three times the bandwidth on, where rows still reached."""
    time, rng = np.arange(6000) / 200, np.random.default_rng(1)
    harmonics, phases = np.arange(1, 16), 2 * np.pi * rng.random((6, 15))
    parts = np.sin(0.4 * np.pi * np.multiply.outer(time, harmonics)[:, None] + phases)  # (N, 6, 15)
    path, step = parts @ np.exp(-harmonics / 4), 2 * np.pi / 2**18
    run = Run("r", tuple("abcdef"), time, np.round(path / step) * step, np.sin(9 * path))
    chosen, end = choose_preparation([run]), max(spectrum.end for spectrum in moving_spectra(run))
    assert end > 2 * chosen.bandwidth
    assert chosen.decimator.cutoff(200.0) < 1.2 * end
