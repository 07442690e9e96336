"""Commands that lag behind the motion: low-passed, or logged late."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from five_bar_logs import STEEL, Plant
from scipy.signal import lfilter

from gtau.estimation.diagnostics.log_checks import command_lag, command_lags
from gtau.estimation.regression.dataset import Dataset, reduce_runs
from gtau.findings import Grade
from gtau.model.home import load_robot
from gtau.result import identify
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run

FIVE_BAR = load_robot("five-bar")
NOISE = 0.02  # A, of some 1 to 2 A rms


def low_passed(run: Run, lag: float) -> Run:
    """The run behind a low-pass of first order with a time constant of ``lag`` s."""
    if not lag:
        return run
    pole = np.exp(-1 / (run.rate * lag))
    command, _ = lfilter([1 - pole], [1, -pole], run.command, axis=0, zi=pole * run.command[:1])
    return replace(run, command=command)


def logged(lag: float, late: int = 0, kind: str = "current") -> Dataset:
    plant = Plant(noise=NOISE, gains=(1.0, 1.0) if kind == "torque" else (2.5, 4.0))
    free, loaded = plant.run("free", 8.0, seed=1), plant.run("loaded", 8.0, STEEL, 2)
    runs = [free, replace(loaded, payload=Payload(name="steel", mass=STEEL["m"]))]
    runs = [replace(low_passed(run, lag), kind=kind) for run in runs]
    runs = [replace(run, command=np.roll(run.command, late, axis=0)) for run in runs]
    return reduce_runs(FIVE_BAR, runs)


@pytest.mark.parametrize("lag", [0.0, 0.005, 0.01, 0.02, 0.05])
def test_the_time_constant_of_a_low_pass_is_found(lag: float) -> None:
    dataset = logged(lag)
    system = dataset.system()
    found, error = command_lags(system.problem)
    period = 1 / dataset.runs[0].rate
    np.testing.assert_allclose(found, lag, atol=0.05 * lag + 0.5 * period + 4 * error.max())
    assert bool(command_lag(dataset, system)) == (lag > 0)


@pytest.mark.parametrize("late", [-5, 5])
def test_currents_before_the_motion_are_a_delay_and_those_after_it_are_late(late: int) -> None:
    dataset = logged(0.0, late)
    (lag, _), _ = command_lags(dataset.system().problem)
    assert lag == pytest.approx(late / 500, rel=0.2)  # a delay is a low-pass to first order only, here of 0.2 rad
    assert bool(command_lag(dataset, dataset.system())) == (late > 0)


def test_torques_are_judged_alike_and_the_grade_follows_what_is_lost() -> None:
    strong, weak = (logged(lag, kind="torque") for lag in (0.02, 0.005))
    (found,) = command_lag(strong, strong.system())
    assert found.kind == "command lag"
    assert found.what.startswith("the torques lag behind the motion by ")
    assert (found.topic, found.severity) == ("filtered command", Grade.WARNING)
    (found,) = command_lag(weak, weak.system())
    assert (found.kind, found.severity) == ("slight command lag", Grade.INFORMATION)


@pytest.mark.parametrize("others", [np.nan, 0.05])
def test_one_joint_alone_shows_no_lag_of_all(others: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Friction of a wrist may look like one."""
    lags = np.array([others, 0.057]), np.array([0.01, 0.01])
    monkeypatch.setattr("gtau.estimation.diagnostics.log_checks.command_lags", lambda problem: lags)
    dataset = logged(0.0)
    assert bool(command_lag(dataset, dataset.system())) == np.isfinite(others)


def test_noise_alone_has_no_lag() -> None:
    """Currents that are mostly noise say nothing, however they are filtered."""
    run = Plant(noise=20.0).run("free", 8.0, seed=1)
    dataset = reduce_runs(FIVE_BAR, [low_passed(run, 0.05)])
    assert command_lag(dataset, dataset.system()) == []


def test_gains_that_are_given_come_with_the_note() -> None:
    plant = Plant(noise=NOISE)
    runs = [low_passed(plant.run("free", 8.0, seed=1), 0.02)]
    result = identify(FIVE_BAR, runs, method="wls", prior_gains={"left": 2.5, "right": 4.0})
    assert "the currents lag behind the motion by" in " ".join(result.summary(verbose=False).split())


def test_currents_that_lead_by_more_than_drives_do_are_references_of_a_slower_loop() -> None:
    rng, runs = np.random.default_rng(0), []
    for payload, seed in ((None, 1), (Payload(name="steel", mass=STEEL["m"]), 2)):
        run = Plant(noise=0.0).run("loaded" if payload else "free", 8.0, STEEL if payload else None, seed)
        reference = run.command + 0.02 * run.rate * np.gradient(run.command, axis=0)
        noise = NOISE * rng.standard_normal(reference.shape)
        runs.append(replace(run, command=reference + noise, payload=payload))
    dataset = reduce_runs(FIVE_BAR, runs)
    (found,) = command_lag(dataset, dataset.system())
    assert (found.kind, found.topic, found.severity) == ("command lead", "filtered command", Grade.WARNING)
    assert found.what.startswith("the currents lead the motion by ")
