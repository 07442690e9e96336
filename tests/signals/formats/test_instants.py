"""Times as people and programs write them: dates, clock times, durations; in seconds, or refused by name."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime, time, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from gtau.errors import GtauError
from gtau.signals.reading.discovery import discover
from gtau.signals.run import read_run

N = 250
STEP = timedelta(milliseconds=4)
START = datetime(2026, 11, 29, 23, 58, 59, 500_000)
TIME = np.arange(N) * STEP.total_seconds()
Q, TAU = np.sin(2 * TIME), np.cos(2 * TIME)
SIGNALS = {"time": "time", "position": {"a": "q1"}, "torque": {"a": "tau1"}}


def iso(k: int) -> str:
    return (START + k * STEP).isoformat(timespec="milliseconds")


def clock(k: int) -> str:
    return iso(k)[11:]


WRITTEN: dict[str, Callable[[int], str]] = {
    "iso": iso,
    "iso UTC": lambda k: f"{iso(k)}Z",
    "iso with offset": lambda k: f"{iso(k)}+01:00",
    "iso with a blank": lambda k: iso(k).replace("T", " "),
    "German": lambda k: f"{START + k * STEP:%d.%m.%Y %H:%M:%S.%f}",
    "MATLAB datetime": lambda k: f"{START + k * STEP:%d-%b-%Y %H:%M:%S.%f}",
    "LabVIEW": lambda k: f"{START + k * STEP:%m/%d/%Y %I:%M:%S.%f %p}",
    "clock": clock,
    "clock of half days": lambda k: f"{START + k * STEP:%I:%M:%S.%f %p}",
    "minutes and seconds": lambda k: clock(k)[3:],
    "more than a day": lambda k: f"1 day, {k * STEP}",
    "pandas": lambda k: f"0 days 00:00:0{k * STEP.total_seconds():.6f}",
    "MATLAB duration": lambda k: f"{k * STEP.total_seconds():.3f} sec",
    "milliseconds": lambda k: f"{4 * k} ms",
}


def save(path: Path, times: list[str], header: str = "time,q1,tau1", separator: str = ",") -> Path:
    rows = [separator.join([time, f"{q:.9f}", f"{tau:.9f}"]) for time, q, tau in zip(times, Q, TAU, strict=True)]
    path.write_text("\n".join([header.replace(",", separator), *rows]) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("kind", WRITTEN)
def test_times_in_text(kind: str, tmp_path: Path) -> None:
    log = save(tmp_path / "a.csv", [WRITTEN[kind](k).replace("day,", "days") for k in range(N)])
    run = read_run(log, SIGNALS)
    np.testing.assert_allclose(run.time - run.time[0], TIME, atol=1e-6)
    draft = discover([log])
    assert (draft.signals.time_columns, draft.units) == (("time",), {})


def test_decimal_commas_and_a_date_beside_a_clock(tmp_path: Path) -> None:
    table = ["time;day;q1;tau1"]
    table += [f"{clock(k)};{iso(k)[:10]};{Q[k]:.9f};{TAU[k]:.9f}".replace(".", ",") for k in range(N)]
    (tmp_path / "a.csv").write_text("\n".join(table))
    run = read_run(tmp_path / "a.csv", SIGNALS)
    np.testing.assert_allclose(run.time - run.time[0], TIME, atol=1e-6)
    with pytest.raises(GtauError, match=r"column 'day' holds dates, .*; add it to the other"):
        read_run(tmp_path / "a.csv", SIGNALS | {"time": ["day", "time"]})
    both = read_run(tmp_path / "a.csv", SIGNALS | {"time": "day + time"})
    np.testing.assert_allclose(both.time - both.time[0], TIME, atol=1e-6)


@pytest.mark.parametrize(
    "times",
    [
        [START + k * STEP for k in range(N)],
        [(START + k * STEP).replace(tzinfo=UTC) for k in range(N)],
        [k * STEP for k in range(N)],
        [(START + k * STEP).time() for k in range(N)],
    ],
)
@pytest.mark.parametrize("ending", [".parquet", ".feather"])
def test_times_in_columns(times: list[datetime | timedelta | time], ending: str, tmp_path: Path) -> None:
    frame = pl.DataFrame({"time": times, "q1": Q, "tau1": TAU})
    log = tmp_path / f"a{ending}"
    frame.write_parquet(log) if ending == ".parquet" else frame.write_ipc(log)
    run = read_run(log, SIGNALS)
    np.testing.assert_allclose(run.time - run.time[0], TIME, atol=1e-6)


def test_the_clock_of_simulink(tmp_path: Path) -> None:
    assert discover([save(tmp_path / "a.csv", list(map(str, TIME)), "tout,q1,tau1")]).signals.time_columns == ("tout",)


@pytest.mark.parametrize(
    ("times", "units", "signals", "sentence"),
    [
        ("iso", {"time": "ms"}, {}, r"'time' holds dates, clock times or durations, which are read in s; remove the"),
        ("iso", {}, {"position": {"a": "time"}, "time": {"rate": 250}}, "'time' holds dates, .*; give the column that"),
        ("lunar", {}, {}, r"column 'time' holds no number \(it begins with 'day 0'\)"),
    ],
)
def test_refusals(times: str, units: Any, signals: Any, sentence: str, tmp_path: Path) -> None:
    written = WRITTEN.get(times, lambda k: f"day {k}")
    log = save(tmp_path / "a.csv", [written(k) for k in range(N)])
    with pytest.raises(GtauError, match=sentence):
        read_run(log, SIGNALS | signals, units=units)


def test_a_time_that_cannot_be_read_is_a_row_that_is_dropped(tmp_path: Path) -> None:
    run = read_run(save(tmp_path / "a.csv", [iso(k) if k != 7 else "?" for k in range(N)]), SIGNALS)
    assert "line 9" in str(run.notes)


@pytest.mark.parametrize("names", ["Datum;Uhrzeit", "Tag;Stunde des Tages"])
def test_a_date_in_one_column_and_a_clock_time_over_midnight_in_another(names: str, tmp_path: Path) -> None:
    """Found by their names or, with names of other languages, by what they hold; or named."""
    start = datetime(2026, 11, 29, 23, 59, 59, 500_000)
    times = [f"{start + k * STEP:%d.%m.%Y;%H:%M:%S.%f}" for k in range(N)]
    log = save(tmp_path / "a.csv", times, f"{names};q1;tau1", ";")
    draft = discover([log])
    (column,) = draft.signals.time_columns
    run = read_run(log, draft.signals.model_dump(exclude_none=True))
    np.testing.assert_allclose(run.time - run.time[0], TIME, atol=1e-6)
    assert "clock" not in draft.open
    stated = discover([log], columns={"position": "q1", "torque": "tau1", "time": column})
    assert stated.signals.time_columns == (column,)


@pytest.mark.parametrize("name", ["Zeitstempel", "Aufgezeichnet"])
def test_a_column_of_dates_is_the_time_whatever_its_name(name: str, tmp_path: Path) -> None:
    log = save(tmp_path / "a.csv", [f"{k},{WRITTEN['German'](k)}" for k in range(N)], f"count,{name},q1,tau1")
    draft = discover([log])
    assert (draft.signals.time_columns, draft.reasons.time) == ((name,), "median step 0.004 s, 250 Hz")


def test_a_clock_time_over_midnight_without_a_date_is_refused_by_that_name(tmp_path: Path) -> None:
    start = datetime(2026, 11, 29, 23, 59, 59, 500_000)
    log = save(tmp_path / "a.csv", [f"{start + k * STEP:%H:%M:%S.%f}" for k in range(N)])
    with pytest.raises(GtauError, match=r"with the date where a clock passed midnight, time: DATE \+ TIME"):
        read_run(log, SIGNALS)
