"""What a column of effort holds has one answer; benchmarks/effort.py makes the table of measured logs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import polars as pl
import pytest
from five_bar_logs import five_bar
from gravity_logs import logged

from gtau.estimation.diagnostics.effort import (
    MAGNITUDES,
    SWAPPED_CHANNELS,
    columns_of_effort,
    middle_rows,
    shows_gravity,
)
from gtau.estimation.diagnostics.gravity import WITHOUT_GRAVITY
from gtau.estimation.diagnostics.log_checks import doubtful_commands
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.least_squares import WLS
from gtau.estimation.regression.dataset import reduce_runs
from gtau.model.home import load_robot
from gtau.result import identify
from gtau.signals.run import Run, read_run

ROBOT = load_robot("ur10e")
DOWN, FREE = (0.0, 0.0, -9.81), (0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def torques() -> Run:
    (run,) = logged(ROBOT, DOWN, currents=False)
    return run


def fitted(run: Run) -> Fit:
    return WLS.fit(reduce_runs(ROBOT, [run]).system(), np.ones(len(ROBOT.actuated)))


SPOILT: dict[str, tuple[Callable[[np.ndarray], np.ndarray], str | None, tuple[int, ...]]] = {
    "as they are": (lambda command: command, None, ()),
    "scaled": (lambda command: 1.33 * command, None, ()),
    "exchanged": (lambda command: command[:, [0, 2, 1, 3, 4, 5]], SWAPPED_CHANNELS, (1, 2)),
    "permuted": (lambda command: command[:, [0, 2, 3, 1, 4, 5]], SWAPPED_CHANNELS, (1, 2, 3)),
    "magnitudes": (np.abs, MAGNITUDES, (0, 1, 3)),
    "of another motion": (lambda command: command[::-1], None, ()),
}


@pytest.mark.parametrize("spoil", SPOILT)
def test_the_most_likely_meaning_is_the_true_one(spoil: str, torques: Run) -> None:
    alter, kind, joints = SPOILT[spoil]
    spoilt = replace(torques, command=np.ascontiguousarray(alter(torques.command)))
    findings = columns_of_effort(middle_rows(fitted(spoilt)))
    assert {finding.kind for finding in findings} == ({kind} if kind else set())
    assert {ROBOT.actuated[j] for j in joints} <= {joint for finding in findings for joint in finding.joints}


@pytest.mark.parametrize("share", [1.0, 0.7, 0.0])
def test_gravity_is_missing_only_where_its_coefficient_is_zero(share: float) -> None:
    (run,) = logged(ROBOT, (0.0, 0.0, share * DOWN[2]), currents=False)
    middle = middle_rows(fitted(run))
    assert middle is not None
    assert shows_gravity(middle, 1.0) == (share == 0, share == 0)


@pytest.mark.slow
def test_currents_without_gravity_are_not_taken_for_a_wrong_length() -> None:
    result = identify(ROBOT, logged(ROBOT, FREE, currents=True))
    verdicts = [gain.verdict.finding for gain in result.drive_gains.values() if gain.verdict.finding]
    causes = {cause for finding in verdicts for cause in finding.causes}
    assert WITHOUT_GRAVITY in causes


def test_whole_numbers_are_seen_before_irregular_stamps_are_resampled(torques: Run) -> None:
    rng, robot = np.random.default_rng(3), five_bar().robot
    time = np.arange(800) * 0.01
    stamps = time + rng.uniform(-0.004, 0.004, len(time))
    joints = robot.actuated
    table = {"t": stamps}
    for k, joint in enumerate(joints):
        table[f"q_{joint}"] = 0.3 * np.sin((2 + k) * stamps)
        table[f"u_{joint}"] = np.round(400 * np.cos((3 + k) * stamps))
    columns = {kind: {j: f"{letter}_{j}" for j in joints} for kind, letter in {"position": "q", "torque": "u"}.items()}
    run = read_run(pl.DataFrame(table), {"time": "t", **columns}, settings={"clock": "stamps"})
    assert np.mean(run.command == np.round(run.command)) < 0.5  # resampled
    assert [finding.kind for finding in doubtful_commands([run], robot)] == ["whole numbers"]
