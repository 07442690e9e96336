"""Logs with rests, one joint at a time, and runs of different rates give the gains of the plant."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from five_bar_logs import GAINS, JOINTS, STEEL, Plant, five_bar

from gtau.result import identify
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run

KNOWN = Payload(name="steel", mass=STEEL["m"], parameters={k: v for k, v in STEEL.items() if k != "m"})


def runs(seconds: float = 20.0) -> list[Run]:
    plant = Plant(noise=0.01)
    return [
        plant.run("free", seconds, seed=1),
        replace(plant.run("loaded", seconds, payload=STEEL, seed=2), payload=KNOWN),
    ]


def at_rest_in_the_second_half(run: Run) -> Run:
    """Exactly at rest, with currents that hold it or stand still."""
    position, command = np.array(run.position), np.array(run.command)
    half = len(position) // 2
    position[half:], command[half:] = position[half], command[half]
    return replace(run, position=position, command=command)


def slower(run: Run, step: int) -> Run:
    return replace(
        run,
        time=np.array(run.time[::step]),
        position=np.array(run.position[::step]),
        command=np.array(run.command[::step]),
        valid=np.array(run.valid[::step]),
    )


def assert_gains(found: list[Run], within: float) -> None:
    result = identify(five_bar().robot, found)
    for joint, gain in zip(JOINTS, GAINS, strict=True):
        estimate = result.drive_gains[joint]
        assert estimate.value == pytest.approx(gain, rel=within)
        assert abs(estimate.value - gain) < 4 * estimate.std


def test_a_log_whose_second_half_is_exactly_at_rest() -> None:
    assert_gains([at_rest_in_the_second_half(run) for run in runs(40.0)], 0.02)


def test_runs_of_different_rates() -> None:
    free, loaded = runs()
    assert_gains([free, slower(loaded, 2)], 0.02)
