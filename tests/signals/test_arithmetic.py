"""Columns computed from others, where a log has no column of what is asked for: sums and products, nothing else."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gtau.errors import GtauError
from gtau.signals.reading.logs import read_log
from gtau.signals.run import read_run

TIME = np.arange(400) / 250
J2, J3 = np.sin(2 * TIME), 0.4 * np.cos(3 * TIME)
TAU = np.sign(np.cos(2 * TIME)) + J2


@pytest.fixture
def log(tmp_path: Path) -> Path:
    counts = np.rint(2048 + np.rad2deg(J2) / 0.0879)
    table = np.column_stack([1e3 * TIME, J2, J3, counts, TAU, -TAU])
    path = tmp_path / "a.csv"
    np.savetxt(path, table, delimiter=",", header="ms,J2,J3,pos,tau 2,tau.3", comments="", fmt="%.12g")
    return path


def run_of(log: Path, **signals: Any) -> Any:
    entries = {"time": "ms / 1000", "position": {"j2": "J2"}, "torque": {"j2": "`tau 2`"}} | signals
    return read_run(log, entries, units={"time": "s"})


def test_coupled_angles(log: Path) -> None:
    """A robot that reports its third angle from the horizontal (Fanuc), and the sign of a motor on its other side."""
    position, torque = {"j2": "J2", "j3": "J3 + J2"}, {"j2": "tau 2", "j3": "-2 * (`tau.3` - 0.5) / 4"}
    run = run_of(log, position=position, torque=torque)
    np.testing.assert_allclose(run.position, np.column_stack([J2, J3 + J2]), atol=1e-9)
    np.testing.assert_allclose(run.command, np.column_stack([TAU, TAU / 2 + 0.25]), atol=1e-9)
    np.testing.assert_allclose(run.time, TIME, atol=1e-9)


def test_counts_of_an_encoder(log: Path) -> None:
    signals = {"time": {"rate": 250}, "position": {"j2": "(pos - 2048) * 0.0879"}, "torque": {"j2": "tau 2"}}
    run = read_run(log, signals, units={"position": "deg"})
    np.testing.assert_allclose(run.position[:, 0], J2, atol=np.deg2rad(0.0879))


def test_products_of_columns_and_of_columns_without_a_header(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "a.txt", np.column_stack([J2, J3]))
    (values, _), *_ = read_log(tmp_path / "a.txt", ["2", "`1` * `2` + 1"]).blocks()
    np.testing.assert_allclose(values, np.column_stack([J3, J2 * J3 + 1]))


def test_a_column_of_that_name_comes_first(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "a.csv", np.column_stack([J2, J3, TAU]), delimiter=",", header="a,b,a - b", comments="")
    (values, _), *_ = read_log(tmp_path / "a.csv", ["a - b"]).blocks()
    np.testing.assert_allclose(values[:, 0], TAU)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("J3 + J4", "there is no column 'J4'; the columns are ms, J2, J3, pos, tau 2, tau.3"),
        ("J3 - `tau 4`", "there is no column 'tau 4'; did you mean 'tau.3'"),
        ("J3 ^ 2", r"because of '\^'; a column"),
        ("sin(J3)", r"in 'sin\(J3\)' only numbers, columns, \+ - \* / and parentheses are read; a column"),
        ("J3 ** 2", "only numbers, columns"),
        ("J3.real", "only numbers, columns"),
        ("J3 if J2 else J3", "only numbers, columns"),
        ("J3[0]", r"not a number or expression, because of '\['"),
        ("J3 * (1 / 0)", r"'J3 \* \(1 / 0\)' divides by zero"),
        ("J3 / (1 - 1)", r"column 'J3 / \(1 - 1\)' holds no number"),
        (
            "J3 + tau 2",
            "is not a number or expression; .*; a column whose name is not of letters,",
        ),
        ("J3 + __import__('os')", "because of"),
        ("J-3", "there is no column 'J-3'"),
        ("J3 / (J2 - J2)", "column 'J3 / [(]J2 - J2[)]' holds no number"),
    ],
)
def test_refusals(text: str, sentence: str, log: Path) -> None:
    with pytest.raises(GtauError, match=sentence):
        run_of(log, position={"j2": text})


def test_a_number_is_no_column(log: Path) -> None:
    with pytest.raises(GtauError, match=r"there is no column '2 \+ 3'"):
        run_of(log, position={"j2": "2 + 3"})


def test_units_of_what_is_summed_are_stated(tmp_path: Path) -> None:
    table = np.column_stack([TIME, np.rad2deg(J2), np.rad2deg(J3), TAU])
    np.savetxt(tmp_path / "a.csv", table, delimiter=",", header="t,q2_deg,q3_deg,tau", comments="")
    signals = {"time": "t", "position": {"j3": "q2_deg + q3_deg"}, "torque": {"j3": "tau"}}
    with pytest.raises(GtauError, match="column 'q2_deg' is in 'deg' by the log, but the experiment file states no"):
        read_run(tmp_path / "a.csv", signals)
    run = read_run(tmp_path / "a.csv", signals, units={"position": "deg"})
    np.testing.assert_allclose(run.position[:, 0], J2 + J3, atol=1e-9)


def test_text_in_a_summand_names_its_line(log: Path) -> None:
    lines = log.read_text().splitlines()
    lines[5] = lines[5].replace(lines[5].split(",")[2], "err")
    log.write_text("\n".join(lines))
    run = run_of(log, position={"j2": "J2 + J3"})
    assert "line 6" in str(run.notes)
