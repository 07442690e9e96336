"""Units written in names, brackets and rows: read, or refused by name, in drafts and where a file states none."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gtau.errors import GtauError
from gtau.signals.reading.column_names import parse_column_name
from gtau.signals.reading.discovery import discover
from gtau.signals.reading.drafting import draft_text, guesses
from gtau.signals.reading.experiment import read_experiment
from gtau.signals.reading.logs import find_columns
from gtau.signals.reading.units import read_unit, si_factor, split_unit
from gtau.signals.run import read_run

N = 600
TIME = np.arange(N) / 250
Q = np.column_stack([np.sin(2 * TIME), 0.4 * np.cos(3 * TIME)])
V = np.column_stack([np.sign(np.cos(2 * TIME)) + Q[:, 0], 0.3 - Q[:, 1]])
SIGNALS = {"time": "t", "position": {"a": "q1", "b": "q2"}, "torque": {"a": "tau1", "b": "tau2"}}


def save(path: Path, *head: str) -> Path:
    np.savetxt(path, np.column_stack([TIME, Q, V]), delimiter=",", header="\n".join(head), comments="")
    return path


@pytest.mark.parametrize(
    ("text", "kind", "factor"),
    [
        ("mNm", "torque", 1e-3),
        ("N·m", "torque", 1.0),
        ("kgf cm", "torque", 0.0980665),
        ("kg.cm", "torque", 0.0980665),
        ("oz-in", "torque", 0.00706155),
        ("ft-lb", "torque", 1.35582),
        ("1e-3 Nm", "torque", 1e-3),
        ("turns", "position", 2 * np.pi),
        ("rev", "position", 2 * np.pi),
        ("Grad", "position", np.pi / 180),
        ("º", "position", np.pi / 180),
        ("1/100 deg", "position", np.pi / 18000),
        ("1/0 deg", "position", np.pi / 180),
        ("0.01A", "current", 0.01),
        ("0,1 mA", "current", 1e-4),
        ("Arms", "current", 1.0),
        ("µs", "time", 1e-6),
    ],
)
def test_spellings(text: str, kind: Any, factor: float) -> None:
    unit = read_unit(text)
    assert unit is not None
    assert unit.measures == kind
    assert si_factor(unit.text, kind) == pytest.approx(factor, rel=1e-5)


@pytest.mark.parametrize(
    ("text", "measures"),
    [("rad/s", "velocity"), ("U/min", "velocity"), ("deg/s²", "acceleration"), ("°C", "other"), ("‰", "share")],
)
def test_other_quantities(text: str, measures: str) -> None:
    unit = read_unit(text)
    assert unit is not None
    assert unit.measures == measures


@pytest.mark.parametrize("text", ["measured", "link", "1", "0", "", "1 " * 20000 + "A"])
def test_what_is_no_unit(text: str) -> None:
    assert read_unit(text) is None


@pytest.mark.parametrize(
    ("name", "kind", "label", "unit"),
    [
        ("q1_deg", "position", "1", "deg"),
        ("posDeg1", "position", "1", "deg"),
        ("i1_mA", "current", "1", "mA"),
        ("torque_mNm_1", "torque", "1", "mN m"),
        ("Torque (Nm) 1", "torque", "1", "N m"),
        ("current1 [0.01A]", "current", "1", "0.01 A"),
        ("torque1 [%]", "torque", "1", "%"),
        ("q1 [inc]", "position", "1", "inc"),
        ("q1 [Striche]", "position", "1", "Striche"),
        ("q1_counts", "position", "1", "counts"),
        ("Joint1 [°]", "position", "1", "deg"),
        ("Axis1 [A]", "current", "1", "A"),
        ("Motor1 [rpm]", "velocity", "1", "rpm"),
        ("q1_deg_s", "velocity", "1", "deg_s"),
        ("motor1 [V]", "other", "1", None),
        ("u1 [mNm]", "torque", "1", "mN m"),
        ("tau1 [daNm]", "torque", "1", "daN m"),
        ("q1 [8192 cnt/rev]", "position", "1", "8192 cnt/rev"),
        ("q1 [rev/10]", "position", "1", "rev/10"),
        ("i1 [dA]", "current", "1", "dA"),
        ("i1_milliampere", "current", "1", "mA"),
        ("q1_cdeg", "position", "1", "cdeg"),
        ("time_ms", "time", "", "ms"),
        ("tau1 (ext)", "other", "1", None),
        ("tau1 (m)", "torque", "1", None),
        ("q[1]", "position", "1", None),
        ("position[elbow]", "position", "elbow", None),
        ("terms1", None, "1", None),
    ],
)
def test_units_in_names(name: str, kind: str | None, label: str, unit: str | None) -> None:
    column = parse_column_name(name)
    assert (column.kind, column.label, column.unit) == (kind, label, unit)


def test_a_joint_may_have_the_name_of_a_unit() -> None:
    assert (parse_column_name("q_rev", ["rev"]).unit, parse_column_name("q_rev").unit) == (None, "turn")


@pytest.mark.parametrize(
    "head",
    [
        ("t,q1 [deg],q2 [deg],tau1 [mNm],tau2 [mNm]",),
        ("t,q1_deg,q2_deg,tau1_mNm,tau2_mNm",),
        ("t,q1,q2,tau1,tau2", "s,deg,deg,mNm,mNm"),
        ("t,q1,q2,tau1,tau2", "[s],[°],[°],[mNm],[mNm]"),
        ("title", "t,q1,q2,tau1,tau2", "Unit,deg,deg,mNm,mNm"),
    ],
)
def test_a_draft_takes_units_as_written(head: tuple[str, ...], tmp_path: Path) -> None:
    draft = discover([save(tmp_path / "a.csv", *head)])
    assert draft.units == {"position": "deg", "torque": "mN m"}
    assert tuple(draft.open) == ("robot",)
    (tmp_path / "e.yaml").write_text(draft_text(draft, tmp_path).replace("NAME-OR-FILE", "five-bar"))
    experiment = read_experiment(tmp_path / "e.yaml")
    run = read_run(experiment.runs[0].log, experiment.signals, units=experiment.units)
    np.testing.assert_allclose(run.command, 1e-3 * V, atol=1e-9)
    np.testing.assert_allclose(run.position, np.deg2rad(Q), atol=1e-9)


def test_units_by_joint_and_columns_in_two_units(tmp_path: Path) -> None:
    """A linear axis beside a rotary one; and each position twice, in degrees and rad."""
    mixed = discover([save(tmp_path / "a.csv", "t,q1 [deg],q2 [mm],i1 [A],i2 [mA]")])
    assert mixed.units == {"position": {"j1": "deg", "j2": "mm"}, "current": {"j2": "mA"}}
    twice = discover([save(tmp_path / "b.csv", "t,q1 [deg],q1 [rad],tau1,tau2")])
    assert (twice.signals.position, twice.units) == ({"j1": "q1 [deg]"}, {"position": "deg"})


def test_units_of_hdf5(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["t"], file["q"], file["tau"] = TIME, Q, V
        file["q"].attrs["units"], file["tau"].attrs["unit"] = "deg", np.bytes_("mNm")
    assert discover([tmp_path / "a.h5"]).units == {"position": "deg", "torque": "mN m"}


@pytest.mark.parametrize("unit", ["inc", "counts", "Striche", "%"])
def test_counts_and_shares_are_asked_about(unit: str, tmp_path: Path) -> None:
    draft = discover([save(tmp_path / "a.csv", f"t,q1,q2,tau1 [{unit}],tau2 [{unit}]")])
    assert "counts" in draft.open
    assert any(unit in str(note) for note in guesses(draft, tmp_path))
    text = draft_text(draft, tmp_path).replace("NAME-OR-FILE", "five-bar")
    assert "# CHECK: replace counts and unknown units by the size of one count" in text
    (tmp_path / "e.yaml").write_text(text)
    with pytest.raises(GtauError, match=f"not '{unit}'" if unit != "%" else "the rated value, which is missing"):
        read_experiment(tmp_path / "e.yaml")


@pytest.mark.parametrize("unit", ["A_pk", "Apk", "A peak", "A_peak", "mApk"])
def test_amperes_of_an_amplitude_are_no_amperes(unit: str, tmp_path: Path) -> None:
    """The factor of 1.41 is the user's choice: gains per ampere of amplitude or rms."""
    draft = discover([save(tmp_path / "a.csv", f"t,q1,q2,i1 [{unit}],i2 [{unit}]")])
    assert (draft.units, "counts" in draft.open) == ({"current": unit}, True)
    (tmp_path / "e.yaml").write_text(draft_text(draft, tmp_path).replace("NAME-OR-FILE", "five-bar"))
    with pytest.raises(GtauError, match=f"'{unit}' is an amplitude; write 'A' for gains per ampere of amplitude, or "):
        read_experiment(tmp_path / "e.yaml")


@pytest.mark.parametrize(
    "head",
    [
        ("t,q1,q2,tau1,tau2", "s,Striche,Striche,mNm,mNm"),
        ("t,q1,q2,tau1,tau2", "[s],[Striche],[Striche],[Digits],[mNm]"),
        ("t,q1,q2,tau1,tau2", "s,Striche,Striche,Skt,mNm"),
        ("t,q1,q2,tau1,tau2", "[],[Striche],[Striche],[Skt],[mNm]"),
        ("s,Striche,Striche,mNm,mNm", "t,q1,q2,tau1,tau2"),
        ("Log of the arm,,,,", "t,q1,q2,tau1,tau2", "s,Striche,Striche,mNm,mNm"),
        ("time,Joint 1,Joint 2,Motor 1,Motor 2", "s,Striche,Striche,mNm,mNm"),
    ],
)
def test_unknown_units_in_a_row_are_not_skipped(head: tuple[str, ...], tmp_path: Path) -> None:
    table = find_columns(save(tmp_path / "a.csv", *head))
    assert table.units[table.columns[1]] == "Striche"
    assert table.units[table.columns[-1]] == "mNm"
    assert table.notes == () or "line 1 before" in str(table.notes[0])


def test_names_that_begin_like_units_stay_names(tmp_path: Path) -> None:
    table = find_columns(save(tmp_path / "a.csv", "sec,q1,q2,tau1,tau2", "clock,shoulder,elbow,shoulder,elbow"))
    assert (table.columns[:2], dict(table.units)) == (("sec", "q1"), {})
    assert str(table.notes[0]).startswith("skipped line 2 before the table")


@pytest.mark.parametrize(
    "head",
    [
        (",Joint 1,Joint 2,Joint 1,Joint 2", "t,angle,angle,torque,torque", "s,deg,deg,mNm,mNm"),
        (",Joint 1,,Joint 2,", "s,angle [deg],torque [mNm],angle [deg],torque [mNm]"),
        ("t [s],Angle,,Torque,", ",J1 [deg],J2 [deg],J1 [mNm],J2 [mNm]"),
    ],
)
def test_a_second_header_row_completes_names(head: tuple[str, ...], tmp_path: Path) -> None:
    """Of merged cells of a spreadsheet only the first has a text."""
    draft = discover([save(tmp_path / "a.csv", *head)])
    assert draft.units == {"position": "deg", "torque": "mN m"}
    assert list(draft.signals.position) == ["j1", "j2"]


@pytest.mark.parametrize("head", [("t,q1,q2,tau1 [mNm],tau2",), ("t,q1,q2,tau1,tau2", "s,rad,rad,mNm,mNm")])
def test_a_written_unit_must_be_stated(head: tuple[str, ...], tmp_path: Path) -> None:
    """An experiment file that says nothing of it would take SI units; what it says counts."""
    log = save(tmp_path / "a.csv", *head)
    column = head[0].split(",")[3]
    signals = SIGNALS | {"torque": {"a": column, "b": "tau2"}}
    with pytest.raises(GtauError, match=r"is in 'mN m' by the log, but the experiment file states no unit"):
        read_run(log, signals)
    for unit, factor in (("mN m", 1e-3), ("N m", 1.0)):
        np.testing.assert_allclose(read_run(log, signals, units={"torque": unit}).command, factor * V, atol=1e-9)


def test_seconds_and_nanoseconds_need_no_units(tmp_path: Path) -> None:
    table = np.column_stack([np.floor(TIME), np.rint(1e9 * (TIME % 1)), Q, V])
    np.savetxt(tmp_path / "a.csv", table, delimiter=",", header="t_s,t_ns,q1,q2,tau1,tau2", comments="", fmt="%.9f")
    run = read_run(tmp_path / "a.csv", SIGNALS | {"time": ["t_s", "t_ns"]})
    np.testing.assert_allclose(run.time, TIME, atol=1e-8)


def test_a_written_unit_of_time_is_not_replaced_by_a_likelier_one(tmp_path: Path) -> None:
    log = save(tmp_path / "a.csv", "t [ms],q1,q2,tau1,tau2")
    draft = discover([log])
    assert draft.units["time"] == "ms"
    assert "not a plausible sampling rate in ms" in draft.reasons.time


@pytest.mark.parametrize(
    ("name", "rest", "unit"),
    [
        ("i_left/mA", "i_left", "mA"),
        ("q_left / °", "q_left", "deg"),
        ("t/ms", "t", "ms"),
        ("tau/(mN m)", "tau", "mN m"),
        ("q (gon)", "q", "gon"),
        ("/joint_states/effort/a", "/joint_states/effort/a", ""),
        ("effort/shoulder", "effort/shoulder", ""),
        ("i/A", "i/A", ""),  # perhaps joint A: the same without a unit
    ],
)
def test_units_stand_after_a_stroke_as_physicists_label_axes(name: str, rest: str, unit: str) -> None:
    left, found = split_unit(name)
    assert left == rest
    assert (found.text if found else "") == unit
