"""Collision thresholds: as many false alarms as stated, and a contact that exceeds them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from five_bar_logs import STEEL, Plant

from gtau.errors import GtauError
from gtau.export.thresholds import SPEEDS, Residual, export_thresholds, peaks, raised, residual_of, thresholds
from gtau.model.home import load_robot
from gtau.result import Result, identify
from gtau.signals.reading.statements import Payload


def noise(seed: int, seconds: float, scale: float = 1.0) -> Residual:
    """Two joints whose residuals are Laplace, thrice as large in the lowest range of speed, at 5 Hz."""
    rng = np.random.default_rng(seed)
    count = round(5 * seconds)
    cell = rng.integers(0, len(SPEEDS) + 1, (count, 2))
    return scale * rng.exponential(size=(count, 2)) * np.where(cell == 0, 3.0, 1.0), cell, 0.2


@pytest.mark.parametrize("seconds", [20.0, 500.0])
def test_alarms_come_as_often_as_stated(seconds: float) -> None:
    values = thresholds([noise(k, 200.0) for k in range(3)], seconds)
    assert np.all(values[0] > 2 * values[1:])
    torque, cell, _ = noise(9, 1e5)
    over = (torque > np.take_along_axis(values, cell, axis=0)).any(axis=1)
    assert 0.6 < len(peaks(over.astype(float), 0.2, 0.5)) / (1e5 / seconds) < 1.7


def test_a_log_with_more_noise_raises_all_thresholds() -> None:
    alike = [noise(k, 100.0) for k in range(4)]
    total = 400.0
    factor, _ = raised(alike, total / 10)
    assert factor < 1.15
    more, alarms = raised([*alike[:3], noise(3, 100.0, scale=2.0)], total / 10)
    assert alarms > 20
    assert more > 1.4
    with pytest.raises(GtauError, match="the logs differ too much for thresholds"):
        raised([*alike[:3], noise(3, 100.0, scale=40.0)], total / 10)


@pytest.fixture(scope="module")
def model() -> Result:
    plant = Plant(noise=0.05)
    loaded = replace(plant.run("loaded", payload=STEEL, seed=2), payload=Payload(name="steel", mass=STEEL["m"]))
    return identify(load_robot("five-bar"), [plant.run("free", seed=1), loaded])


@pytest.mark.parametrize("observer", [None, 10.0])
def test_a_contact_exceeds_what_free_motion_does_not(model: Result, tmp_path: Path, observer: float | None) -> None:
    free = [Plant(noise=0.05).run(f"free {k}", seed=k) for k in (5, 6, 7)]
    export_thresholds(model, free, tmp_path, hours=1.0, observer=observer)
    document = json.loads((tmp_path / "thresholds.json").read_text())
    values = {joint: [] for joint in model.idm.actuated}
    for cell in document["thresholds"]:
        values[cell["joint"]].append(cell["threshold"])
        assert cell["unit"] == "N m"
    assert all(0 < value < 1.0 for of_joint in values.values() for value in of_joint)
    command = free[0].command.copy()
    command[1000:1500, 0] -= 2.0 / 2.5  # 2 N m from outside, for a second
    pushed, _, _ = residual_of(model, replace(free[0], command=command), 0 * command, observer)
    assert pushed[:, 0].max() > 1.5 > max(values["left"])
    with pytest.raises(GtauError, match="two runs without contact, listed under"):
        export_thresholds(model, free[:1], tmp_path)
