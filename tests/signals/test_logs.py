"""Logs: what is read, what is repaired, and the sentence that a bad one gets."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gtau.errors import GtauError
from gtau.signals.reading.logs import read_log
from gtau.signals.run import Run, read_run

SIGNALS = {"time": "t", "position": {"a": "qa", "b": "qb"}, "current": {"a": "va", "b": "vb"}}
N, RATE = 1000, 500.0
HEADER = "t,qa,qb,va,vb"


def motion(time: np.ndarray) -> np.ndarray:
    """Columns qa, qb, va, vb."""
    angle = 2 * np.pi * 0.7 * time
    return np.column_stack([np.sin(angle), 0.3 * np.cos(1.3 * angle), np.cos(angle), 2 * np.sin(1.1 * angle)])


def rows(time: np.ndarray | None = None) -> list[str]:
    time = np.arange(N) / RATE if time is None else time
    return [",".join(f"{x:.9f}" for x in row) for row in np.column_stack([time, motion(time)])]


def write(path: Path, lines: list[str], header: str = HEADER) -> Path:
    path.write_text("\n".join([header, *lines] if header else lines) + "\n")
    return path


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return tmp_path / "log.csv"


def test_a_clean_log_is_taken_as_it_is(log: Path) -> None:
    run = read_run(write(log, rows()), SIGNALS, payload={"name": "L", "mass": 2})
    time = np.arange(N) / RATE
    assert run.name == "log"
    assert run.notes == ()
    assert run.valid.all()
    assert run.rate == pytest.approx(RATE)
    np.testing.assert_allclose(run.time, time, atol=1e-12)
    np.testing.assert_allclose(np.hstack([run.position, run.command]), motion(time), atol=1e-9)
    assert run.payload is not None
    assert run.payload.mass == 2.0


def test_columns_go_by_name_not_by_place(log: Path) -> None:
    swapped = SIGNALS | {"current": {"b": "vb", "a": "va"}, "position": {"b": "qb", "a": "qa"}}
    run, other = read_run(write(log, rows()), SIGNALS), read_run(log, swapped)
    assert other.joints == ("b", "a")
    np.testing.assert_array_equal(other.position[:, 1], run.position[:, 0])
    np.testing.assert_array_equal(other.ordered(run.joints).command, run.command)
    with pytest.raises(GtauError, match="the robot's actuated joints are a, c"):
        run.ordered(("a", "c"))


def test_units(log: Path) -> None:
    base = read_run(write(log, rows()), SIGNALS)
    units = {"time": "ms", "position": {"a": "deg", "b": "mm"}, "current": "mA"}
    slow = [",".join([f"{i * 2}", *row.split(",")[1:]]) for i, row in enumerate(rows())]
    run = read_run(write(log, slow), SIGNALS, units=units)
    np.testing.assert_allclose(run.position, base.position * [np.pi / 180, 1e-3])
    np.testing.assert_allclose(run.command, base.command * 1e-3)
    np.testing.assert_allclose(run.time, base.time, atol=1e-12)


def variants(tmp_path: Path) -> dict[str, Path]:
    """The same log, written in other ways."""
    import polars as pl

    lines = rows()
    path = tmp_path / "log.parquet"
    pl.DataFrame(np.array([r.split(",") for r in lines], float), schema=HEADER.split(",")).write_parquet(path)
    german = [line.replace(",", ";").replace(".", ",") for line in lines]
    return {
        "parquet": path,
        "semicolons": write(tmp_path / "a.csv", german, HEADER.replace(",", ";")),
        "tabs": write(tmp_path / "b.txt", [line.replace(",", "\t") for line in lines], HEADER.replace(",", "\t")),
        "spaces": write(
            tmp_path / "c.txt", [line.replace(",", " ") for line in lines], "# " + HEADER.replace(",", " ")
        ),
        "blanks": write(tmp_path / "d.csv", [line.replace(",", ", ") for line in lines], HEADER.replace(",", ", ")),
        "quotes": write(tmp_path / "e.csv", lines, ",".join(f'"{name}"' for name in HEADER.split(","))),
        "bom": write(tmp_path / "f.csv", lines, "\ufeff" + HEADER),
    }


@pytest.mark.parametrize("kind", ["parquet", "semicolons", "tabs", "spaces", "blanks", "quotes", "bom"])
def test_other_ways_to_write_a_log(tmp_path: Path, log: Path, kind: str) -> None:
    base = read_run(write(log, rows()), SIGNALS)
    run = read_run(variants(tmp_path)[kind], SIGNALS)
    np.testing.assert_array_equal(run.position, base.position)
    np.testing.assert_array_equal(run.command, base.command)
    assert run.notes == ()


def test_without_header_and_without_time(log: Path) -> None:
    base = read_run(write(log, rows()), SIGNALS)
    numbered = {"time": {"rate": RATE}, "position": {"a": "2", "b": "3"}, "current": {"a": "4", "b": "5"}}
    run = read_run(write(log, rows(), header=""), numbered)
    np.testing.assert_array_equal(run.position, base.position)
    np.testing.assert_allclose(run.time, base.time, atol=1e-12)


def test_positions_and_currents_in_two_files(tmp_path: Path, log: Path) -> None:
    base = read_run(write(log, rows()), SIGNALS)
    split = [row.split(",") for row in rows()]
    first = write(tmp_path / "p.csv", [",".join(row[:3]) for row in split], "t,one,two")
    second = write(tmp_path / "c.csv", [",".join(row[3:]) for row in split], "one,two")
    columns = {"a": "one", "b": "two"}  # the same names in both files
    run = read_run([first, second], {"time": "t", "position": columns, "current": columns})
    np.testing.assert_array_equal(run.position, base.position)
    np.testing.assert_array_equal(run.command, base.command)


def test_a_missing_row_is_interpolated_and_masked(log: Path) -> None:
    lines = rows()
    lines[500] = lines[500].replace(lines[500].split(",")[3], "overflow")
    lines[700] = lines[700].rsplit(",", 1)[0]  # torn off
    del lines[300:303]
    run = read_run(write(log, lines), SIGNALS)
    assert str(run.notes[0]) == "dropped 2 rows with missing or non-numeric values (lines 499, 699)"
    assert run.notes[1].what == "interpolated 5 missing samples, and masked 3 of them in gaps of more than 3 samples"
    assert np.flatnonzero(~run.valid.any(axis=1)).tolist() == [300, 301, 302]  # one alone is bridged
    np.testing.assert_allclose(run.position, motion(run.time)[:, :2], atol=1e-8)
    np.testing.assert_allclose(run.command, motion(run.time)[:, 2:], atol=1e-3)


def test_repeated_rows_are_dropped(log: Path) -> None:
    lines = rows()
    run = read_run(write(log, lines[:400] + lines[399:]), SIGNALS)
    assert tuple(map(str, run.notes)) == ("dropped 1 repeated row (line 402)",)
    np.testing.assert_allclose(run.position, motion(np.arange(N) / RATE)[:, :2], atol=1e-9)


def test_irregular_sampling_is_resampled_without_bias(log: Path, rng: np.random.Generator) -> None:
    time = 300.0 + np.cumsum(rng.choice([0.010, 0.012], 3000))
    run = read_run(write(log, rows(time)), SIGNALS)
    assert "resampled from irregular steps of 10 to 12 ms to a uniform 9" in str(run.notes[0])
    assert run.valid.all()
    np.testing.assert_allclose(np.diff(run.time), 1 / run.rate, rtol=1e-6)
    np.testing.assert_allclose(run.position, motion(run.time)[:, :2], atol=1e-6)


@pytest.mark.parametrize("rate", [1000.0, 5000.0, 300.0, 1 / 0.004])
def test_rounded_time_is_not_irregular(log: Path, rate: float) -> None:
    time = np.arange(2000) / rate
    lines = [f"{t + 1.7e9:.4f},{row.split(',', 1)[1]}" for t, row in zip(time, rows(time), strict=True)]
    run = read_run(write(log, lines), SIGNALS)
    assert run.notes == ()
    assert run.rate == pytest.approx(rate, rel=1e-5)
    np.testing.assert_allclose(run.position, motion(time)[:, :2], atol=1e-8)


def test_wrapped_angles_are_unwrapped(log: Path) -> None:
    lines = []
    for row in rows():
        t, qa, rest = row.split(",", 2)
        lines.append(f"{t},{(5 * float(qa) + np.pi) % (2 * np.pi) - np.pi:.9f},{rest}")
    run = read_run(write(log, lines), SIGNALS)
    assert tuple(map(str, run.notes)) == ("unwrapped the angle of joint 'a', which jumped by a turn",)
    np.testing.assert_allclose(run.position, motion(run.time)[:, :2] * [5, 1], atol=1e-8)


def test_a_joint_at_rest_is_said(log: Path) -> None:
    lines = [",".join(["0.5" if i == 2 else x for i, x in enumerate(row.split(","))]) for row in rows()]
    assert tuple(map(str, read_run(write(log, lines), SIGNALS).notes)) == (
        "the position of joint 'b' never changes: it yields no rows",
    )


def test_a_joint_that_is_locked_may_have_no_current(log: Path) -> None:
    lines = [",".join([{2: "0", 4: "0"}.get(i, x) for i, x in enumerate(row.split(","))]) for row in rows()]
    assert tuple(map(str, read_run(write(log, lines), SIGNALS).notes)) == (
        "the position of joint 'b' never changes: it yields no rows",
    )


def test_columns_aligned_by_spaces(log: Path) -> None:
    """As NumPy's savetxt writes them."""
    clean = read_run(write(log, rows()), SIGNALS)
    lines = ["  ".join(f"{float(x):14.9f}" for x in row.split(",")) + "  " for row in rows()]
    titled = read_run(write(log, lines, "#      t      qa     qb   va   vb"), SIGNALS)
    np.testing.assert_allclose(titled.position, clean.position, atol=1e-8)
    np.testing.assert_allclose(titled.command, clean.command, atol=1e-8)


def test_unreadable_text_says_how_to_save_it(log: Path) -> None:
    text = "\n".join([HEADER, *rows()])
    log.write_bytes(text.encode("utf-16"))
    with pytest.raises(GtauError, match="is text in UTF-16; save it as UTF-8"):
        read_run(log, SIGNALS)
    log.write_bytes(text.replace("\n", "\r").encode())
    with pytest.raises(GtauError, match="ends its lines with carriage returns alone"):
        read_run(log, SIGNALS)


def test_other_marks_of_text(log: Path) -> None:
    """A byte order mark, lines that end as Windows ends them, quotes, decimal commas."""
    clean = read_run(write(log, rows()), SIGNALS).position
    text = "\r\n".join([HEADER, *rows(), ""])
    log.write_bytes(text.encode("utf-8-sig"))
    np.testing.assert_array_equal(read_run(log, SIGNALS).position, clean)
    log.write_text("\n".join(",".join(f'"{x}"' for x in line.split(",")) for line in [HEADER, *rows()]))
    np.testing.assert_array_equal(read_run(log, SIGNALS).position, clean)
    log.write_text("\n".join([HEADER, *rows()]).replace(",", ";").replace(".", ","))
    np.testing.assert_array_equal(read_run(log, SIGNALS).position, clean)


def _set(column: int, value: str) -> Callable[[list[str]], list[str]]:
    return lambda lines: [
        ",".join([value if i == column else x for i, x in enumerate(line.split(","))]) for line in lines
    ]


def _garble(lines: list[str]) -> list[str]:
    return [line.rsplit(",", 1)[0] + ",n.a." if i % 10 == 7 else line for i, line in enumerate(lines)]


def _sparse(lines: list[str]) -> list[str]:
    return [line for i, line in enumerate(lines) if i % 5 > 1]


def _scaled(factor: float) -> Callable[[list[str]], list[str]]:
    return lambda lines: [f"{float(x.split(',')[0]) * factor:.9g},{x.split(',', 1)[1]}" for x in lines]


# name, change to the lines, header, what the error says
BAD: list[tuple[str, Callable[[list[str]], list[str]], str, str]] = [
    (
        "column missing",
        lambda x: x,
        "t,qa,q_b,va,vb",
        "there is no column 'qb'; did you mean 'q_b'? The columns are t, qa,",
    ),
    (
        "no match",
        lambda x: x,
        "t,qa,velocity,va,vb",
        "there is no column 'qb'; the columns are t, qa, velocity, va, vb.",
    ),
    (
        "no header",
        lambda x: x,
        "",
        "the file has no header, so its 5 columns are named 1 to 5; copy the line with the names from a log",
    ),
    ("column twice", lambda x: x, "t,qa,qb,va,qb", "has 2 columns named 'qb'; rename them"),
    ("no samples", lambda x: [], HEADER, "has 0 samples"),
    ("short", lambda x: x[:60], HEADER, "has 60 samples; identification needs a log of several seconds"),
    ("a column of words", _set(2, "open"), HEADER, "column 'qb' holds no number (it begins with 'open')"),
    ("an empty column", _set(4, ""), HEADER, "column 'vb' holds no number; give the column"),
    ("a column of nan", _set(4, "nan"), HEADER, "column 'vb' holds no number (it begins with 'nan')"),
    (
        "many bad rows",
        _garble,
        HEADER,
        "has 100 of 1000 rows with missing or non-numeric values (first in line 9, column 'vb': 'n.a.')",
    ),
    (
        "currents at half the rate",
        lambda x: [line if i % 3 == 0 else f"{line.rsplit(',', 2)[0]},," for i, line in enumerate(x)],
        HEADER,
        "(first in line 3, column 'va'); give columns that have other rates in a file of their own (log: [FILE, FILE])",
    ),
    (
        "half a row at first, many times",
        lambda x: [f"{line.rsplit(',', 1)[0]}," if i < 80 else line for i, line in enumerate(x)],
        HEADER,
        "(first in line 2, column 'vb'); leave out its first rows (skip: 80)",
    ),
    ("nothing moves", lambda x: _set(1, "1")(_set(2, "2")(x)), HEADER, "no position ever changes"),
    ("stuck current", _set(3, "0.25"), HEADER, "column 'va' (joint 'a') is stuck at 0.25"),
    ("no current", _set(3, "-0.0"), HEADER, "column 'va' (joint 'a') is stuck at 0;"),
    (
        "time reversed",
        lambda x: x[:500] + x[100:],
        HEADER,
        "line 502: time goes back from 0.998 s to 0.2 s; cut the log",
    ),
    (
        "a ring buffer",
        lambda x: x[600:] + x[:600],
        HEADER,
        "line 402: time goes back from 1.998 s to 0 s and ends where it begins, as in a ring buffer; sort the rows by",
    ),
    ("time stands still", _set(0, "1"), HEADER, "column 't' is 1 s in the last row and 1 s in the first"),
    (
        "time as a date",
        lambda x: [f"2024-01-01 {line}" for line in x],
        HEADER,
        "convert it to seconds, or give the rate",
    ),
    ("time in ms", _scaled(1e3), HEADER, "units: {time: ms}"),
    ("time in us", _scaled(1e6), HEADER, "units: {time: us}"),
    ("time in ns", _scaled(1e9), HEADER, "units: {time: ns}"),
    (
        "a pause",
        lambda x: [*x[:500], *(f"{float(line.split(',')[0]) + 100:.9g},{line.split(',', 1)[1]}" for line in x[500:])],
        HEADER,
        "line 501: 100 s are missing after 0.998 s; cut the log there into two runs",
    ),
    (
        "time stops",
        lambda x: [*x[:500], *(f"1,{line.split(',', 1)[1]}" for line in x[500:])],
        HEADER,
        "so they freeze or jump; correct the column",
    ),
    ("a gap", lambda x: x[:500] + x[600:], HEADER, "line 501: 0.202 s are missing after 0.998 s; cut the log there"),
    ("many gaps", _sparse, HEADER, "samples (steps of 2 to 6 ms); record it at a steady rate"),
    (
        "ragged",
        lambda x: [*x[:7], x[7] + ",1", *x[8:]],
        HEADER,
        "line 9 has 6 columns where the header has 5; correct",
    ),
    (
        "short header",
        lambda x: x,
        "t,qa,qb,va",
        "line 2 has 5 columns where the header in line 1 has 4",
    ),
    ("only a header, torn", lambda x: [], HEADER[:-4], "there is no column 'va'"),
    ("empty", lambda x: [], "\n", "is empty or begins with an empty line"),
]


def test_no_column_is_taken_for_one_that_is_used_already(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "log.csv", np.zeros((9, 2)), delimiter=",", header="t,shoulder_current", comments="")
    with pytest.raises(GtauError, match="no column 'elbow_current'; the columns are"):
        read_log(tmp_path / "log.csv", ["shoulder_current", "elbow_current"])


@pytest.mark.parametrize(("change", "header", "sentence"), [case[1:] for case in BAD], ids=[case[0] for case in BAD])
def test_a_bad_log_is_refused_in_one_sentence(
    log: Path, change: Callable[[list[str]], list[str]], header: str, sentence: str
) -> None:
    write(log, change(rows()), header)
    with pytest.raises(GtauError) as refusal:
        read_run(log, SIGNALS)
    assert sentence in str(refusal.value)
    assert str(refusal.value).startswith(str(log))
    assert "\n" not in str(refusal.value)


def test_files_that_are_no_logs(tmp_path: Path, log: Path) -> None:
    with pytest.raises(GtauError, match="cannot be read: no such file"):
        read_run(tmp_path / "none.csv", SIGNALS)
    log.write_bytes(b"\x89PNG\xff\x00" * 50)
    with pytest.raises(GtauError, match="is a picture, not a log"):
        read_run(log, SIGNALS)
    (tmp_path / "log.parquet").write_bytes(b"no parquet")
    with pytest.raises(GtauError, match="is not a readable Parquet file"):
        read_run(tmp_path / "log.parquet", SIGNALS)


def test_two_files_of_different_length(tmp_path: Path) -> None:
    first, second = write(tmp_path / "p.csv", rows()), write(tmp_path / "c.csv", rows()[:-2])
    with pytest.raises(GtauError, match=r"1000 rows but .* has 998"):
        read_run([first, second], SIGNALS)
    for logs in ([first, write(second, rows()[:-1])], [second, first]):
        run = read_run(logs, SIGNALS)
        assert [str(note) for note in run.notes] == ["dropped 1 row with missing or non-numeric values (line 1001)"]
        assert len(run.time) == 999
    with pytest.raises(GtauError, match="a run has 3 logs"):
        read_run([first, second, first], SIGNALS)


def test_one_column_for_two_things(log: Path) -> None:
    with pytest.raises(GtauError, match="'qa' is given both as a position and as a current"):
        read_run(write(log, rows()), SIGNALS | {"current": {"a": "va", "b": "qa"}})


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"signals": {"time": "t", "postion": {}}}, "unknown key 'postion'; did you mean 'position'?"),
        ({"units": {"current": "kV"}}, "units, current: write 'A' or 'mA', or another unit of current, not 'kV'"),
        ({"payload": {"name": "L", "mass": 0}}, "payload, mass: 0 is out of range"),
    ],
)
def test_wrong_mappings(log: Path, arguments: dict, sentence: str) -> None:
    write(log, rows())
    with pytest.raises(GtauError) as refusal:
        read_run(log, **({"signals": SIGNALS} | arguments))
    assert sentence in str(refusal.value)


def test_a_run_from_arrays_has_one_shape() -> None:
    with pytest.raises(GtauError, match=r"must all have the shape \(5, 2\)"):
        Run("r", ("a", "b"), np.arange(5.0), np.zeros((5, 2)), np.zeros((5, 3)))


UR10E = {
    "time": "1",
    "position": {f"j{i}": str(1 + i) for i in range(1, 7)},
    "current": {f"j{i}": str(13 + i) for i in range(1, 7)},
}


def test_ur10e_log(shared: Path) -> None:
    run = read_run(shared / "ur10e" / "ur-20_02_19_14harm50sec.csv", UR10E)
    assert tuple(map(str, run.notes)) == (
        "resampled from irregular steps of 2 to 13 ms to a uniform 95.30 Hz: the time stamps are used, because a "
        "regular clock makes the positions no smoother",
    )
    assert run.position.shape == (5375, 6)
    assert run.valid.all()
    assert np.ptp(run.position[:, 0]) == pytest.approx(5.9049, abs=1e-3)


def test_tx40_log(shared: Path) -> None:
    columns = {f"j{i}": f"Joint_{i}" for i in range(1, 7)}
    logs = [shared / "tx40" / "pos_read_data.csv", shared / "tx40" / "curr_data.csv"]
    run = read_run(logs, {"time": {"rate": 5000}, "position": columns, "torque": columns})
    assert (run.position.shape, run.kind) == ((45000, 6), "torque")
    (note,) = run.notes
    assert note.what == "336 samples of the positions are stale (repeat the previous one): interpolated"
    assert run.position[0, 1] == 50.265
    assert run.command[0, 1] == -0.76036


def test_orthoglide_log(shared: Path) -> None:
    signals = {
        "time": "t",
        "position": {f"1{i}": f"q1{i}" for i in (1, 2, 3)},
        "current": {f"1{i}": f"v{i}" for i in (1, 2, 3)},
    }
    run = read_run(shared / "orthoglide_sim" / "exciting_1_unloaded.csv", signals)
    assert (run.position.shape, run.notes) == ((20001, 3), ())
    assert run.rate == pytest.approx(1000)


@pytest.mark.parametrize("longer", ["t", "q", "i"])
def test_one_array_has_one_row_more(longer: str, tmp_path: Path) -> None:
    table = np.array([[float(value) for value in line.split(",")] for line in rows()])
    arrays = {"t": table[:, 0], "q": table[:, 1:3], "i": table[:, 3:5]}
    np.savez(tmp_path / "a.npz", **{name: array if name == longer else array[:-1] for name, array in arrays.items()})
    signals = {"time": "t", "position": {"a": "q[1]", "b": "q[2]"}, "current": {"a": "i[1]", "b": "i[2]"}}
    run = read_run(tmp_path / "a.npz", signals)
    assert [str(note) for note in run.notes] == ["dropped 1 row with missing or non-numeric values (row 1000)"]
    assert len(run.time) == 999
