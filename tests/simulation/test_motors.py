"""Simulated motors with voltages: what they log, and the way back by identification."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest
from five_bar_logs import CHI, JOINTS

from gtau.errors import GtauError
from gtau.result import identify
from gtau.simulation.simulate import simulate

GAINS = {"left": 2.5, "right": 4.0}
MOTOR = {"resistance": 0.6, "dead_time": 0.01, "warming": 0.1, "duty_quantum": 1 / 2048, "commutation": 0.002}
SENSORS = {"position_quantum": 1e-5, "current_noise": 0.01, "current_quantum": 0.005}


def described(logs: list[str], seconds: float = 12.0, drive: dict[str, float] | None = None, **more: object) -> dict:
    """A simulation file of a five-bar on a supply."""
    drives = {joint: {"gain": GAINS[joint], **MOTOR, **SENSORS, **(drive or {})} for joint in JOINTS}
    run = {"name": "log", "trajectory": {"sines": {"seed": 1, "duration": seconds, "share": 0.8}}}
    document = {"robot": "five-bar", "rate": 500, "bandwidth": 60, "parameters": CHI, "drives": drives, "runs": [run]}
    return document | {"supply": {"voltage": 24, "resistance": 0.05}, "logs": logs} | more


@pytest.mark.parametrize(
    ("logs", "drive", "more"),
    [
        (["voltage"], {"inductance": 1e-3}, {}),
        pytest.param(["duty", "supply_voltage"], {"convention": "amplitude"}, {}, marks=pytest.mark.slow),
        (["goal", "supply_voltage"], {"proportional_gain": 20.0, "dead_band": 0.0}, {"log_rate": 250}),
    ],
)
def test_gains_come_back_from_simulated_voltages(tmp_path: Path, logs: list[str], drive: dict, more: dict) -> None:
    simulate(described(logs, drive=drive, **more), tmp_path)
    result = identify(tmp_path / "experiment.yaml")
    assert "scale: from the voltages of 2 motors (efficiency of commutation 0.2 %, stated)" in result.summary(False)
    for joint, gain in GAINS.items():
        low, high = result.drive_gains[joint].interval()
        assert low < gain < high
        assert high - low < 0.03 * gain
        low, high = result.motors[f"R_{joint}"].interval()
        assert low < 0.6 * 1.06 < high  # ohm, as warm as on average


def test_what_a_servo_logs(tmp_path: Path) -> None:
    """Duty is the gain times goal less position, but in the dead band; supply currents are the motor's times duty."""
    drive = {"proportional_gain": 20.0, "dead_band": 0.005, "duty_quantum": 0.0, "current_noise": 0.0}
    logs = ["goal", "duty", "voltage", "supply_voltage", "supply_current"]
    simulate(described(logs, 4.0, drive | {"current_quantum": 0.0}), tmp_path)
    log = pl.read_csv(tmp_path / "log.csv")
    duty, error = log["duty_left"].to_numpy(), (log["goal_left"] - log["qleft"]).to_numpy()
    pushed = 20.0 * np.sign(error) * np.maximum(np.abs(error) - 0.005, 0)
    assert duty == pytest.approx(np.clip(pushed, -1, 1), abs=2e-4)  # positions are rounded to 1e-5
    assert np.mean(duty == 0) > 0.05
    assert log["supply_current_left"].to_numpy() == pytest.approx(duty * log["vleft"].to_numpy(), abs=1e-6)
    assert log["voltage_left"].to_numpy() == pytest.approx(duty * log["supply_voltage_left"].to_numpy(), abs=1e-6)
    assert log["supply_voltage_left"].min() < 23.99
    assert "supply_current: {left: supply_current_left" in (tmp_path / "experiment.yaml").read_text()


def test_voltage_limits_the_current(tmp_path: Path) -> None:
    simulate(described(["duty"], 3.0, supply={"voltage": 6.0}), tmp_path)
    log = pl.read_csv(tmp_path / "log.csv")
    assert log["duty_right"].abs().max() == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"supply": None}, "'duty' is logged without a supply"),
        ({"drives": {joint: {"gain": 1.0} for joint in JOINTS}}, "the motor of 'left' has no 'resistance'"),
        (
            {"drives": {joint: {"gain": 1.0, "proportional_gain": 9.0, "inductance": 1e-3} for joint in JOINTS}},
            "a servo .* has currents without a lag; remove 'inductance'",
        ),
        ({"log_rate": 300}, "a log_rate of 300 Hz is no part of the rate, 500 Hz"),
    ],
)
def test_descriptions_that_lack_something(tmp_path: Path, change: dict, message: str) -> None:
    document = {key: value for key, value in (described(["duty"]) | change).items() if value is not None}
    with pytest.raises(GtauError, match=message):
        simulate(document, tmp_path)
