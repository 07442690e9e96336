"""Following a log that grows, and a folder that fills: the numbers are those of finished logs, also after a kill."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from five_bar_logs import Plant, write_experiment, write_log

from gtau.errors import GtauError
from gtau.result import Result, identify, load
from gtau.signals.run import Run
from gtau.uses.identify import read_log
from gtau.watch.follow import SETTLED, follow
from gtau.watch.watch import Watch

BLOCK = 4.0  # s; the command takes 10 and more


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("follow")
    identify(write_experiment(folder, Plant(noise=0.02))).save(folder / "model.json")
    return folder


@pytest.fixture(scope="module")
def model(folder: Path) -> Result:
    return load(folder / "model.json")


def long_run(seconds: float = 24.0) -> Run:
    return Plant(noise=0.02).run("long", seconds=seconds, seed=5)


def values(folder: Path) -> list[tuple[str, bytes, bool]]:
    """The logs of a history without the time of day."""
    with closing(sqlite3.connect(folder / "history.db")) as database:
        rows = database.execute("SELECT log, numbers, alarm FROM logs ORDER BY id").fetchall()
    return [(log, numbers, bool(alarm)) for log, numbers, alarm in rows]


def test_a_log_that_grows_gives_the_numbers_of_its_parts(folder: Path, model: Result, tmp_path: Path) -> None:
    whole = write_log(tmp_path / "whole.csv", long_run())
    lines = whole.read_text().splitlines(keepends=True)
    growing = tmp_path / "growing.csv"
    growing.write_text("".join(lines[:900]) + lines[900][:7])  # a torn line
    done = [900]

    def more() -> bool:
        """Let the log grow whenever nothing new is there."""
        if done[0] >= len(lines):
            return True
        to = min(done[0] + 3100, len(lines))
        with growing.open("a") as file:
            file.write(("".join(lines[done[0] : to]))[7 if done[0] == 900 else 0 :])
        done[0] = to
        return False

    def read(log: Path) -> Run:
        return read_log(model, log, folder / "experiment.yaml")

    watch = Watch(model, tmp_path / "history", baseline=4)
    found = list(follow(watch, growing, read, BLOCK, more))
    assert len(found) == 6
    assert not any(each.skipped for each in found)
    part = tmp_path / "part.csv"
    part.write_text("".join([lines[0], *lines[1 + 2000 : 1 + 4000]]))
    expected = Watch(model, baseline=4).update(read(part))
    assert found[1].values == expected.values
    again = Watch(model, tmp_path / "history", baseline=4)
    assert list(follow(again, growing, read, BLOCK, lambda: True)) == []  # all of it is in the history


def test_a_folder_that_fills(folder: Path, model: Result, tmp_path: Path) -> None:
    chunks = tmp_path / "chunks"
    chunks.mkdir()
    still = replace(long_run(4.0), position=np.full((2000, 2), [2.0, 1.0]))  # at rest: nothing is said
    for name, run in (("1", long_run(4.0)), ("2", still), ("10", long_run(4.0))):
        log = write_log(chunks / f"chunk_{name}.csv", replace(run, command=run.command + 1e-3 * float(name)))
        os.utime(log, (time.time() - 2 * SETTLED,) * 2)
    (chunks / "chunk_11.csv").write_text("t,q1,q2,v1,v2\n0.0,1.0")  # being written

    def read(log: Path) -> Run:
        return read_log(model, log, folder / "experiment.yaml")

    found = []
    for each in follow(Watch(model, baseline=4), chunks, read, BLOCK):
        found.append(each)
        if len(found) == 3:
            break
    names = [each.log for each in found]
    assert names == ["chunk_1", "chunk_2", "chunk_10"]
    assert [bool(each.skipped) for each in found] == [False, True, False]


def test_a_file_without_lines_is_no_text_log(model: Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gtau.watch.follow.CHUNK", 1 << 10)
    monkeypatch.setattr("gtau.watch.follow.LONGEST", 1 << 20)
    (tmp_path / "log.csv").write_bytes(b"x" * (3 << 20))
    with pytest.raises(GtauError, match="is no text log: its first 1 MiB have fewer than 500 lines; give a folder"):
        next(follow(Watch(model), tmp_path / "log.csv", Path.read_text, BLOCK))


def test_a_pipe_among_logs_is_no_log(model: Result, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "log.csv")
    with pytest.raises(GtauError, match="is a device or a pipe, not a file; give a folder"):
        next(follow(Watch(model), tmp_path / "log.csv", Path.read_text, BLOCK))
    assert list(follow(Watch(model), tmp_path, Path.read_text, BLOCK, lambda: True)) == []


def test_the_ros_node_publishes_diagnostics(model: Result) -> None:
    from ros2_watch_node import Watcher

    def message(**fields):
        return SimpleNamespace(**fields)

    watcher = Watcher(Watch(model, baseline=8), 4.0, message, message, message)
    said, run = [], long_run(48.1)
    for k, (time_, position, effort) in enumerate(zip(run.time, run.position, run.command, strict=True)):
        stamp = message(sec=int(time_), nanosec=round(1e9 * (time_ % 1)))
        effort = effort * (1.0 if k < 18000 else 1.2)
        state = message(
            header=message(stamp=stamp), name=["right", "left"], position=position[::-1], effort=effort[::-1]
        )
        if (found := watcher.add(state)) is not None:
            (status,) = found.status
            said.append((status.level, status.message, {pair.key for pair in status.values}))
    levels = [level for level, _, _ in said]
    assert levels[:9] == [b"\x01"] * 8 + [b"\x00"]
    assert levels[-1] == b"\x02"
    assert said[0][1] == "baseline, 1 of 8 blocks"
    assert "The robot " in said[-1][1]
    assert "gain_left" in said[-1][2]


@pytest.mark.slow
def test_a_kill_loses_no_block(folder: Path, tmp_path: Path) -> None:
    log = write_log(tmp_path / "long.csv", long_run(110.0))
    command = [sys.executable, "-m", "gtau", "watch", str(folder / "model.json"), str(log), "--follow", "--block", "10"]
    command += ["--baseline", "4", "--experiment", str(folder / "experiment.yaml"), "--json", "--out"]

    def run(out: Path, kill_after: int) -> None:
        """Follow the log until so many lines are there, then end at once."""
        process = subprocess.Popen([*command, str(out)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        while process.poll() is None:
            if (out / "history.db").exists() and len(values(out)) >= kill_after:
                break
            time.sleep(0.003)
        process.send_signal(signal.SIGKILL)
        process.wait()

    run(tmp_path / "whole", 11)
    for lines in (1, 4, 8, 11):
        run(tmp_path / "killed", lines)
    assert len(values(tmp_path / "whole")) == 11
    assert values(tmp_path / "killed") == values(tmp_path / "whole")
