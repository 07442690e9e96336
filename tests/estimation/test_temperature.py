"""Friction that depends on logged temperatures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from five_bar_logs import CHI, GAINS, JOINTS, STEEL, Plant, path

from gtau import identify, load_robot, read_run
from gtau.documents.validation import read_group
from gtau.errors import GtauError
from gtau.estimation.results.conclusions import without_temperature
from gtau.result import Result, load
from gtau.signals.channel import SideValues
from gtau.signals.reading.columns import Signals
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run

SLOPES = {"fvt_left": -0.02, "fst_left": -0.03, "fvt_right": -0.025, "fst_right": -0.02}  # per K
BEFORE, AFTER = 25.0, 40.0  # degC
PATHS = {"free": 1, "loaded": 2, "check": 3}


def temperature(run: Run, begin: float, end: float) -> SideValues:
    """Rising as a motor warms up."""
    rise = (1 - np.exp(-2 * run.time / run.time[-1])) / (1 - np.exp(-2))
    return SideValues(run.time, dict.fromkeys(JOINTS, begin + (end - begin) * rise), "degC")


def warm(
    name: str, begin: float = BEFORE, end: float = AFTER, slopes: dict = SLOPES, seconds: float = 20.0, **more
) -> Run:
    """A run whose friction falls with the temperature from its value at 30 degC."""
    run = Plant(noise=0.02).run(name, seconds, seed=PATHS[name], **more)
    _, qd, _ = path(run.time, PATHS[name])
    heat = temperature(run, begin, end)
    command = run.command.copy()
    for j, joint in enumerate(JOINTS):
        above = heat.at(joint, run.time) - 30
        friction = slopes.get(f"fvt_{joint}", 0) * qd[:, j] + slopes.get(f"fst_{joint}", 0) * np.sign(qd[:, j])
        command[:, j] += above * friction / GAINS[j]
    return replace(run, command=command, temperature=heat)


def loaded(run: Run) -> Run:
    return replace(run, payload=Payload(name="steel", mass=STEEL["m"]))


@pytest.fixture(scope="module")
def found() -> Result:
    robot = load_robot("five-bar")
    return identify(robot, [warm("free"), loaded(warm("loaded", payload=STEEL))])


def test_slopes_are_found_with_intervals_that_hold(found: Result) -> None:
    """The terms that are there, at the mean temperature; gains as good as without them."""
    assert set(found.friction) == set(SLOPES)
    for name, slope in SLOPES.items():
        estimate = found.friction[name]
        assert abs(estimate.value - slope) < 4 * estimate.std
        assert estimate.std < 0.15 * abs(slope)
        assert estimate.unit == ("N m s/rad/K" if name.startswith("fvt") else "N m/K")
    assert found.temperatures is not None
    reference = found.temperatures.of_joint["left"]
    assert BEFORE < reference < AFTER
    at_reference = CHI["fv_left"] + SLOPES["fvt_left"] * (reference - 30)
    assert found.parameters["fv_left"].value == pytest.approx(at_reference, abs=4 * found.parameters["fv_left"].std)
    for joint, gain in zip(JOINTS, GAINS, strict=True):
        low, high = found.drive_gains[joint].interval()
        assert low < gain < high
    assert f"the mean, {reference:.4g} degC" in " ".join(found.summary().split())


def test_terms_are_not_found_where_they_are_not() -> None:
    """Temperatures are logged, but friction does not depend on them."""
    robot = load_robot("five-bar")
    result = identify(robot, [warm("free", slopes={}), loaded(warm("loaded", slopes={}, payload=STEEL))])
    assert not [name for name in result.friction if name.startswith(("fvt", "fst"))]


def test_runs_at_other_temperatures_need_no_drift_of_their_own() -> None:
    """What differs between runs is the temperature's: the slopes follow from the runs' means."""
    robot = load_robot("five-bar")
    runs = [warm("free", 25, 26), loaded(warm("loaded", 38, 39, payload=STEEL)), warm("check", 45, 46)]
    result = identify(robot, runs)
    assert set(result.friction) == set(SLOPES)
    assert not [name for name in result.covariance_names if "@" in name]
    for name, slope in SLOPES.items():
        assert abs(result.friction[name].value - slope) < 4 * result.friction[name].std


def test_predictions_use_the_temperature_of_the_run(found: Result, tmp_path: Path) -> None:
    """Torque errors of a warmer run are those of the fit, and larger at the reference temperatures; files hold them."""
    found.save(tmp_path / "model.json")
    again = load(tmp_path / "model.json")
    assert again.temperatures == found.temperatures
    run = warm("check", 44.0, 46.0, seconds=10.0)
    with_it = again.validate(run)
    without = again.validate(replace(run, side={}))
    for warm_one, cold, fit in zip(with_it, without, found.residuals, strict=True):
        assert warm_one.rms < 1.2 * fit.rms
        assert cold.rms > 2 * warm_one.rms


def test_columns_of_a_log(tmp_path: Path) -> None:
    """One column for all joints or one each; a time since start is a column of seconds."""
    time = np.arange(3000) / 500
    q, _, _ = path(time, 1)
    table = {"t": time, "q1": q[:, 0], "q2": q[:, 1], "v1": q[:, 0], "v2": q[:, 1], "T": 20 + time, "T2": 30 + time}
    signals = {"time": "t", "position": {"left": "q1", "right": "q2"}, "current": {"left": "v1", "right": "v2"}}
    one = read_run(table, signals | {"temperature": "T"}).side["temperature"]
    assert one.at("left", np.array([3.0])) == pytest.approx(23, abs=1e-3)
    assert one.at("right", np.array([3.0])) == pytest.approx(23, abs=1e-3)
    right = read_run(table, signals | {"temperature": {"right": "T2"}}, units={"temperature": "s"}).side["temperature"]
    assert list(right.by_joint) == ["right"]
    assert right.at("right", np.array([3.0])) == pytest.approx(33, abs=1e-3)
    assert right.unit == "s"
    with pytest.raises(GtauError, match="no column 'T3'"):
        read_run(table, signals | {"temperature": "T3"})


def test_a_run_without_temperature_among_others_is_refused() -> None:
    robot = load_robot("five-bar")
    runs = [warm("free"), loaded(replace(warm("loaded", payload=STEEL), side={}))]
    with pytest.raises(GtauError, match="run 'loaded' has no temperature, but other runs have"):
        identify(robot, runs)


def test_logs_without_temperatures_are_said_to_be_taken_at_the_reference(found: Result) -> None:
    signals = {"time": "t", "position": {"left": "q1", "right": "q2"}, "current": {"left": "v1", "right": "v2"}}
    (note,) = without_temperature(found, read_group(Signals, "signals", signals))
    assert f"'left' {found.temperatures.of_joint['left']:.4g}" in str(note)
    assert not without_temperature(found, read_group(Signals, "signals", signals | {"temperature": "T"}))
    run = warm("check", seconds=6.0)
    in_kelvin = replace(run, side={"temperature": replace(run.side["temperature"], unit="K")})
    with pytest.raises(GtauError, match="are in K, but the model has degC"):
        found.validate(in_kelvin)
