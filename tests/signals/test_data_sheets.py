"""Data sheets of motors and gears: what is expected at the joint, and what an experiment makes of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gtau.errors import GtauError
from gtau.findings import Grade
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.result import identify
from gtau.signals.reading.experiment import read_experiment
from gtau.signals.reading.statements import Drive, check_drives

SHEET = "{gear_ratio: 50, torque_constant: 0.05, efficiency: 0.8, rotor_inertia: 2.0e-5}"


def bench(folder: Path, drives: str, gain: float = 2.1) -> Path:
    """An experiment on a test bench, with and without a disc of 2 kg on it."""
    robot = load_robot("test-bench")
    rng = np.random.default_rng(0)
    t = np.arange(0, 20, 0.004)
    w, phase = 2 * np.pi * np.array([0.2, 0.5, 0.9, 1.4, 2.1]), rng.uniform(0, 2 * np.pi, 5)
    angle, size = w * t[:, None] + phase, 0.9 / w
    motion = (np.sin(angle) @ size, np.cos(angle) @ (size * w), -np.sin(angle) @ (size * w**2))
    truth = {"mx_arm": 0.12, "yy_arm": 0.03, "ia_arm": 0.05, "fv_arm": 0.4, "fs_arm": 0.9}
    disc = {"m_arm": 2.0, "mx_arm": 0.5, "yy_arm": 0.13}
    for name, load in (("free", {}), ("loaded", disc)):
        chi = {parameter: truth.get(parameter, 0.0) + load.get(parameter, 0.0) for parameter in truth | load}
        tau = InverseDynamics(robot).torques(*(x[:, None] for x in motion), chi)[:, 0]
        columns = np.column_stack([t, motion[0], tau / gain + 0.02 * rng.normal(size=t.size)])
        np.savetxt(folder / f"{name}.csv", columns, delimiter=",", header="t,q,v", comments="", fmt="%.9g")
    return experiment(folder, drives)


def experiment(folder: Path, drives: str, more: str = "", signal: str = "current") -> Path:
    for name in ("free", "loaded"):
        (folder / f"{name}.csv").touch()
    path = folder / "experiment.yaml"
    path.write_text(f"""robot: test-bench
signals: {{time: t, position: {{arm: q}}, {signal}: {{arm: v}}}}
{more}
drives: {{arm: {drives}}}
runs:
  - log: free.csv
  - {{log: loaded.csv, payload: {{name: disc, mass: 2, parameters: {{mx: 0.5}}}}}}
""")
    return path


def test_what_is_expected_at_the_joint() -> None:
    drive = Drive(gear_ratio=-50, torque_constant=0.05, efficiency=0.8, rotor_inertia=2e-5)
    assert drive.gain == (pytest.approx(-2.0), pytest.approx(0.2))
    assert drive.inertia == (pytest.approx(0.05), pytest.approx(0.005))
    vague = Drive(gear_ratio=100, torque_constant=0.1)
    assert vague.gain == (pytest.approx(8.5), pytest.approx(8.5 * np.hypot(0.1, 0.1 / 0.85)))
    assert vague.inertia is None
    assert Drive(torque_constant=0.1, uncertainty=0.02).gain == (pytest.approx(0.085), pytest.approx(0.0017))


def test_it_stands_beside_the_estimate_and_is_a_prior(tmp_path: Path) -> None:
    path = bench(tmp_path, SHEET)
    described = read_experiment(path)
    assert described.expected_gains == {"arm": pytest.approx(2.0)}
    assert described.expected_parameters["ia_arm"].value == pytest.approx(0.05)
    result = identify(path)
    assert result.drive_gains["arm"].value == pytest.approx(2.1, rel=0.01)
    (note,) = (note for note in result.notes if "data sheet" in str(note))
    assert str(note).startswith("gain of 'arm': 2.")
    assert "2 N m/A is by the data sheet (standard deviation 0.2;" in str(note)
    assert str(note) in " ".join(result.summary().split())


def test_a_gain_far_off_the_data_sheet_is_contradictory(tmp_path: Path) -> None:
    result = identify(bench(tmp_path, "{gear_ratio: 5, torque_constant: 0.05}"))
    assert result.drive_gains["arm"].verdict.finding.kind == "prior gain"


def test_motors_that_turn_against_their_joints_may_have_negative_gains(tmp_path: Path) -> None:
    """Which are contradictory where nobody expects them."""
    expected = identify(bench(tmp_path, SHEET.replace("50", "-50", 1), gain=-2.1)).drive_gains["arm"]
    assert expected.value == pytest.approx(-2.1, rel=0.01)
    assert expected.verdict.outcome == Grade.GOOD
    unexpected = identify(bench(tmp_path, "{rotor_inertia: 2.0e-5}", gain=-2.1)).drive_gains["arm"]
    assert unexpected.verdict.finding.kind == "all gains negative"


@pytest.mark.parametrize(
    ("drives", "more", "message"),
    [
        ("{gear_ratio: 0, torque_constant: 1}", "", "drives.arm.gear_ratio: the gear ratio is zero; write rad of"),
        ("{gear_ratio: 5}", "", "neither 'torque_constant' nor 'rotor_inertia' is given; add one"),
        ("{rotor_inertia: 1, efficiency: 0.8}", "", "'efficiency' is given without 'torque_constant'"),
        ("{torque_constant: 1}", "prior_gains: {arm: 2}", "joint 'arm' has a 'prior_gains' too; remove it"),
        ("{rotor_inertia: 1}", "priors: {ia_arm: {min: 0}}", "'priors' has 'ia_arm' too; remove it"),
        ("{torque_constant: 1, efficency: 1}", "", "unknown key 'efficency'; did you mean 'efficiency'"),
    ],
)
def test_drives_that_cannot_be(drives: str, more: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(GtauError, match=message):
        read_experiment(experiment(tmp_path, drives, more))


def test_torques_need_no_torque_constant(tmp_path: Path) -> None:
    with pytest.raises(
        GtauError, match="the signals hold torques, which need no torque constant; remove the 'torque_constant' of"
    ):
        read_experiment(experiment(tmp_path, SHEET, signal="torque"))


def test_a_gear_is_not_counted_twice() -> None:
    """The motors of the catalog's TX40 are joints of their own, with the gears in its couplings."""
    robot = load_robot("staubli-tx40")
    check_drives({robot.actuated[0]: Drive(torque_constant=0.3)}, robot)
    with pytest.raises(GtauError, match="is the shaft of a motor, whose gear ratio is in the couplings of robot"):
        check_drives({robot.actuated[0]: Drive(gear_ratio=32, torque_constant=0.3)}, robot)
