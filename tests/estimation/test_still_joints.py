"""A joint that moves while its position is logged constant is named; one that is held is not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from stated_arm import plant, robot

from gtau.result import Result, identify
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run

BODY = {"m": 1.5, "mx": 0.05, "mz": 0.1}
KNOWN = Payload(name="disc", mass=BODY["m"])
HOME, AMPLITUDES = (0.0, 0.3, 0.8, 0.0), (1.2, 0.9, 1.2, 1.5)


def logged(folder: Path, held: int | None) -> list[Run]:
    """A run without and one with a payload; a joint may be held in the second."""
    made = replace(plant(robot(folder), noise=0.01), tool="j4", gains=(8.0, 9.0, 7.0, 5.0))
    still = replace(made, amplitudes=[0.0 if j == held else size for j, size in enumerate(AMPLITUDES)])
    return [made.run(1), still.run(2, BODY, KNOWN)]


def frozen(result: Result) -> set[tuple[str, ...]]:
    verdicts = [gain.verdict.finding for gain in result.drive_gains.values()]
    return {each.joints for each in verdicts if each is not None and each.kind == "frozen encoder"}


@pytest.mark.parametrize("joint", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_an_encoder_that_is_not_read_is_named(tmp_path: Path, joint: int) -> None:
    free, loaded = logged(tmp_path, held=None)
    position = loaded.position.copy()
    position[:, joint] = position[0, joint]
    found = frozen(identify(robot(tmp_path), [free, replace(loaded, position=position)]))
    assert {each[0] for each in found} == {f"j{joint + 1}"}


@pytest.mark.parametrize("joint", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_held_joint_is_not_suspected(tmp_path: Path, joint: int) -> None:
    """Its motor holds the others' weight, so its current varies with theirs."""
    free, loaded = logged(tmp_path, held=joint)
    assert np.ptp(loaded.position[:, joint]) == 0
    assert np.ptp(loaded.command[:, joint]) > 1
    assert not frozen(identify(robot(tmp_path), [free, loaded]))
