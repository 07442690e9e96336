"""Logs that go by in blocks: what is found does not depend on where they are cut, and memory not on their length."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import polars as pl
import pytest
from five_bar_logs import JOINTS, five_bar
from small_blocks import working_with

import gtau.signals.storage
from gtau.errors import GtauError
from gtau.estimation.friction.law import FrictionLaw
from gtau.estimation.friction.normal_equations import friction_joints
from gtau.signals.preparation.bandwidth import choose_preparation
from gtau.signals.preparation.filters import Decimator, Preparation, position_filter
from gtau.signals.preparation.prepared_run import PreparedRun, prepare
from gtau.signals.run import Run, read_run
from gtau.signals.storage import Store, block, store

SIGNALS = {"time": "t", "position": {"a": "qa", "b": "qb"}, "current": {"a": "va", "b": "vb"}}
N, RATE = 6000, 500.0


def columns(rng: np.random.Generator) -> dict[str, np.ndarray]:
    time = np.arange(N) / RATE
    w = 2 * np.pi * 0.7 * time
    values = {"qa": np.sin(w), "qb": 0.3 * np.cos(1.3 * w), "va": np.cos(w), "vb": 2 * np.sin(1.1 * w)}
    return {"t": time} | {name: np.round(x + 1e-5 * rng.standard_normal(N), 7) for name, x in values.items()}


def irregular(table: dict[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
    time = 300 + np.cumsum(rng.choice([0.0020, 0.0024], N))
    return table | {"t": time}


def bad_rows(table: dict[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
    va = table["va"].copy()
    va[rng.choice(N, 60, replace=False)] = np.nan
    return table | {"va": va}


def repeated(table: dict[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
    twice = np.sort(np.r_[np.arange(N), rng.choice(N, 20, replace=False)])
    return {name: each[twice] for name, each in table.items()}


def wrapped(table: dict[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
    return table | {"qa": (5 * table["qa"] + np.pi) % (2 * np.pi) - np.pi}


def limited(table: dict[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
    return table | {"vb": np.clip(table["vb"], -1.99, np.inf)}


CHANGES = [lambda table, rng: table, irregular, bad_rows, repeated, wrapped, limited]


@pytest.mark.parametrize("change", CHANGES, ids=["clean", *(each.__name__ for each in CHANGES[1:])])
@pytest.mark.parametrize(("kind", "size"), [("csv", 7), ("parquet", 1000)])
def test_a_log_read_in_blocks_is_the_log(
    tmp_path: Path, change: Callable, kind: str, size: int, rng: np.random.Generator
) -> None:
    table = pl.DataFrame(change(columns(rng), rng))
    path = tmp_path / f"log.{kind}"
    table.fill_nan(None).write_csv(path) if kind == "csv" else table.write_parquet(path)
    whole = read_run(path, SIGNALS)
    seen: list[float] = []
    with working_with(10 * size):
        run = read_run(path, SIGNALS, progress=seen.append)
    assert run.notes == whole.notes
    assert seen == sorted(seen)
    assert seen[-1] == 1.0
    assert len(seen) > N // (50 * size)
    np.testing.assert_array_equal(run.valid, whole.valid)
    for name in ("time", "position", "command"):
        np.testing.assert_allclose(getattr(run, name), getattr(whole, name), rtol=1e-13, atol=1e-13)


def test_only_the_joint_that_is_clipped_loses_its_samples(tmp_path: Path, rng: np.random.Generator) -> None:
    table = limited(columns(rng), rng)
    pl.DataFrame(table).write_csv(tmp_path / "log.csv")
    run = read_run(tmp_path / "log.csv", SIGNALS)
    np.testing.assert_array_equal(~run.valid, np.column_stack([np.zeros(N, dtype=bool), table["vb"] == -1.99]))
    assert tuple(map(str, run.notes)) == (
        f"the command of joint 'b' is clipped at -1.99: masked {(table['vb'] == -1.99).sum()} samples; log again with "
        "smaller accelerations, or a higher limit of the drive",
    )
    of = prepare(run, choose_preparation([run])).samples()
    clean = replace(run, valid=np.ones_like(run.valid))
    assert (of.usable[:, 0] == prepare(clean, choose_preparation([run])).samples().usable[:, 0]).all()


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"t": 1e3}, r"by its 't' it is sampled at 0.5 Hz \(steps of 2 s\).*units: \{time: ms\}"),
        ({"t": 1e-3}, r"by its 't' it is sampled at 5e\+05 Hz"),
        ({"qa": 1e5}, r"joint 'a' moves at .*e\+03 \(rad or m\)/s, faster than any joint; give the units"),
        ({"vb": 1e200}, r"column 'vb' reaches -2e\+200, which is implausible for a joint or drive; correct the column"),
    ],
)
def test_values_that_cannot_be_right(
    tmp_path: Path, change: dict[str, float], sentence: str, rng: np.random.Generator
) -> None:
    table = columns(rng)
    pl.DataFrame(table | {name: table[name] * scale for name, scale in change.items()}).write_csv(tmp_path / "log.csv")
    with pytest.raises(GtauError, match=sentence):
        read_run(tmp_path / "log.csv", SIGNALS)


@pytest.mark.parametrize("cutoff", [None, 5.0, 40.0])
@pytest.mark.parametrize("size", [50, 997])
def test_samples_of_a_block_are_those_of_the_whole(cutoff: float | None, size: int, rng: np.random.Generator) -> None:
    table = columns(rng)
    position, command = (np.column_stack([table[f"{kind}{joint}"] for joint in "ab"]) for kind in "qv")
    valid = rng.uniform(size=position.shape) > 0.001
    run = Run("r", ("a", "b"), table["t"], position, command, valid=valid)
    decimator = choose_preparation([run]).decimator
    prepared = prepare(run, Preparation(1.0, cutoff, decimator))
    whole = prepared.samples()
    filtered = position_filter(position, RATE, cutoff)
    kept = slice(prepared.kept.start, prepared.kept.stop)
    rms = np.sqrt(np.mean(filtered[1][kept] ** 2, axis=0))
    np.testing.assert_allclose(np.sqrt(np.diag(prepared.speeds)), rms, rtol=1e-12)
    # second differences of what is rounded: a few units in the last place of q, times the rate squared
    rounding = {"qdd": 8 * np.finfo(float).eps * RATE**2}
    for name, of_log in zip(("q", "qd", "qdd"), filtered, strict=True):
        atol = 1e-12 * np.abs(of_log).max() + rounding.get(name, 0.0)
        np.testing.assert_allclose(getattr(whole, name), of_log[kept], rtol=0, atol=atol)
    for start in range(0, len(prepared), size):
        part, same = prepared.samples(start, start + size), whole[start : start + size]
        np.testing.assert_array_equal(part.usable, same.usable)
        for name in ("time", "q", "qd", "qdd", "command", "command_d", "command_dd"):
            one, other = getattr(part, name), getattr(same, name)
            atol = 1e-12 * np.abs(getattr(whole, name)).max() + rounding.get(name, 0.0)
            np.testing.assert_allclose(one, other, rtol=0, atol=atol)


def test_a_stored_array_is_what_was_written(rng: np.random.Generator) -> None:
    values = rng.normal(size=(1000, 3))
    for samples in (2, 10**7):
        with working_with(samples):
            stored = store(np.array_split(values, 13), (3,))
        np.testing.assert_array_equal(stored, values)
        np.testing.assert_array_equal(block(stored[:, 1:], 10, 500), values[10:500, 1:])
        np.testing.assert_array_equal(stored, values)  # after its pages were let go
    assert Store((2,), bool).array().shape == (0, 2)


def test_a_full_disk_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*arguments: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(gtau.signals.storage.tempfile, "TemporaryFile", full)
    with (
        pytest.raises(GtauError, match=r"no space left on device\); make room there, or set TMPDIR"),
        working_with(1),
    ):
        store([np.ones(100)])


def test_checks_hold_no_more_of_a_longer_log(tmp_path: Path, rng: np.random.Generator) -> None:
    peaks, joints = [], "abcdef"
    signals = {"time": "t", "position": {j: f"q{j}" for j in joints}, "current": {j: f"v{j}" for j in joints}}
    for samples in (100_000, 300_000):
        time = np.arange(samples) / 1000
        table = {"t": time} | {f"v{j}": np.cos(3 * time) for j in joints}
        table |= {f"q{j}": np.sin(3 * time) + 1e-5 * rng.standard_normal(samples) for j in joints}
        pl.DataFrame(table).write_parquet(tmp_path / "log.parquet")
        del table
        tracemalloc.start()
        with working_with(1 << 14):
            read_run(tmp_path / "log.parquet", signals)
        peaks.append(tracemalloc.get_traced_memory()[1] / 2**20)
        tracemalloc.stop()
    assert peaks[1] - peaks[0] < 3  # six columns of the further samples take 9 MiB


def test_the_travel_of_joints_is_found_block_by_block() -> None:
    model, samples, eye = five_bar(), 400_000, np.eye(2)
    position = np.column_stack([np.linspace(0, 1, samples), np.linspace(0, 2, samples)])
    run = Run("a", JOINTS, np.arange(samples) / 500, position, np.zeros((samples, 2)))
    prepared = PreparedRun(run, Preparation(1.0, None, Decimator(1)), range(samples), np.ones(2, bool), eye, eye, eye)
    base = SimpleNamespace(standard=model.parameter_names, names=model.parameter_names)
    dataset: Any = SimpleNamespace(model=model, temperatures=None, prepared=[prepared], base=base)
    law = FrictionLaw(model, {})
    tracemalloc.start()
    with working_with(1 << 12):
        joints = friction_joints(dataset, law, ())
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert [joint.travel for joint in joints if joint.motor is not None] == pytest.approx([1, 2])
    assert peak < 8 * samples  # one column of them


ROBOT = """
robot: pendulum
joints:
  a: {antecedent: ground, alpha: pi/2, theta: q, actuated: true}
"""
EXPERIMENT = """
robot: robot.yaml
signals: {time: t, position: {a: qa}, torque: {a: va}}
runs:
  - log: log
"""
SHARD = 250_000
# The most memory that the program itself held. (That of wait4 and getrusage is the parent's, where that is larger.)
PROGRAM = """
import re, sys, threading, time
from gtau.cli import main
held = [0]  # kB, without the pages of mapped files, which the system takes back
def watch():
    while True:
        held.append(max(held.pop(), int(re.search(r"RssAnon:\\s+(\\d+)", open("/proc/self/status").read())[1])))
        time.sleep(0.02)
threading.Thread(target=watch, daemon=True).start()
sys.argv[0] = "gtau"
try:
    main()
finally:
    print(max(held), file=sys.stderr)
"""


def peak_mib(folder: Path, parts: int) -> float:
    """Peak memory of its own, MiB, of ``gtau identify`` as a program with a log of a pendulum in so many files."""
    (folder / "log").mkdir(parents=True)
    rng = np.random.default_rng(1)
    for k in range(parts):
        time = np.arange(k * SHARD, (k + 1) * SHARD) / 1000.0
        q, qd, qdd = np.sin(2 * time), 2 * np.cos(2 * time), -4 * np.sin(2 * time)
        tau = 0.7 * qdd + 0.3 * qd + 0.5 * np.sign(qd) + 4.0 * np.cos(q) + 0.05 * rng.standard_normal(SHARD)
        pl.DataFrame({"t": time, "qa": q, "va": tau}).write_parquet(folder / "log" / f"part_{k}.parquet")
    (folder / "robot.yaml").write_text(ROBOT)
    (folder / "experiment.yaml").write_text(EXPERIMENT)
    arguments = [sys.executable, "-c", PROGRAM, "identify", str(folder / "experiment.yaml"), "--method", "wls"]
    arguments += ["--out", str(folder)]
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2] / "src")}
    done = subprocess.run(arguments, env=environment, capture_output=True, text=True, check=True)
    found = {each["name"]: each["value"] for each in json.loads((folder / "model.json").read_text())["parameters"]}
    assert found["fv_a"] == pytest.approx(0.3, rel=0.02)
    return float(done.stderr.split()[-1]) / 1024


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="only Linux says in a file how much memory a program held")
def test_memory_does_not_grow_with_the_log(tmp_path: Path) -> None:
    short, long = (peak_mib(tmp_path / str(parts), parts) for parts in (1, 8))
    arrays = 7 * SHARD * (4 * 8 + 1) / 2**20  # of the samples that the long log has more
    assert arrays > 50
    assert long - short < 0.25 * arrays
