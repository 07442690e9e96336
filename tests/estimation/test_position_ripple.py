"""Errors that repeat at the same positions: found, said, and part of the deviations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from orthoglide_logs import RATE, experiment

from gtau.demo.orthoglide import DRIVE_GAINS
from gtau.estimation.diagnostics.alternatives import Alternative
from gtau.estimation.diagnostics.repeating_residuals import position_ripple, springs
from gtau.estimation.estimators.maximum_likelihood import ML
from gtau.estimation.identify import identify
from gtau.estimation.regression.dataset import reduce_runs
from gtau.findings import FindingKind as F
from gtau.model.home import load_robot
from gtau.signals.run import Run

ROBOT = load_robot("orthoglide")
GAINS = np.array(list(DRIVE_GAINS.values()))
PERIOD = 0.2  # m, so long that gravity and friction take up much of it


@pytest.fixture(scope="module")
def runs() -> list[Run]:
    return experiment(1)


def rippled(runs: list[Run], seed: int) -> list[Run]:
    """Currents with a ripple of 2 %, of the same phases in all runs."""
    phases = np.random.default_rng(seed).uniform(0, 2 * np.pi, 3)
    waves = [np.sin(2 * np.pi * run.position / PERIOD + phases) for run in runs]
    return [
        replace(run, command=run.command + 0.02 * np.std(run.command, axis=0) * wave)
        for run, wave in zip(runs, waves, strict=True)
    ]


def found(runs: list[Run]) -> tuple[Alternative, np.ndarray, np.ndarray, np.ndarray]:
    """What repeats, the errors of the gains, by how much they move, and their deviations by the jackknife alone."""
    data = reduce_runs(ROBOT, runs)
    system = data.system(per_run=True)
    fit = ML.fit(system)
    solution = fit.solution
    of_gains = slice(system.problem.n_theta, system.problem.n_theta + 3)
    locked = position_ripple(fit)
    std = np.sqrt(np.diag(solution.jackknife))
    return locked, solution.gains - GAINS, locked.shifts[of_gains], std[of_gains]


def test_ripple_shifts_gains_by_what_is_found(runs: list[Run]) -> None:
    shifts = []
    for seed in range(4):
        locked, errors, moves, std = found(rippled(runs, seed))
        assert [cause.kind for cause in locked.causes] == [F.RIPPLE]
        shifts.append((errors / std, (errors + moves) / std, errors / np.hypot(std, moves)))
    alone, after, stack = (np.sqrt(np.mean(np.square(each))) for each in zip(*shifts, strict=True))
    assert np.abs(shifts[0][0]).max() > 2.3  # more than scatter shows
    assert alone > 1.1
    assert after < 0.4
    assert stack < 0.9


@pytest.mark.slow
def test_a_result_says_it_and_has_it_in_its_deviations(runs: list[Run]) -> None:
    result = identify(ROBOT, rippled(runs, 0))
    (note,) = [note for note in result.notes if note.kind == F.RIPPLE]
    assert note.joint.startswith("1")
    for gain, truth in zip(result.drive_gains.values(), GAINS, strict=True):
        assert abs((gain.value or 0.0) - truth) < 2 * (gain.std or 0.0)
    assert "residuals are autocorrelated" in " ".join(result.summary().split())


@pytest.mark.parametrize("decay", [0.05, pytest.param(0.2, marks=pytest.mark.slow)])
def test_slow_noise_is_not_taken_for_ripple(decay: float, runs: list[Run]) -> None:
    """It is autocorrelated, as ripple is, but what the first half of a run has is not found in the second."""
    rng, rho = np.random.default_rng(4), np.exp(-1 / (RATE * decay))
    noisy = []
    for run in runs:
        noise = np.zeros_like(run.command)
        for k in range(1, len(noise)):
            noise[k] = rho * noise[k - 1] + np.sqrt(1 - rho**2) * rng.standard_normal(3)
        noisy.append(replace(run, command=run.command + 0.02 * np.std(run.command, axis=0) * noise))
    locked, *_ = found(noisy)
    assert locked.share < 0.1
    assert not locked.causes
    assert not locked.shifts.any()


def test_a_spring_is_named(runs: list[Run]) -> None:
    pulled = [replace(run, command=run.command + run.position * [0.0, 200.0, 0.0] / GAINS) for run in runs]
    with_it, without = (ML.fit(reduce_runs(ROBOT, logs).system(per_run=True)) for logs in (pulled, runs))
    (spring,) = springs(with_it, ())
    assert spring.joints == ("12",)
    assert spring.values["stiffness"] == pytest.approx(200.0, rel=0.05)
    assert spring.values["unit"] == "N/m"
    assert not list(springs(without, ()))
