"""Text logs as loggers leave them: titles and units before the table, half rows at its ends, words in it."""

from __future__ import annotations

import gzip
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from small_blocks import working_with

from gtau.errors import GtauError
from gtau.signals.reading.logs import find_columns
from gtau.signals.run import read_run

N = 600
TIME = np.arange(N) / 500
VALUES = np.column_stack([np.sin(3 * TIME), np.cos(3 * TIME)])
ROWS = [f"{t:.6f},{q:.9f},{v:.9f}" for t, (q, v) in zip(TIME, VALUES, strict=True)]
SIGNALS = {"time": "t", "position": {"a": "q"}, "current": {"a": "v"}}


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    def written(*lines: str, end: str = "\n") -> Path:
        path = tmp_path / "log.csv"
        path.write_text("\n".join(lines) + end)
        return path

    return written


def test_few_lines_show_the_columns_of_a_table(write: Callable[..., Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """100,000 columns took 41 s of a processor where 200 lines were taken apart, and take 7 s."""
    monkeypatch.setattr("gtau.signals.reading.formats.text.ENOUGH", 60)
    log = write("t,q,v", *ROWS)
    assert find_columns(log).columns == ("t", "q", "v")
    assert len(read_run(log, SIGNALS).time) == N


@pytest.mark.parametrize("always", [True, False])
def test_quoted_numbers_with_decimal_commas(write: Callable[..., Path], always: bool) -> None:
    """Of LibreOffice, which quotes all entries or those with a comma."""
    entries = [[entry.rstrip("0").rstrip(".").replace(".", ",") for entry in row.split(",")] for row in ROWS]
    rows = [",".join(f'"{text}"' if always or "," in text else text for text in row) for row in entries]
    run = read_run(write('"t","q","v"', *rows), SIGNALS)
    np.testing.assert_allclose(run.position[:, 0], VALUES[:, 0], atol=1e-8)
    np.testing.assert_allclose(run.time, TIME, atol=1e-9)


def test_commas_before_thousands_are_no_decimal_commas(write: Callable[..., Path]) -> None:
    log = write("t,q,v", *(f'{k},"{700 + k:,}",{k % 7}' for k in range(N)))
    with pytest.raises(GtauError, match=r"column 'q'.* '1,000'"):
        read_run(log, SIGNALS)


# what stands before the rows, the note, and the columns' names
BEFORE: list[tuple[list[str], str, tuple[str, str, str]]] = [
    (["t,q,v"], "", ("t", "q", "v")),
    (["# t,q,v"], "", ("t", "q", "v")),
    (["", "t,q,v"], "", ("t", "q", "v")),
    (
        ["Logger 3.1", "recorded on Monday, by A", "", "t,q,v"],
        "skipped lines 1 to 2 before the table, took the names of",
        ("t", "q", "v"),
    ),
    (["t,q,v", "s,rad,A"], "", ("t", "q", "v")),
    (
        ["t,q,v", "first,second,third"],
        "skipped line 2 before the table, took the names of its columns from line 1",
        ("t", "q", "v"),
    ),
    (["t,q,v", "123,0.5"], "skipped line 2 before the table, took the names", ("t", "q", "v")),
    (["43,-0.62"], "skipped line 1 before the table", ("1", "2", "3")),
    (["\x00\x01\x02garbage \x7f"], "skipped line 1 before the table", ("1", "2", "3")),
    ([], "", ("1", "2", "3")),
]


@pytest.mark.parametrize(("lines", "note", "names"), BEFORE, ids=[str(k) for k in range(len(BEFORE))])
def test_what_stands_before_the_table_is_skipped_and_reported(
    write: Callable[..., Path], lines: list[str], note: str, names: tuple[str, str, str]
) -> None:
    path = write(*lines, *ROWS)
    if note.endswith("before the table") and names[0] == "1":
        with pytest.raises(GtauError, match="has no header, so its 3 columns are named 1 to 3"):
            read_run(path, SIGNALS)
    run = read_run(path, {"time": names[0], "position": {"a": names[1]}, "current": {"a": names[2]}})
    assert [str(each)[: len(note)] for each in run.notes] == ([note] if note else [])
    np.testing.assert_allclose(run.position[:, 0], VALUES[:, 0], atol=1e-9)
    np.testing.assert_allclose(run.command[:, 0], VALUES[:, 1], atol=1e-9)


def test_binary_garbage_before_the_header(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(b"\xff\xfe\x80 cut\n" + "\n".join(["t,q,v", *ROWS]).encode())
    assert tuple(map(str, read_run(path, SIGNALS).notes)) == (
        "skipped line 1 before the table, took the names of its columns from line 2",
    )


def test_binary_garbage_in_the_middle_names_the_line(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    lines = [line.encode() for line in ["t,q,v", *ROWS]]
    path.write_bytes(b"\n".join([*lines[:300], b"\xff\xfe\x00,\x80", *lines[300:]]))
    with pytest.raises(GtauError) as refusal:
        read_run(path, SIGNALS)
    assert str(refusal.value) == (
        f"{path}, line 301 is not text: the log is damaged there; delete the line, or record the log again."
    )


@pytest.mark.parametrize("last", ["1.2", "1.2,0.5", "1.2,0.5,", "1.2,0.5,-"])
def test_a_cut_last_row_is_dropped_and_reported(write: Callable[..., Path], last: str) -> None:
    run = read_run(write("t,q,v", *ROWS, last, end=""), SIGNALS)
    assert tuple(map(str, run.notes)) == (f"dropped 1 row with missing or non-numeric values (line {N + 2})",)
    assert len(run.time) == N


def test_text_among_numbers_names_its_lines(write: Callable[..., Path]) -> None:
    rows = list(ROWS)
    rows[100] = rows[100].rsplit(",", 1)[0] + ",overrun"
    assert str(read_run(write("t,q,v", *rows), SIGNALS).notes[0]) == (
        "dropped 1 row with missing or non-numeric values (line 102)"
    )
    rows[200:300] = [row.rsplit(",", 1)[0] + ",overrun" for row in rows[200:300]]
    with pytest.raises(GtauError, match=r"101 of 600 rows .*\(first in line 102, column 'v': 'overrun'\)"):
        read_run(write("t,q,v", *rows), SIGNALS)


def test_a_log_read_in_parts_begins_where_its_table_does(write: Callable[..., Path]) -> None:
    path = write("Logger 3.1", "t,q,v", "s,rad,A", *ROWS)
    with working_with(16):
        run = read_run(path, SIGNALS)
    np.testing.assert_allclose(run.position[:, 0], VALUES[:, 0], atol=1e-9)


@pytest.mark.parametrize("each", [False, True], ids=["one topic", "two topics"])
def test_rows_of_other_topics_are_left_out(write: Callable[..., Path], each: bool) -> None:
    """As PlotJuggler exports several topics: a row for every stamp of any of them, most of it empty."""
    rows = [f"{time + 0.0005:.6f},,,7.5" for time in TIME]
    if each:
        rows += [f"{time:.6f},{q:.9f},," for time, (q, _) in zip(TIME, VALUES, strict=True)]
        rows += [f"{time + 0.001:.6f},,{v:.9f}," for time, (_, v) in zip(TIME, VALUES, strict=True)]
    else:
        rows += [f"{row}," for row in ROWS]
    time = {"position": "__time", "command": "__time"} if each else "__time"
    run = read_run(write("__time,q,v,temperature", *sorted(rows, key=_stamp)), SIGNALS | {"time": time})
    kept = N - 1 if each else N  # the first position is before the first command
    assert str(run.notes[-1]) == f"left out {2 * kept + 1 if each else N} rows that hold only other signals"
    assert run.valid.all()
    np.testing.assert_allclose(run.position[:, 0], VALUES[N - kept :, 0], atol=1e-9)
    np.testing.assert_allclose(run.command[:, 0], np.cos(3 * (run.time - 0.001 * each)), atol=1e-4)


def _stamp(row: str) -> float:
    return float(row.split(",")[0])


def test_a_compressed_log_that_was_cut_is_refused(tmp_path: Path) -> None:
    """Its first lines are whole."""
    rng = np.random.default_rng(1)
    text = "t,q,v\n" + "".join(f"{k / 100},{rng.normal()},{rng.normal()}\n" for k in range(20_000))
    (tmp_path / "a.csv.gz").write_bytes(gzip.compress(text.encode())[:-5000])
    with pytest.raises(GtauError, match=r"a\.csv\.gz cannot be unpacked \(Compressed file ended"):
        read_run(tmp_path / "a.csv.gz", SIGNALS | {"time": "t"})


@pytest.mark.parametrize(
    ("ending", "advice"),
    [
        (".csv.zip", "unpack it and give its content"),
        (".xlsx", "export its table as CSV"),
        (".log", "export its content as CSV, Parquet, NPZ, MAT or HDF5"),
    ],
)
def test_what_to_do_with_files_of_other_programs(ending: str, advice: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{ending}"
    path.write_bytes(b"\x1f\x8b\x00\x93NUMPY\x00\x01" * 40)
    with pytest.raises(GtauError, match=f"is a binary file of another program, not a log; {advice}"):
        find_columns(path)


@pytest.mark.parametrize(
    ("header", "separator", "names"),
    [
        ('"t","q, measured","v"', ",", ("t", "q, measured", "v")),
        ('"t" "q measured"  "v" ', " ", ("t", "q measured", "v")),
        ("'t';'q';'v'", ";", ("t", "q", "v")),
    ],
)
def test_quoted_names_of_columns(
    write: Callable[..., Path], header: str, separator: str, names: tuple[str, str, str]
) -> None:
    path = write(header, *(row.replace(",", separator) for row in ROWS))
    assert find_columns(path).columns == names
    run = read_run(path, {"time": names[0], "position": {"a": names[1]}, "current": {"a": names[2]}})
    np.testing.assert_allclose(run.position[:, 0], VALUES[:, 0], atol=1e-8)


def test_names_in_windows_1252(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(
        "\n".join(["t;Position größer [°];Strom v", *(row.replace(",", ";") for row in ROWS)]).encode("cp1252")
    )
    assert find_columns(path).columns == ("t", "Position größer [°]", "Strom v")


def test_cells_in_windows_1252(tmp_path: Path) -> None:
    """A text beside the signals; bytes that are no text are refused with their line."""
    header, texts = "t,q,v,Zustand", ["läuft", "größer"]
    path, rows = tmp_path / "log.csv", [f"{row},{texts[k % 2]}" for k, row in enumerate(ROWS)]
    path.write_bytes("\n".join([header, *rows]).encode("cp1252"))
    np.testing.assert_allclose(read_run(path, SIGNALS).position[:, 0], VALUES[:, 0], atol=1e-8)
    path.write_bytes("\n".join([header, *rows]).encode("cp1252").replace(rows[20].encode("cp1252"), b"\x00\x81\x90,1"))
    with pytest.raises(GtauError, match="line 22 "):
        read_run(path, SIGNALS)
    path.write_bytes("\n".join([header, *rows, rows[0] + ",zu,viel"]).encode("cp1252"))
    with pytest.raises(GtauError, match=f"line {len(rows) + 2} has 6 columns"):
        read_run(path, SIGNALS)


@pytest.mark.parametrize("before", [0, 2, 500])
def test_lines_that_are_no_rows_are_refused_before_they_fill_the_memory(
    write: Callable[..., Path], before: int
) -> None:
    path = write("t,q,v", *ROWS[:before], ",".join(["1.5"] * 5_000_000))
    tracemalloc.start()
    with pytest.raises(GtauError, match=r"line( \d+)? is longer than 1 MB, too long for a row of a log"):
        read_run(path, SIGNALS)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 15e6  # of a file of 20 MB
