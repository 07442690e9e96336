"""Trials of position filters on the logs, and what longer logs do to the choice."""

from __future__ import annotations

import numpy as np
import pytest

from gtau.estimation.regression.dataset import preparation_of
from gtau.model.base_parameters import Equations
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.robot import Robot
from gtau.signals.preparation.bandwidth import choose_preparation
from gtau.signals.run import Run

RATE = 200.0
CHI = {"mx_arm": 0.3, "zz_arm": 0.06, "ia_arm": 0.02, "fv_arm": 0.2, "fs_arm": 0.1}


@pytest.fixture(scope="module")
def bench() -> Robot:
    return load_robot("test-bench")


def ramps(robot: Robot, name: str, hunting: float, rng: np.random.Generator) -> Run:
    """A triangle between stops, 0.8 rad/s; the controller hunts at 41 Hz, which the encoder shows larger than it is."""
    time = np.arange(int(20 * RATE)) / RATE
    phase = time % 5.0
    q = 0.8 * np.minimum(phase, 5.0 - phase)
    qd = np.where(phase < 2.5, 0.8, -0.8)
    tau = InverseDynamics(robot).torques(q[:, None], qd[:, None], np.zeros((len(q), 1)), CHI)
    tau = tau + 0.005 * rng.standard_normal(tau.shape)
    shaken = q + hunting * np.sin(2 * np.pi * 41 * time) + 1e-5 * rng.standard_normal(len(q))
    return Run(name, ("arm",), time, shaken[:, None], tau, "torque")


def test_hunting_of_a_controller_is_no_motion(bench: Robot, rng: np.random.Generator) -> None:
    runs = [ramps(bench, "smooth", 0.0, rng), ramps(bench, "hunting", 0.01, rng)]
    of_spectra, tried = choose_preparation(runs), preparation_of(Equations(InverseDynamics(bench)), runs)
    assert of_spectra.bandwidth > 35
    assert of_spectra.cutoff is None
    assert tried.bandwidth < 12
    assert tried.cutoff is not None
    assert tried.cutoff < 25
    assert 2 * tried.bandwidth <= tried.cutoff


def test_a_choice_by_hand_is_kept(bench: Robot, rng: np.random.Generator) -> None:
    run = ramps(bench, "hunting", 0.01, rng)
    run = Run(run.name, run.joints, run.time, run.position, run.command, run.kind, settings=_settings(45.0))
    assert preparation_of(Equations(InverseDynamics(bench)), [run]).bandwidth == 45.0


def _settings(bandwidth: float) -> object:
    from gtau.signals.reading.statements import PreparationSettings

    return PreparationSettings(bandwidth=bandwidth)


@pytest.mark.parametrize("seconds", [20.0, 120.0])
def test_longer_logs_are_not_filtered_below_their_rows(seconds: float, rng: np.random.Generator) -> None:
    time = np.arange(int(500 * seconds)) / 500
    lines = np.array([0.2, 0.4, 0.6, 1.0])
    q = np.sin(2 * np.pi * lines * time[:, None] + [0.0, 1.57, 0.5, 2.0]) @ [0.15, 0.1, 0.08, 0.05]
    q = np.round((q + 2e-6 * rng.standard_normal(len(q))) / 1e-5) * 1e-5
    chosen = choose_preparation([Run("lines", ("arm",), time, q[:, None], np.cos(q)[:, None], "torque")])
    assert chosen.decimator.factor > 1
    assert chosen.cutoff >= 1.99 * chosen.decimator.cutoff(chosen.rate)
