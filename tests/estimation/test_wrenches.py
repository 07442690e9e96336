"""Measured wrenches on bodies from outside: feet that carry a robot, and a force sensor between flange and tool."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest
from floating_logs import AT_HOOK, AT_SOLE, GAINS, ON_PLATE, POSE, RATE, Truth, deviations, experiment, simulated

from gtau.errors import GtauError
from gtau.estimation.diagnostics.verdict import WRENCHES
from gtau.findings import Grade
from gtau.result import Result, check, identify, load
from gtau.signals.reading.experiment import read_experiment
from gtau.signals.run import read_run

BASE = f"{{body: trunk, {POSE}}}"
HELD = f"{{body: trunk, {POSE}, wrenches: [{AT_HOOK}]}}"


@pytest.fixture(scope="module")
def standing() -> Truth:
    return simulated(2, foot=1.0)


@pytest.fixture(scope="module")
def leaning() -> Truth:
    return simulated(5, foot=0.4, swaying=0.2)


@pytest.mark.parametrize("wrench", [AT_SOLE, ON_PLATE], ids=["sole", "plate"])
def test_gains_from_the_wrench_on_a_foot(wrench: str, standing: Truth, tmp_path: Path) -> None:
    result = identify(experiment(tmp_path, f"{BASE}\n  wrenches: [{wrench}]", standing))
    check_errors(result, deviations(result, standing.chi), 46)
    assert {source for shares in result.scale.values() for source in shares} == {"measured wrenches"}
    assert [result.drive_gains[joint].verdict.outcome for joint in "23"] == [Grade.GOOD] * 2
    # noise takes over in the tracked pose from 3 Hz on, and in the joints' positions from 5 Hz on
    assert result.preparation.decimator.cutoff(RATE) < 4.0


@pytest.mark.slow
def test_a_force_sensor_between_flange_and_tool_gives_the_scale(tmp_path: Path) -> None:
    """Neither mass nor place of the tool is known: its wrench is measured, with and without the tool."""
    bare, carrying = simulated(4, moving=False), simulated(5, moving=False, tool=True)
    path = experiment(tmp_path, "", bare, f"  wrenches: [{AT_SOLE}]")
    pl.DataFrame(carrying.columns).write_csv(tmp_path / "tool.csv")
    path.write_text(path.read_text().replace("runs: [", "runs: [{log: tool.csv}, "))
    with pytest.raises(GtauError, match="measured wrenches act on 3 too; use method='ml'"):
        identify(path, method="didim")
    result = identify(path)
    z = [(result.drive_gains[joint].value - gain) / result.drive_gains[joint].std for joint, gain in GAINS.items()]
    check_errors(result, np.array(z), 3)
    on_another = path.with_name("another.yaml")
    on_another.write_text(path.read_text().replace("body: 3", "body: 2"))
    wrong = [gain.verdict for gain in identify(on_another).drive_gains.values()]
    assert Grade.CONTRADICTORY in {verdict.outcome for verdict in wrong}
    assert all(WRENCHES in each.advice for each in wrong if each.outcome == Grade.CONTRADICTORY)
    for joint in GAINS:
        assert dict(result.scale[joint]) == pytest.approx({"wrench on '3'": 1.0})
        assert result.drive_gains[joint].verdict.outcome in (Grade.GOOD, Grade.WEAK)


def test_a_tool_in_every_run_gives_no_scale(tmp_path: Path) -> None:
    """Its wrench is what the inertia of the last link would do as well, but for noise."""
    carrying = simulated(5, moving=False, tool=True)
    path = experiment(tmp_path, "", carrying, f"  wrenches: [{AT_SOLE}]")
    with pytest.raises(
        GtauError, match="the wrench on 3 moves as one of the robot's own bodies in every run, so"
    ) as no:
        identify(path)
    assert [f"{note}." for note in check(path).notes if note.kind == "scale of the gains"] == [str(no.value)]


def test_a_hook_and_a_foot_share_the_weight(leaning: Truth, tmp_path: Path) -> None:
    path = experiment(tmp_path, f"{HELD}\n  wrenches: [{AT_SOLE}]", leaning)
    result = identify(path)
    check_errors(result, deviations(result, leaning.chi), 46)
    result.save(tmp_path / "model.json")
    again, described = load(tmp_path / "model.json"), read_experiment(path)
    errors = again.validate(read_run(tmp_path / "log.csv", signals=described.signals, units=described.units))
    assert len(errors) == 9
    assert max(error.relative for error in errors) < 6
    tool = {"name": "tool", "mass": 1.0}
    carrying = read_run(tmp_path / "log.csv", described.signals, tool, described.units)
    with pytest.raises(GtauError, match="whose wrench is measured: the sensor feels it"):
        again.predict(carrying)


def check_errors(result: Result, z: np.ndarray, count: int) -> None:
    """The errors ``z`` of parameters and gains are as large as their standard deviations say."""
    for joint, gain in GAINS.items():
        assert result.drive_gains[joint].value == pytest.approx(gain, rel=0.1)
    assert len(z) == count
    assert np.sqrt(np.mean(z**2)) < 1.6
    assert np.abs(z).max() < 4.5


@pytest.mark.slow
def test_a_foot_left_out_shows(leaning: Truth, tmp_path: Path) -> None:
    result = identify(experiment(tmp_path, HELD, leaning))
    (verdict,) = {gain.verdict for gain in result.drive_gains.values()}
    assert verdict.outcome == Grade.CONTRADICTORY
    assert (verdict.finding.kind, verdict.finding.subject) == ("unexplained base wrench", "trunk")
    assert "of the forces" in verdict.why


REFUSED = [
    ("method: tls", AT_SOLE, {"method": "tls"}, "method 'tls' takes no wrenches on bodies"),
    ("method: didim", AT_SOLE, {"method": "didim"}, "motion is simulated from the currents of motors"),
    (
        "body",
        AT_SOLE.replace("body: 3", "body: foot"),
        {},
        "but a body of robot 'arm' has the name of its joint: 1, 2, 3; write the joint that moves it, and, with",
    ),
    ("close", AT_SOLE.replace("body: 3", "body: '33'"), {}, "write the joint that moves it (did you mean '3'?)"),
    ("base", AT_SOLE.replace("body: 3", "body: trunk"), {}, "under 'wrenches' of 'base'"),
    ("twice", AT_SOLE.replace("[sx, sy, sz]", "[sx, sy, smx]"), {}, "the column 'smx' under 'wrenches' is given twice"),
]


@pytest.mark.parametrize(
    ("wrench", "options", "sentence"), [case[1:] for case in REFUSED], ids=[case[0] for case in REFUSED]
)
def test_refusals(wrench: str, options: dict, sentence: str, standing: Truth, tmp_path: Path) -> None:
    with pytest.raises(GtauError) as refused:
        identify(experiment(tmp_path, f"{BASE}\n  wrenches: [{wrench}]", standing), **options)
    assert sentence in str(refused.value)


@pytest.mark.slow
def test_the_calibration_of_the_sensor_is_in_every_interval(standing: Truth, tmp_path: Path) -> None:
    """Gains rest on the wrench alone: what it is uncertain by, they are too."""
    with_wrench = f"{BASE}\n  wrenches: [{AT_SOLE}]"
    exact = identify(experiment(tmp_path, with_wrench, standing))
    known = identify(experiment(tmp_path, f"{with_wrench}\n  calibration: {{wrenches: 0.02}}", standing))
    for joint, gain in GAINS.items():
        before, after = exact.drive_gains[joint], known.drive_gains[joint]
        assert after.value == before.value
        assert np.sqrt(after.std**2 - before.std**2) == pytest.approx(0.02 * gain, rel=0.2)


@pytest.mark.parametrize("units", ["N", "kN"])
def test_check_shows_the_wrench(units: str, standing: Truth, tmp_path: Path) -> None:
    path = experiment(tmp_path, f"{BASE}\n  wrenches: [{AT_SOLE}]", standing)
    if units == "kN":
        thousandths = {name: 1e-3 * each if name.startswith("s") else each for name, each in standing.columns.items()}
        pl.DataFrame(thousandths).write_csv(tmp_path / "log.csv")
        path.write_text(path.read_text().replace("length: mm}", "length: mm}, wrenches: {force: kN, moment: kN m}"))
    ((wrench,),) = (log.wrenches for log in check(path).logs)
    weight = 9.80665 * sum(value for name, value in standing.chi.items() if name.startswith("m_"))
    assert (wrench.body, wrench.axes) == ("3", "body")
    assert wrench.force_rms == pytest.approx(weight, rel=0.1)


@pytest.mark.parametrize(("factor", "wrong"), [(1.0, False), (1e-3, True)], ids=["N", "kN"])
def test_the_weighed_mass_is_compared_with_the_wrenches(
    factor: float, wrong: bool, standing: Truth, tmp_path: Path
) -> None:
    mass = sum(value for name, value in standing.chi.items() if name.startswith("m_"))
    prior = f"priors: {{m_trunkR: {{value: {mass}, std: {2e-3 * mass}}}}}"
    columns = {name: factor * each if name.startswith("s") else each for name, each in standing.columns.items()}
    result = identify(experiment(tmp_path, f"{BASE}\n  wrenches: [{AT_SOLE}]", Truth(standing.chi, columns), prior))
    assert wrong == ("contradictory prior" in {note.kind for note in result.notes})
    assert wrong == ({gain.verdict.outcome for gain in result.drive_gains.values()} == {Grade.CONTRADICTORY})
    assert "mass of the whole robot (m_trunkR)" in result.summary()


def test_a_payload_on_the_sensor_counts_once(tmp_path: Path) -> None:
    path = experiment(tmp_path, "", simulated(5, moving=False, tool=True), f"  wrenches: [{AT_SOLE}]")
    path.write_text(path.read_text().replace("log.csv}", "log.csv, payload: {name: tool, mass: 3.0}}"))
    with pytest.raises(GtauError, match="payload 'tool' is on '3', whose wrench is measured: the sensor feels it"):
        identify(path)
