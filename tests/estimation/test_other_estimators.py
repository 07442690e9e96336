"""Hausman's test: other preparations and instrumental variables against the estimator used."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from five_bar_logs import CHI, GAINS, STEEL, Plant

from gtau.estimation.diagnostics.alternatives import Alternative, compete
from gtau.estimation.diagnostics.diagnose import diagnose
from gtau.estimation.diagnostics.examine import Examination, estimates_of
from gtau.estimation.diagnostics.other_estimators import (
    differences,
    other_estimators,
    position_noise,
    two_stage_difference,
)
from gtau.estimation.diagnostics.verdict import Outcome
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.maximum_likelihood import ML
from gtau.estimation.estimators.two_stage import first_stage, two_stage
from gtau.estimation.identify import identify
from gtau.estimation.regression.dataset import reduce_runs
from gtau.estimation.thresholds.estimates import ACCURACY
from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.model.home import load_robot
from gtau.signals.preparation.choice import choose_preparation
from gtau.signals.preparation.filters import Decimator
from gtau.signals.preparation.prepared_run import Preparation
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run

ROBOT = load_robot("five-bar")
NOISY = Preparation(bandwidth=2.5, cutoff=100.0, decimator=Decimator(10), rate=500.0)  # a filter that is far too wide


def logs(encoder_noise: float = 0.0, seconds: float = 8.0, noise: float = 0.01, seed: int = 1) -> list[Run]:
    plant, rng = Plant(noise=noise), np.random.default_rng(5)
    runs = [
        plant.run("free", seconds, seed=seed),
        replace(plant.run("loaded", seconds, STEEL, seed=seed + 1), payload=Payload(name="steel", mass=STEEL["m"])),
    ]
    return [replace(run, position=run.position + encoder_noise * rng.normal(size=run.position.shape)) for run in runs]


def fit_of(runs: list[Run], preparation: Preparation | None = None) -> Fit:
    dataset = reduce_runs(ROBOT, runs, preparation)
    return ML.fit(dataset.system(per_run=True))


@pytest.fixture(scope="module")
def noisy() -> Fit:
    """Runs of 24 s, where the bias is more than chance: of the left gain 5.6 %, 2.6 standard deviations.

    After 8 s it is one, so that the share of it which one step undoes is chance too (50 to 97 % over three seeds; after
    24 s 75 to 99 %).
    """
    return fit_of(logs(4e-4, 24.0), NOISY)


def of(fit: Fit, estimator: Finding) -> tuple[np.ndarray, np.ndarray]:
    """What another estimator finds otherwise, and standard deviations."""
    return next((moves, std) for by, moves, std in differences(fit) if by == estimator)


def by_estimate(fit: Fit) -> list[Alternative]:
    """Other estimators as alternatives, which compete for each estimate."""
    every = [each for each in (*other_estimators(fit), *two_stage_difference(fit)) if isinstance(each, Alternative)]
    return list(compete(every, lambda each: (each.causes[0].joints, each.causes[0].subject)))


def test_instruments_undo_what_noise_of_the_encoders_does(noisy: Fit) -> None:
    (moves, _), n_theta = of(noisy, Finding(F.INSTRUMENTS)), noisy.system.problem.n_theta
    fv_left = noisy.system.problem.parameters.index("fv_left")
    for k, truth in ((fv_left, CHI["fv_left"]), (n_theta, GAINS[0])):
        bias = noisy.solution.values[k] - truth
        assert abs(bias) > 0.04 * truth
        assert abs(bias + moves[k]) < 0.35 * abs(bias)


def test_the_summary_names_the_noise_and_the_intervals_allow_for_it(noisy: Fit) -> None:
    alternatives = by_estimate(noisy)
    assert [each.kind for each in position_noise(noisy, alternatives)] == [F.POSITION_NOISE]
    of_first_moment = [each for each in alternatives if each.causes[0].subject.endswith("my_L2")]
    assert sum(each.probability for each in of_first_moment) > 0.8
    assert F.INSTRUMENTS not in {each.kind for each, _, _ in differences(replace(noisy, noise_free=True))}
    examined = Examination(tuple(alternatives))
    notes = diagnose(noisy, examined, estimates_of(noisy, examined, True), {}, {}, ACCURACY)
    first = max(notes, key=lambda note: note.size)  # it moves an estimate by more than half its interval
    assert (first.kind, first.size > 1) == (F.POSITION_NOISE, True)


def test_nothing_is_said_of_clean_logs() -> None:
    fit = fit_of(logs())
    alternatives = by_estimate(fit)
    assert F.TWO_STAGE in {each.hypothesis for each in alternatives}
    assert not list(position_noise(fit, alternatives))
    n_theta = fit.system.problem.n_theta
    std = np.sqrt(np.diag(fit.solution.jackknife))[n_theta : n_theta + 2]
    added = np.sqrt([sum(each.probability * each.shifts[n_theta + j] ** 2 for each in alternatives) for j in range(2)])
    assert np.all(added < 0.7 * std)
    # five preparations and estimators, each with its move of each gain
    assert len([each for each in alternatives if each.causes[0].joints]) == 6 * 2


def test_one_step_is_what_another_preparation_gives() -> None:
    """On runs of 24 s, of which the windows lose little at their ends (correlation 0.98; 0.79 on runs of 8 s)."""

    def sticking(run: Run) -> Run:
        speed = np.gradient(run.position, run.time, axis=0)
        return replace(run, command=run.command + 1.0 * np.sign(speed) * np.exp(-np.abs(speed) / 0.1) / GAINS)

    runs = [sticking(run) for run in logs(seconds=24.0)]
    fit = fit_of(runs)
    (moves, std), names = of(fit, Finding(F.SLOW_ROWS, values={"fraction": 0.1})), fit.system.problem.parameters
    again = fit_of(runs, replace(choose_preparation(runs), speed_fraction=0.1))
    exact = again.solution.values - fit.solution.values
    assert names == again.system.problem.parameters
    seen = std > 0
    assert np.corrcoef(exact[seen] / std[seen], moves[seen] / std[seen])[0, 1] > 0.9


def test_an_estimator_whose_filter_leaves_no_rows_is_not_tried_and_the_others_are() -> None:
    runs = logs()
    fit = fit_of(runs, replace(choose_preparation(runs), bandwidth=0.02))
    untested, *others = differences(fit)
    assert isinstance(untested, Finding)
    assert (untested.kind, [cause.kind for cause in untested.causes]) == (F.UNTESTED, [F.INSTRUMENTS])
    assert [by.kind for by, _, _ in others] == [F.BANDWIDTH] * 2 + [F.SLOW_ROWS] * 2


def test_alternatives_are_listed_with_the_result() -> None:
    result = identify(ROBOT, logs())
    listed = {each.hypothesis for each in result.alternatives}
    assert {F.INSTRUMENTS, F.TWO_STAGE, F.BANDWIDTH, F.SLOW_ROWS} <= listed
    causes = [cause for each in result.alternatives for cause in each.causes]
    assert Finding(F.BANDWIDTH, ("left",), values={"factor": 0.7}) in causes


def test_instruments_are_as_strong_as_the_currents_are_clear_of_noise() -> None:
    """Where nothing but noise is left of them F is about one, as theirs is; there 2SLS is not compared."""
    strengths = []
    for noise in (0.03, 0.3, 30.0):
        fit = fit_of(logs(noise=noise))
        strengths.append(first_stage(fit.system.problem, fit.solution, 1.0)[0])
    assert strengths[0] / strengths[1] == pytest.approx(100, rel=0.3)
    assert strengths[2] < 3
    (weak,) = two_stage_difference(fit)
    assert isinstance(weak, Finding)
    assert weak.kind == F.WEAK_INSTRUMENTS


def test_the_bias_that_weak_instruments_leave_counts_in_the_comparison() -> None:
    """Its mean over ten logs so noisy that F is about two, and what 2SLS finds otherwise there."""
    bias, found = [], []
    for k in range(10):
        fit = fit_of(logs(noise=1.0, seed=100 + 2 * k))
        problem, solution = fit.system.problem, fit.solution
        bias.append(first_stage(problem, solution, 1.0)[1])
        found.append((two_stage(problem, solution.delays).gains - fit.gains) / GAINS)
    mean, std = np.mean(found, axis=0), np.std(found, axis=0) / np.sqrt(10)
    assert np.all(mean < -4 * std)
    share = np.mean(bias, axis=0) / mean
    assert share.min() > 0.4
    assert share.max() < 1.5
    fit = fit_of(logs(noise=0.3))
    bias_now = first_stage(fit.system.problem, fit.solution, 1.0)[1]
    assert np.all([each.std for each in two_stage_difference(fit)] > np.abs(bias_now))


@pytest.mark.slow
def test_one_chirp_of_all_joints_is_no_contradiction_of_2sls(shared: Path, tmp_path: Path) -> None:
    """Gains from loaded less unloaded currents, joint by joint: 0.94, 1.60, 1.47, 0.91 and 0.98."""
    folder = shared / "airbot_play"
    joints = [f"joint{k}" for k in range(1, 7)]
    described = {
        "robot": str(folder / "airbot_play_v3_0_gripper.urdf"),
        "signals": {
            "time": "t",
            "position": dict(zip(joints, [f"q{k}" for k in range(1, 7)], strict=True)),
            "current": dict(zip(joints, [f"tau{k}" for k in range(1, 7)], strict=True)),
        },
        "runs": [
            {"log": str(folder / "chirp_unloaded.csv")},
            {"log": str(folder / "trapezoidal_unloaded.csv")},
            {"log": str(folder / "chirp_loaded_480g.csv"), "payload": {"name": "load", "mass": 0.48}},
        ],
    }
    (tmp_path / "experiment.yaml").write_text(json.dumps(described))
    result = identify(tmp_path / "experiment.yaml")
    found = [result.drive_gains[joint] for joint in joints[:5]]
    assert [gain.value for gain in found] == pytest.approx([0.94, 1.60, 1.47, 0.91, 0.98], rel=0.08)
    assert Outcome.CONTRADICTORY not in {gain.verdict.outcome for gain in result.drive_gains.values()}
    assert [note.topic for note in result.notes if note.kind == F.WEAK_INSTRUMENTS] == [F.READING]
