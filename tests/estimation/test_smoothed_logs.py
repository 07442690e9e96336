"""Logs that were smoothed offline, beside logs with coarse registers and slow ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gtau.estimation.diagnostics.log_checks import smoothed_commands
from gtau.signals.preparation.filters import low_pass
from gtau.signals.run import Run

RATE = 200.0


def log(rng: np.random.Generator, rate: float = RATE, cutoff: float | None = None, quantum: float = 1e-6) -> Run:
    """A current with friction, inertia and noise of 1 % beside a sum of sines."""
    time = np.arange(int(30 * rate)) / rate
    w = 2 * np.pi * np.array([0.3, 0.7])
    angle = w * time[:, None] + [0.0, 1.0]
    q, qd, qdd = np.sin(angle).sum(axis=1), (w * np.cos(angle)).sum(axis=1), -(w**2 * np.sin(angle)).sum(axis=1)
    current = 0.1 * qdd + 0.3 * qd + 0.5 * np.sign(qd) + 2 * np.cos(q)
    current += 0.01 * current.std() * rng.standard_normal(len(time))
    if cutoff is not None:
        q, current = low_pass(q, rate, cutoff), low_pass(current, rate, cutoff)
    q, current = np.round(q / 1e-6) * 1e-6, np.round(current / quantum) * quantum
    return Run(f"{rate:g}", ("arm",), time, q[:, None], current[:, None])


@pytest.mark.parametrize("cutoff", [1.0, 5.0])
def test_a_log_smoothed_offline_is_named(rng: np.random.Generator, cutoff: float) -> None:
    (finding,) = smoothed_commands([log(rng), log(rng, cutoff=cutoff)][1:])
    assert cutoff < float(finding.what.partition("above ")[2].split()[0]) < 5 * cutoff
    assert "were smoothed: above" in finding.what


@pytest.mark.parametrize(("rate", "quantum"), [(200.0, 1e-6), (200.0, 0.2), (20.0, 1e-6), (10.0, 0.01), (1000.0, 1e-3)])
def test_coarse_and_slow_logs_are_not(rng: np.random.Generator, rate: float, quantum: float) -> None:
    assert not list(smoothed_commands([log(rng, rate, quantum=quantum)]))


def test_smooth_commands_without_friction_have_no_filter(rng: np.random.Generator) -> None:
    run = log(rng)
    still = Run("held", run.joints, run.time, run.position, np.zeros_like(run.command))
    assert not list(smoothed_commands([still]))


@pytest.mark.parametrize("window", [12, 200])
def test_a_moving_average_is_named_with_its_window(rng: np.random.Generator, window: int) -> None:
    run = log(rng)
    mean = np.convolve(run.command[:, 0], np.ones(window) / window, "same")[:, None]
    (finding,) = smoothed_commands([replace(run, command=mean)])
    assert f"smoothed by a moving average over {window / RATE:.2g} s; what" in finding.what


@pytest.mark.parametrize("period", [10, 20])
def test_commands_that_are_updated_slowly_are_no_averages(rng: np.random.Generator, period: int) -> None:
    run = log(rng)
    between = np.interp(run.time, run.time[::period], run.command[::period, 0])[:, None]
    held = np.repeat(run.command[::period], period, axis=0)[: len(run.time)]
    smooth = log(rng, cutoff=3.0).command
    for command in (between, held, smooth):
        assert not any("average" in finding.what for finding in smoothed_commands([replace(run, command=command)]))


def test_chatter_of_drives_is_no_average(rng: np.random.Generator) -> None:
    """Its correlation is -0.4 at one lag, with positive neighbours and 0 at twice the lag, but as large at others."""
    run = log(rng)
    steps = np.deg2rad(157.5) + 0.32 * rng.standard_normal(len(run.time))  # about 87.5 Hz
    chatter = 0.05 * run.command.std() * np.cos(np.cumsum(steps))
    assert not list(smoothed_commands([replace(run, command=run.command + chatter[:, None])]))
