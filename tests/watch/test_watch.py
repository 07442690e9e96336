"""A watched robot: faults are found and named, healthy days raise no alarm, and a history survives its end."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from five_bar_logs import CHI, STEEL, Plant, write_experiment, write_log
from typer.testing import CliRunner

from gtau.cli.commands import app
from gtau.errors import GtauError
from gtau.estimation.identify import identify
from gtau.estimation.results.result import Result
from gtau.report.watch import verdict_text
from gtau.signals.run import Run
from gtau.watch.statistics import LogStatistics, statistics_of
from gtau.watch.watch import Watch

NOISE = 0.02  # A
HEALTHY = 10


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("watch")
    identify(write_experiment(folder, Plant(noise=NOISE))).save(folder / "model.json")
    return folder


@pytest.fixture(scope="module")
def model(folder: Path) -> Result:
    return Result.load(folder / "model.json")


@cache
def reference(gain: float = 1.0, friction: float = 1.0, payload: float = 0.0) -> Run:
    """The reference motion without noise, with a changed gain of the left drive, friction of the right one, a load."""
    chi = {**CHI, "fs_right": CHI["fs_right"] * friction}
    load = {kind: value * payload for kind, value in STEEL.items()}
    run = Plant(chi=chi).run("reference", seconds=8.0, payload=load, seed=5)
    return replace(run, command=run.command / np.array([gain, 1.0]))


def day(k: int, zero: float = 0.0, **change: float) -> Run:
    """The log of a day: noise of its own."""
    run, rng = reference(**change), np.random.default_rng([3, k])
    position = run.position + np.radians([zero, 0.0])
    return replace(
        run, name=f"day {k}", position=position, command=run.command + NOISE * rng.normal(size=run.command.shape)
    )


@pytest.fixture(scope="module")
def healthy(model: Result) -> list[LogStatistics]:
    return [statistics_of(model, day(k)) for k in range(HEALTHY + 5)]


def watched(model: Result, logs: list[LogStatistics], out: Path | None = None) -> Watch:
    watch = Watch(model, out, baseline=HEALTHY)
    for k, log in enumerate(logs):
        watch.update_statistics(log, f"digest {k}", "2026-01-01")
    return watch


def test_statistics_are_the_changes_that_were_made(model: Result) -> None:
    before = statistics_of(model, day(0))
    names = [chart.name for chart in before.charts]

    def moved(after: LogStatistics, name: str) -> float:
        k = names.index(name)
        return float(after.values[k] - before.values[k])

    for name, change, wanted, tolerance in (
        ("gain_left", {"gain": 1.05}, 0.05, 0.005),
        ("fs_right", {"friction": 1.5}, 0.5 * CHI["fs_right"], 0.03),
        ("zero_left", {"zero": 0.5}, -0.5, 0.05),
    ):
        assert moved(statistics_of(model, day(0, **change)), name) == pytest.approx(wanted, abs=tolerance), name
    late = replace(day(0), command=np.roll(day(0).command, 2, axis=0))  # by 4 ms: v(t - d) is that of later
    assert moved(statistics_of(model, late), "delay_left") == pytest.approx(-0.004, abs=4e-4)


@pytest.mark.parametrize(
    ("change", "kind", "joint", "size", "tolerance"),
    [
        ({"gain": 0.95}, "gain", "left", -0.05, 0.01),
        ({"friction": 1.5}, "friction", "right", 0.35, 0.06),
        ({"payload": 0.2}, "load", "", 0.24, 0.05),
        ({"zero": 2.0}, "zero", "left", -2.0, 0.2),
    ],
)
def test_a_fault_is_found_and_named(
    model: Result, healthy: list[LogStatistics], change: dict, kind: str, joint: str, size: float, tolerance: float
) -> None:
    watch = watched(model, healthy)
    assert watch.alarm is None
    for k in range(100, 104):
        status = watch.update_statistics(statistics_of(model, day(k, **change)), f"{k}", "2026-02-01")
    assert not status.healthy
    best = status.entry.alarm.explanations[0]
    assert (best.kind, best.joint) == (kind, joint)
    if kind != "load" or best.unit == "kg":
        assert best.size == pytest.approx(size, abs=tolerance)
        assert abs(best.size - size) < 3 * best.half
    assert status.entry.alarm.since == "day 100"


def test_contacts_and_clocks_are_named(model: Result, healthy: list[LogStatistics]) -> None:
    def bumped(k: int) -> Run:
        current = day(k).command.copy()
        current[1000 + 200 * (k % 7) :][:250, 0] += 0.5  # A, for half a second
        return replace(day(k), command=current)

    def late(k: int) -> Run:
        return replace(day(k), command=np.roll(day(k).command, 2, axis=0))

    for make, kind, joint in ((bumped, "contact", "left"), (late, "clock", "")):
        watch = watched(model, healthy)
        for k in range(100, 103):
            status = watch.update_statistics(statistics_of(model, make(k)), f"{k}", "2026-02-01")
        (named,) = status.entry.alarm.explanations
        assert (named.kind, named.joint) == (kind, joint)
    assert named.size == pytest.approx(-0.004, abs=3e-4)


def test_a_log_outside_the_bands_is_not_called_unchanged(model: Result, healthy: list[LogStatistics]) -> None:
    watch = Watch(model, baseline=4)
    logs = [*healthy[:5], statistics_of(model, day(50, payload=0.05))]
    said = []
    for k, log in enumerate(logs):
        status = watch.update_statistics(log, f"digest {k}", "2026-01-01")
        said.append(verdict_text(watch, status.entry))
        assert status.healthy
    assert said[4].words == "No change since the baseline, 5 logs."
    low, high = watch.baseline.bands()
    outside = sum(
        not low[watch.names.index(name)] <= value <= high[watch.names.index(name)]
        for name, value in status.entry.values.items()
    )
    assert said[5].words.startswith(f"No alarm yet: {outside} of {len(status.entry.values)} charts of the last log are")
    assert said[5].style == "neutral"


def test_a_history_goes_on_after_a_kill_with_the_same_numbers(
    model: Result, healthy: list[LogStatistics], tmp_path: Path
) -> None:
    whole = watched(model, healthy, tmp_path / "whole")
    for k, log in enumerate(healthy):
        Watch(model, tmp_path / "parts", baseline=HEALTHY).update_statistics(log, f"digest {k}", "2026-01-01")
    expected = (tmp_path / "whole" / "history.jsonl").read_text()
    path = tmp_path / "parts" / "history.jsonl"
    assert path.read_text() == expected
    lines = expected.splitlines(keepends=True)
    path.write_text("".join(lines[:-1]) + lines[-1][:200])  # killed while the last line was written
    again = Watch(model, tmp_path / "parts", baseline=HEALTHY)
    assert again.count == whole.count - 1
    assert f"digest {len(healthy) - 1}" not in again.seen
    again.update_statistics(healthy[-1], f"digest {len(healthy) - 1}", "2026-01-01")
    assert path.read_text() == expected


def test_histories_are_refused_where_they_do_not_suit(model: Result, healthy: list, tmp_path: Path) -> None:
    watched(model, healthy[:2], tmp_path)
    with pytest.raises(GtauError, match="begun with --baseline 10, not 12"):
        Watch(model, tmp_path, baseline=12)
    with pytest.raises(GtauError, match="at least 4 healthy logs"):
        Watch(model, baseline=2)
    path = tmp_path / "history.jsonl"
    path.write_text(path.read_text().replace('"phase"', '"phases"', 1))
    with pytest.raises(GtauError, match="line 2 is damaged"):
        Watch(model, tmp_path, baseline=HEALTHY)
    with pytest.raises(GtauError, match="holds torques"):
        Watch(model).update(replace(day(0), kind="torque"))


def test_the_command(folder: Path, tmp_path: Path) -> None:
    def call(*words: str):
        experiment, out = str(folder / "experiment.yaml"), str(tmp_path / "history")
        common = ["--experiment", experiment, "--out", out, "--baseline", "4"]
        return CliRunner().invoke(app, ["watch", str(folder / "model.json"), *words, *common])

    logs = [
        write_log(tmp_path / f"day_2026-01-{k + 1:02d}.csv", day(k, **({"payload": 1.0} if k == 6 else {})))
        for k in range(8)
    ]
    first = call(*map(str, logs[:6]), "--json")
    assert first.exit_code == 0, first.output
    lines = [json.loads(line) for line in first.stdout.splitlines()]
    assert [line["phase"] for line in lines] == ["baseline"] * 4 + ["watching"] * 2
    assert lines[3]["date"] == "2026-01-04"
    faulty = call(*map(str, logs[:7]))  # those that were seen are skipped
    assert faulty.exit_code == 3, faulty.output
    words = " ".join(faulty.stdout.split())
    assert "load" in words
    assert "not a safety function" in words
    assert call().exit_code == 2
    report = (tmp_path / "history" / "report.html").read_text()
    assert "not a safety function" in report
    assert call(str(logs[6]), "--json").stdout == ""
    after = call(str(logs[7]), "--reset", "2026-01-08")
    assert after.exit_code == 0, after.output
    assert "1 of 4 healthy logs" in after.stdout
    later = write_log(tmp_path / "day_2026-01-09.csv", day(9))
    assert "2 of 4 healthy logs" in call(str(later), "--reset", "2026-01-08").stdout  # the same maintenance
    assert "write it as 2026-03-28" in call(str(later), "--reset", "March").stderr
