"""Units by name and as quantities, shares of rated values, motor torques, and presets of makers' logs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gtau.documents.validation import read_group
from gtau.errors import GtauError
from gtau.signals.reading.columns import Signals
from gtau.signals.reading.units import Units, si_factor
from gtau.signals.run import read_run

SIGNALS = {"time": "t", "position": {"a": "qa", "b": "qb"}, "current": {"a": "va", "b": "vb"}}
TORQUES = {"time": "t", "position": {"a": "qa", "b": "qb"}, "torque": {"a": "va", "b": "vb"}}
N = 400
TIME = np.arange(N) / 500
TABLE = np.column_stack([TIME, np.sin(TIME), np.cos(TIME), np.sin(2 * TIME), np.cos(3 * TIME)])


@pytest.fixture
def log(tmp_path: Path) -> Path:
    np.savetxt(tmp_path / "log.csv", TABLE, delimiter=",", header="t,qa,qb,va,vb", comments="")
    return tmp_path / "log.csv"


@pytest.mark.parametrize(
    ("text", "kind", "factor"),
    [
        ("deg", "position", np.pi / 180),
        ("turn", "position", 2 * np.pi),
        ("arcmin", "position", np.pi / 10800),
        ("0.0879 deg", "position", 0.0879 * np.pi / 180),  # of a count
        ("inch", "position", 0.0254),
        ("0.0012 A", "current", 0.0012),
        ("kA", "current", 1e3),
        ("mN m", "torque", 1e-3),
        ("lbf*inch", "torque", 0.45359237 * 9.80665 * 0.0254),
        ("kN", "torque", 1e3),
        ("100 ns", "time", 1e-7),
        ("min", "time", 60.0),
    ],
)
def test_units_by_pint(text: str, kind: str, factor: float) -> None:
    assert si_factor(text, kind) == pytest.approx(factor, rel=1e-12)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("text", "kind"),
    [("9**9**9 s", "time"), ("A/V", "current"), ("rpm", "position"), ("%", "position"), ("0 A", "current"),
     ("A" * 50, "current"), ("__import__('os')", "time"), ("", "time"), ("1e99 A^9", "current"), ("degC", "time")],
)  # fmt: skip
def test_what_is_no_unit_of_the_kind_is_refused(text: str, kind: str) -> None:
    with pytest.raises(ValueError, match=r"^write '.*, not '"):
        si_factor(text, kind)  # type: ignore[arg-type]


def test_what_the_command_is_by_joint(log: Path) -> None:
    units = {"current": {"a": "%", "b": "0.0012 A"}, "rated": {"a": 5.2}}
    run = read_run(log, SIGNALS, units=units)
    np.testing.assert_allclose(run.command, TABLE[:, 3:] * [0.052, 0.0012], rtol=1e-12)
    run = read_run(log, TORQUES, units={"torque": "‰", "rated": {"a": 20, "b": 8}})
    np.testing.assert_allclose(run.command, TABLE[:, 3:] * [0.02, 0.008], rtol=1e-12)


def test_motor_torques_are_those_of_the_joints_by_the_gear_ratio(log: Path) -> None:
    columns = {key: value for key, value in SIGNALS.items() if key != "current"}
    signals = columns | {"motor_torque": SIGNALS["current"], "gear_ratio": {"a": 100, "b": -45}}
    run = read_run(log, signals, units={"torque": {"a": "mN m"}})
    assert run.kind == "torque"
    np.testing.assert_allclose(run.command, TABLE[:, 3:] * [0.1, -45], rtol=1e-12)


@pytest.mark.parametrize(
    ("signals", "units", "sentence"),
    [
        ({}, {"current": "%"}, "which is missing; add 'rated: {JOINT: ...}' in A"),
        ({}, {"current": "%", "rated": {"a": 2}}, "units, rated: joint 'b' has no rated current"),
        ({}, {"rated": {"a": 2}}, "'rated' is given, but no unit is '%' or '‰'; remove it"),
        ({"gear_ratio": {"a": 2}}, {}, "'gear_ratio' is given without 'motor_torque'"),
        ({"motor_torque": {"a": "va"}}, {}, "give the columns of either 'current' or 'torque'"),
        (
            {"current": None, "motor_torque": {"a": "va", "b": "vb"}, "gear_ratio": {"a": 2}},
            {},
            "joint 'b' has a motor torque but no gear ratio; add",
        ),
        ({"preset": "kuka"}, {}, "there is no preset 'kuka'; choose from ur_rtde, ur_rtde_torque, ur-current, "),
        ({"time": ["t"]}, {}, "signals, time:"),
        ({"time": {"position": "t"}}, {}, "signals, time: the key 'command' is missing; add it"),
    ],
)
def test_contradictions_are_refused(log: Path, signals: dict, units: dict, sentence: str) -> None:
    with pytest.raises(GtauError) as refusal:
        read_run(log, SIGNALS | signals, units=units)
    assert sentence in str(refusal.value)


def test_presets(tmp_path: Path) -> None:
    joints = ["pan", "lift"]
    ur = read_group(Signals, "signals", {"preset": "ur_rtde", "joints": joints})
    assert ur.time == "timestamp"
    assert ur.position == {"pan": "actual_q_0", "lift": "actual_q_1"}
    assert ur.current == {"pan": "actual_current_0", "lift": "actual_current_1"}
    by_hand = {"pan": "target_current_0", "lift": "x"}
    target = read_group(Signals, "signals", {"preset": "ur_rtde", "joints": joints, "current": by_hand})
    assert target.command == by_hand
    ros = read_group(Signals, "signals", {"preset": "plotjuggler", "joints": joints})
    assert ros.torque == {"pan": "/joint_states/pan/effort", "lift": "/joint_states/lift/effort"}
    with pytest.raises(GtauError, match=r"the preset 'franka' needs the joints in their order; add 'joints:"):
        read_group(Signals, "signals", {"preset": "franka"})


def test_a_log_of_libfranka(tmp_path: Path) -> None:
    """Names after a comma and a blank, milliseconds."""
    names = "time, success_rate, state.q[0], state.q[1],state.tau_J[0], state.tau_J[1]"
    rows = np.column_stack([1000 * TIME, np.ones(N), TABLE[:, 1:]])
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header=names, comments="")
    run = read_run(tmp_path / "log.csv", {"preset": "franka", "joints": ["a", "b"]})
    np.testing.assert_allclose(run.time, TIME, atol=1e-12)
    np.testing.assert_allclose(run.command, TABLE[:, 3:], rtol=1e-12)
    franka = read_group(Signals, "signals", {"preset": "franka", "joints": ["a"]})
    assert Units(time="s").scale(franka)[2] == 1.0
