"""Currents of a size that no drive has are asked about, by ``check`` and ``identify``."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest
from five_bar_logs import Plant

from gtau.estimation.grades import Grade, grade_of
from gtau.estimation.regression.dataset import reduce_runs
from gtau.estimation.regression.doubtful_currents import doubtful_currents
from gtau.model.home import load_robot
from gtau.signals.notes import Kind
from gtau.signals.run import Run


@pytest.fixture(scope="module")
def run() -> Run:
    return Plant(noise=0.01).run("free", 10.0, seed=1)


def test_currents_of_drives_are_not_doubted(run: Run) -> None:
    assert doubtful_currents([run, run]) == []


@pytest.mark.parametrize(
    ("factors", "sentence"),
    [
        ([1e3, 1e3], r"A rms, more than drives of robots take; if it is in mA, say so \(units: \{current: mA\}\)"),
        (
            [100.0, 1.0],
            r"the current of joint 'left' is [\d.]+ times that of 'right' .* the columns are in the same unit",
        ),
        (
            [1.0, 60.0],
            r"the current of joint 'right' is [\d.]+ times that of 'left' .* the columns are in the same unit",
        ),
    ],
)
def test_doubtful_sizes_are_worth_mending(run: Run, factors: list[float], sentence: str) -> None:
    dataset = reduce_runs(load_robot("five-bar"), [replace(run, command=run.command * factors)])
    (note,) = [each for each in dataset.notes if each.kind == Kind.UNIT]
    assert grade_of(note) == Grade.WARNING
    assert re.search(sentence, str(note))
