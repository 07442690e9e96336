"""A process that gets a part of a run reads that part of its log, and finds in it what the whole log shows there."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from five_bar_logs import EXPERIMENT, Plant, five_bar, write_log

import gtau.signals.formats.table
import gtau.signals.formats.text
import gtau.signals.log_file
import gtau.signals.log_slice
import gtau.signals.resampling
import gtau.signals.storage
from gtau.errors import GtauError
from gtau.estimation.experiment_runs import read_runs
from gtau.estimation.regression.dataset import Shard, reduce_runs, reduce_shard
from gtau.estimation.regression.factors import joined
from gtau.signals.experiment import read_experiment
from gtau.signals.log_slice import read_excerpt
from gtau.signals.run import Run, arrange, read_run
from gtau.signals.sizes import Sizes, working_with
from gtau.signals.storage import Placed

SIGNALS = {"time": "t", "position": {"a": "qa", "b": "qb"}, "current": {"a": "va", "b": "vb"}}
N, RATE = 6000, 500.0
Table = dict[str, np.ndarray]


def clean(table: Table, rng: np.random.Generator) -> Table:
    return table


def coarse_clock(table: Table, rng: np.random.Generator) -> Table:
    """Times rounded to milliseconds, at a rate that has no whole number of them."""
    return table | {"t": np.round(np.arange(N) / 370.0, 3)}


def gaps(table: Table, rng: np.random.Generator) -> Table:
    kept = np.sort(rng.choice(N, N - 150, replace=False))
    return {name: each[kept] for name, each in table.items()}


def irregular(table: Table, rng: np.random.Generator) -> Table:
    return table | {"t": 300 + np.cumsum(rng.choice([0.0020, 0.0024], N))}


def bad_rows(table: Table, rng: np.random.Generator) -> Table:
    """As many in one place as would be refused if they were so many everywhere."""
    va = table["va"].copy()
    va[1000 + 5 * np.arange(60)] = np.nan
    return table | {"va": va}


def repeated(table: Table, rng: np.random.Generator) -> Table:
    twice = np.sort(np.r_[np.arange(N), rng.choice(N, 20, replace=False)])
    return {name: each[twice] for name, each in table.items()}


def wrapped(table: Table, rng: np.random.Generator) -> Table:
    return table | {"qa": (5 * table["qa"] + np.pi) % (2 * np.pi) - np.pi}


def turning(table: Table, rng: np.random.Generator) -> Table:
    """A joint that goes on and on, with gaps."""
    qa = 4 * table["t"] + np.round(0.3 * np.sin(3 * table["t"]), 7)
    return gaps(table | {"qa": (qa + np.pi) % (2 * np.pi) - np.pi}, rng)


def limited(table: Table, rng: np.random.Generator) -> Table:
    return table | {"vb": np.clip(table["vb"], -1.99, np.inf)}


def glitched(table: Table, rng: np.random.Generator) -> Table:
    """Samples that are off, some at the edge of a block; others are dropped."""
    places = rng.choice(np.arange(50, N - 50, 5), 30, replace=False)
    off = np.zeros(N)
    off[np.r_[places, 640, 641, 1000, 1040, 1179, 1180]] = 2.0
    return bad_rows(wrapped(table | {"qb": table["qb"] + off}, rng), rng)


CHANGES = [clean, coarse_clock, gaps, irregular, bad_rows, repeated, wrapped, turning, limited, glitched]


def table(rng: np.random.Generator) -> Table:
    time = np.arange(N) / RATE
    w = 2 * np.pi * 0.7 * time
    values = {"qa": np.sin(w), "qb": 0.3 * np.cos(1.3 * w), "va": np.cos(w), "vb": 2 * np.sin(1.1 * w)}
    return {"t": time} | {name: np.round(x + 1e-5 * rng.standard_normal(N), 7) for name, x in values.items()}


@pytest.fixture
def short_blocks() -> Iterator[None]:
    """What is read at once, and what is known by its place, as short as if the logs were long."""
    with working_with(Sizes(block=500, rows=300, text=10_000, landmark=128)):
        yield


def write(kind: str, columns: Table, folder: Path) -> list[Path]:
    whole = pl.DataFrame(columns)
    if kind == "two files":
        whole.select("t", "qa", "qb").fill_nan(None).write_csv(folder / "positions.csv")
        whole.select("va", "vb").write_parquet(folder / "commands.parquet")
        return [folder / "positions.csv", folder / "commands.parquet"]
    if kind == "csv":
        whole.fill_nan(None).write_csv(folder / "log.csv")
    elif kind == "numbers only":
        (folder / "log.csv").write_bytes(
            b"\xef\xbb\xbf" + whole.fill_nan(None).write_csv(include_header=False).encode()
        )
    else:
        (folder / "log.csv").mkdir()
        for k, part in enumerate(whole.iter_slices(1100)):
            part.write_parquet(folder / "log.csv" / f"part_{k}.parquet", row_group_size=400)
    return [folder / "log.csv"]


def read(paths: list[Path], kind: str) -> Run:
    signals = SIGNALS
    if kind == "numbers only":
        signals = {"time": "1", "position": {"a": "2", "b": "3"}, "current": {"a": "4", "b": "5"}}
    return arrange(read_run(paths, signals), ("b", "a"))


@pytest.mark.parametrize("change", CHANGES, ids=[each.__name__ for each in CHANGES])
@pytest.mark.parametrize("kind", ["csv", "numbers only", "parquet", "two files"])
@pytest.mark.usefixtures("short_blocks")
def test_an_excerpt_is_the_log_there(change: Callable, kind: str, tmp_path: Path, rng: np.random.Generator) -> None:
    run = read(write(kind, change(table(rng), rng), tmp_path), kind)
    last = len(run.time)
    for begin, end in ((0, 10), (0, 700), (1035, 1180), (2900, 2901), (last - 800, last), (last - 1, last), (0, last)):
        sent = pickle.dumps(run.only(range(begin, end)))
        assert len(sent) < 5_000
        part = pickle.loads(sent)
        assert (part.rate, part.joints, part.notes) == (run.rate, run.joints, run.notes)
        assert len(part.time) == last
        assert np.array_equal(part.time[begin:end], run.time[begin:end])
        assert np.array_equal(part.valid[begin:end], run.valid[begin:end])
        for name in ("position", "command"):
            here, there = (getattr(each, name)[begin:end] for each in (part, run))
            np.testing.assert_allclose(here, there, rtol=1e-13, atol=1e-13)
        away = np.r_[0:begin, end:last]
        assert not part.valid[away].any()
        assert not part.position[away].any()


@pytest.mark.parametrize("kind", ["csv", "parquet", "two files"])
@pytest.mark.usefixtures("short_blocks")
def test_no_more_is_read_than_is_needed(
    kind: str, tmp_path: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent = pickle.dumps(read(write(kind, table(rng), tmp_path), kind).only(range(2000, 2400)))
    numbers, read_rows = gtau.signals.log_file._numbers, []

    def counting(series: pl.Series) -> tuple[np.ndarray, str | None]:
        read_rows.append(len(series))
        return numbers(series)

    monkeypatch.setattr(gtau.signals.log_file, "_numbers", counting)
    parsed = []
    of_text = gtau.signals.formats.text._frame
    monkeypatch.setattr(
        gtau.signals.formats.text,
        "_frame",
        lambda path, layout, text, *rest: parsed.append(len(text)) or of_text(path, layout, text, *rest),
    )
    read_excerpt.cache_clear()
    pickle.loads(sent)
    assert sum(read_rows) <= 5 * (400 + 5 * 128)
    assert sum(parsed) <= 5 * 10_000  # of some 250 000 bytes


@pytest.mark.parametrize(("from_log", "kind"), [(False, "fir"), (True, "fir"), (True, "chebyshev")])
def test_a_part_needs_nothing_of_the_run_but_what_it_gets(from_log: bool, kind: str, tmp_path: Path) -> None:
    """The factors are those of one process, although what was not sent is not a number."""
    run = Plant(noise=0.01).run("r", seconds=40.0)
    if from_log:
        (tmp_path / "experiment.yaml").write_text(EXPERIMENT.split("runs:")[0] + "runs:\n  - log: r.csv\n")
        write_log(tmp_path / "r.csv", run)
        experiment = read_experiment(tmp_path / "experiment.yaml")
        (run,) = read_runs(experiment, experiment.runs)
    whole = reduce_runs(five_bar().robot, [run], decimator=kind)
    ((*parts,),) = replace(whole, shard=len(whole.prepared[0]) // 4).parts()
    assert len(parts) == 4
    expected = joined([reduce_shard(part) for part in parts])
    found = joined([reduce_shard(_bare(part)) for part in parts])
    assert np.array_equal(found.rows, expected.rows)
    np.testing.assert_allclose(found.distances, expected.distances, rtol=1e-6)
    a, b = (each.R.swapaxes(-1, -2) @ each.R for each in (found, expected))
    size = np.sqrt(np.einsum("...ii->...i", b))
    assert (np.abs(a - b) <= 1e-12 * size[..., :, None] * size[..., None, :]).all()


def _bare(part: Shard) -> Shard:
    """The part in another process, without what it was not given."""
    needed = part.__getstate__()["prepared"].run.pickled
    assert len(needed) < 0.8 * len(part.prepared.run.time)
    sent = pickle.dumps(part)
    assert len(sent) < 100 * len(needed)
    arrived = pickle.loads(sent)
    run = arrived.prepared.run
    for array in (run.position, run.command):
        array[: needed.start] = np.nan
        array[needed.stop :] = np.nan
    return arrived


def test_a_log_that_is_not_there(tmp_path: Path, rng: np.random.Generator) -> None:
    path = tmp_path / "log.csv"
    pl.DataFrame(table(rng)).write_csv(path)
    sent = pickle.dumps(read_run(path, SIGNALS))
    path.rename(tmp_path / "elsewhere.csv")
    read_excerpt.cache_clear()
    with pytest.raises(GtauError, match=r"there is no log .*log\.csv; share its folder with all workers"):
        pickle.loads(sent)


def test_a_log_is_found_from_another_folder(
    tmp_path: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    pl.DataFrame(table(rng)).write_csv(tmp_path / "log.csv")
    monkeypatch.chdir(tmp_path)
    sent = pickle.dumps(read_run("log.csv", SIGNALS))
    monkeypatch.chdir(tmp_path.parent)
    assert len(pickle.loads(sent).time) == N


def test_rows_put_in_place(rng: np.random.Generator) -> None:
    values = rng.normal(size=(50, 3))
    for limit in (10, 10**9):
        with working_with(Sizes(in_memory=limit)):
            place = Placed(1000, (3,))
        place.put(700, values[20:])
        place.put(680, values[:20])
        found = place.array()
        assert found.shape == (1000, 3)
        assert np.array_equal(found[680:730], values)
        assert not found[:680].any()
        assert not found[730:].any()
