"""Position glitches are found, interpolated and reported; healthy motions and noise of any kind hold none."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from five_bar_logs import GAINS, STEEL, Plant, write_log
from small_blocks import working_with
from typer.testing import CliRunner

from gtau.cli.commands import app
from gtau.findings import Finding
from gtau.result import identify
from gtau.signals.run import Run, read_run

SIGNALS = {"time": "t", "position": {"a": "qa", "b": "qb"}, "current": {"a": "va", "b": "vb"}}
N, RATE, NOISE = 4000, 500.0, 1e-4


def table(rng: np.random.Generator, time: np.ndarray | None = None) -> dict[str, np.ndarray]:
    """Two joints along sines, the positions with white noise."""
    time = np.arange(N) / RATE if time is None else time
    w = 2 * np.pi * 0.7 * time
    q = np.column_stack([1 + np.sin(w), 0.3 * np.cos(1.3 * w) - 2]) + NOISE * rng.standard_normal((len(time), 2))
    return {"t": time, "qa": q[:, 0], "qb": q[:, 1], "va": np.cos(w), "vb": 2 * np.sin(1.1 * w)}


def read(columns: dict[str, np.ndarray]) -> tuple[Run, list[Finding]]:
    run = read_run(columns, SIGNALS)
    return run, glitches(run)


def glitches(run: Run) -> list[Finding]:
    return [note for note in run.notes if "outlier" in note.what]


@pytest.mark.parametrize("size", [0.02, 0.3, 3.0, 40.0])
@pytest.mark.parametrize("width", [1, 2, 3])
def test_samples_that_jump_and_come_back_are_interpolated(size: float, width: int, rng: np.random.Generator) -> None:
    columns = table(rng)
    clean = np.column_stack([columns["qa"], columns["qb"]])
    for at, sign in ((700, 1), (712, -1), (3000, 1)):
        columns["qb"][at : at + width] += sign * size
    run, (note,) = read(columns)
    assert note.kind == "outliers"
    assert note.what.startswith(f"interpolated {3 * width} outliers among the positions of 'b' ({3 * width}): ")
    assert (note.joint, note.time, note.share) == ("b", 1.4, 3 * width / N)
    np.testing.assert_allclose(run.position, clean, atol=8 * NOISE)


@pytest.mark.parametrize("value", [0.0, -1.0, 999.0])
def test_missing_values_written_as_numbers_are_found(value: float, rng: np.random.Generator) -> None:
    columns = table(rng)
    expected = [columns[name][900] for name in ("qa", "qb")]
    columns["qa"][900] = columns["qb"][900] = value
    run, (note,) = read(columns)
    assert note.what.startswith("interpolated 2 outliers among the positions of 'a' (1), 'b' (1): the first")
    assert f"of 'a' at 1.8 s (row 901), is {value:.4g} instead of 1.998 (rad or m)" in note.what
    np.testing.assert_allclose(run.position[900], expected, atol=8 * NOISE)


@pytest.mark.parametrize("at", [0, 1, N - 1])
def test_glitches_at_the_ends_are_found(at: int, rng: np.random.Generator) -> None:
    columns = table(rng)
    columns["qa"][at] = 999.0
    run, notes = read(columns)
    assert [note.what.split(":")[0] for note in notes] == ["interpolated 1 outlier among the positions of 'a' (1)"]
    assert abs(run.position[at, 0] - 1) < 1.1


def test_it_does_not_matter_how_much_is_read_at_once(rng: np.random.Generator) -> None:
    columns = table(rng)
    places = np.r_[399, 400, 799, 1201, 2000, 2001]
    columns["qa"][places] += 0.5
    whole, notes = read(columns)
    with working_with(400):
        blocks, again = read(columns)
    assert notes == again
    assert notes[0].what.startswith("interpolated 6 outliers")
    np.testing.assert_allclose(blocks.position, whole.position, rtol=1e-12)
    with working_with(125):
        thinned, again = read(columns)
    assert notes == again
    np.testing.assert_allclose(thinned.position, whole.position, atol=0.1 * NOISE)


def test_a_glitch_does_not_look_like_missing_samples(rng: np.random.Generator) -> None:
    """Stamps that scatter leave it to the motion whether samples are missing."""
    time = np.arange(N) / RATE
    columns = table(rng)
    columns["t"] = time + rng.uniform(0, 0.6 / RATE, N)
    clean, _ = read(columns)
    step = np.diff(columns["qa"])[1400:1500].mean()
    columns["qa"][1450] += 3 * step
    run, notes = read(columns)
    assert len(notes) == 1
    np.testing.assert_allclose(run.time, clean.time, atol=1e-5)


def late(columns: dict[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
    return columns | {"t": columns["t"] + rng.uniform(0, 0.8 / RATE, N)}


def irregular(columns: dict[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
    return table(rng, np.sort(columns["t"] + rng.uniform(0, 0.8 / RATE, N)))


def stale(columns: dict[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
    source = np.maximum.accumulate(np.where(rng.random(N) < 0.03, 0, np.arange(N)))
    return {name: each if name == "t" else each[source] for name, each in columns.items()}


def stale_by_joint(columns: dict[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
    source = np.maximum.accumulate(np.where(rng.random(N) < 0.001, 0, np.arange(N)))
    return columns | {"qa": columns["qa"][source]}


def dropped(columns: dict[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
    kept = np.sort(rng.choice(N, N - 80, replace=False))
    return {name: each[kept] for name, each in columns.items()}


def coarse(columns: dict[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
    return columns | {name: np.round(columns[name] / 1.5e-3) * 1.5e-3 for name in ("qa", "qb")}


def exact(columns: dict[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
    return columns | {"qa": np.sin(3 * columns["t"]), "qb": np.cos(4 * columns["t"])}


def hard_reversals(columns: dict[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Kinks, as where a joint runs into its stop and back."""
    angle = 4 * columns["t"]
    return columns | {
        "qa": np.abs((angle % 2) - 1),
        "qb": np.abs((angle % 3.1) - 1.55) + NOISE * rng.standard_normal(N),
    }


def steps(columns: dict[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Short moves between long rests, with the noise of a sixteen-bit encoder."""
    target = rng.uniform(-1, 1, 9)
    s = np.clip((columns["t"] % 1.0) / 0.05, 0, 1)
    k = np.minimum(columns["t"].astype(int), 7)
    path = target[k] + (target[k + 1] - target[k]) * s**3 * (10 - 15 * s + 6 * s**2)
    return columns | {"qa": np.round((path + 3e-5 * rng.standard_normal(N)) / 1e-4) * 1e-4}


def wrapping(columns: dict[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
    """At rest where the angle jumps by a turn, which noise makes it do to and fro."""
    rest = np.pi + 0.002 * rng.standard_normal(N) + np.where(columns["t"] > 3, 0, columns["t"] - 3)
    return columns | {"qa": (rest + np.pi) % (2 * np.pi) - np.pi}


HEALTHY = [late, irregular, stale, stale_by_joint, dropped, coarse, exact, hard_reversals, steps, wrapping]


@pytest.mark.parametrize("change", HEALTHY, ids=[each.__name__ for each in HEALTHY])
def test_healthy_motions_have_none(change: Callable, rng: np.random.Generator) -> None:
    for _ in range(3):
        assert read(change(table(rng), rng))[1] == []


def test_heavy_tails_have_none(rng: np.random.Generator) -> None:
    """Noise of Laplace's distribution, whose largest of 10,000 samples is 9 mean distances off."""
    for _ in range(5):
        columns = table(rng)
        for name in ("qa", "qb"):
            columns[name] = columns[name] + rng.laplace(0, 1e-3, N)
        assert read(columns)[1] == []


def test_real_logs_have_none(shared: Path) -> None:
    joints = [f"j{k}" for k in range(1, 7)]
    ur = {
        "time": "1",
        "position": {joint: str(k) for k, joint in enumerate(joints, 2)},
        "current": {joint: str(k) for k, joint in enumerate(joints, 14)},
    }
    logs = sorted((shared / "ur10e").rglob("*.csv"))
    runs = [read_run(log, ur) for log in logs]
    assert len(logs) == 15
    for folder, time, names, command in (
        ("dvrk_psm", {"rate": 200}, [f"q{k}" for k in (1, 2, 3)], "tau"),
        ("panda_rosbag2", "t", [f"q_fer_joint{k}" for k in range(1, 8)], "effort_fer_joint"),
    ):
        position = {name[-1]: name for name in names}
        signals = {"time": time, "position": position, "torque": {joint: f"{command}{joint}" for joint in position}}
        runs += [read_run(log, signals) for log in sorted((shared / folder).glob("*.csv"))]
    assert [note for run in runs for note in glitches(run)] == []


@pytest.mark.slow
@pytest.mark.parametrize("value", ["0", "999"])
def test_check_shows_them_and_the_gains_stay(value: str, tmp_path: Path) -> None:
    plant = Plant(noise=0.01)
    write_log(tmp_path / "free.csv", plant.run("free", seed=1))
    write_log(tmp_path / "loaded.csv", plant.run("loaded", payload=STEEL, seed=2))
    experiment = tmp_path / "experiment.yaml"
    experiment.write_text(
        "robot: five-bar\nsignals: {time: t, position: {left: q1, right: q2}, current: {left: v1, right: v2}}\n"
        "runs:\n  - {log: free.csv}\n  - {log: loaded.csv, payload: {name: steel, mass: 1.2}}\n"
    )
    clean = identify(experiment)
    lines = (tmp_path / "free.csv").read_text().splitlines()
    row = lines[2001].split(",")
    lines[2001] = ",".join([row[0], value, *row[2:]])
    (tmp_path / "free.csv").write_text("\n".join(lines) + "\n")
    checked = CliRunner().invoke(app, ["check", str(experiment)])
    assert checked.exit_code == 0, checked.output
    shown = " ".join(checked.output.split())
    assert "interpolated 1 outlier among the positions of 'left' (1): the first, of 'left' at 4 s (line 2002)" in shown
    assert f", is {value} instead of {float(row[1]):.4g} (rad or m)" in shown
    glitched = identify(experiment)
    for joint, gain in zip(("left", "right"), GAINS, strict=True):
        mine, other = glitched.drive_gains[joint], clean.drive_gains[joint]
        assert abs(mine.value - other.value) < 0.05 * other.std
        assert abs(mine.value - gain) < 4 * mine.std
