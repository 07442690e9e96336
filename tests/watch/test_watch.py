"""A watched robot: faults are found and named, healthy days raise no alarm, and a history survives its end."""

from __future__ import annotations

import json
import os
import re
import signal
import sqlite3
import time
from contextlib import closing
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from five_bar_logs import CHI, STEEL, Plant, write_experiment, write_log
from models_to_export import model_of
from typer.testing import CliRunner

from gtau.cli.commands import app
from gtau.errors import GtauError
from gtau.model.home import load_robot
from gtau.report.watch import alarm_words, state_of, verdict_text, watch_report
from gtau.result import Result, identify, load
from gtau.robots.parameter import Parameter
from gtau.signals.reading.statements import Tolerances
from gtau.signals.run import Run
from gtau.watch.alarms import power
from gtau.watch.causes import signal_faults
from gtau.watch.statistics import LogStatistics, identified, statistics_of, unseen_zeros
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
    return load(folder / "model.json")


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
        watch.update_statistics(log, f"digest {k}", f"2026-01-{k + 1:02d}")
    return watch


def days_of(model: Result, first: int, count: int, **change: float) -> list[LogStatistics]:
    return [statistics_of(model, day(k, **change)) for k in range(first, first + count)]


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
    assert moved(statistics_of(model, late), "delay_left") == pytest.approx(0.004, abs=4e-4)


def test_friction_is_what_the_law_makes_of_terms_that_cancel(model: Result) -> None:
    """Friction that hardly falls at the logged speeds: its terms are 20 N m, their sum is what it was."""
    names = [Parameter(kind, "left") for kind in ("fv", "fs")]
    viscous, coulomb = (model.friction_parameters[name] for name in names)
    assert [identified(model, name) for name in names] == pytest.approx([viscous.value, coulomb.value], rel=1e-6)
    terms = {"fs": coulomb.value + 20.0, "fb": -20.0, "vs": 1e3}
    falling = {Parameter(kind, "left"): replace(coulomb, value=value) for kind, value in terms.items()}
    other = model.replaced(friction={**model.friction, **falling})
    assert [identified(other, name) for name in names] == pytest.approx([viscous.value + 0.02, coulomb.value], abs=1e-3)


@pytest.mark.parametrize(
    ("change", "alarm", "kind", "joint", "size", "tolerance"),
    [
        ({"gain": 0.97}, "change", "gain", "left", -0.03, 0.01),
        ({"gain": 0.90}, "tolerance", "gain", "left", -0.10, 0.01),
        ({"friction": 1.5}, "tolerance", "friction", "right", 0.35, 0.06),
        ({"payload": 0.4}, "tolerance", "load", "", 0.48, 0.05),
        ({"zero": 2.0}, "tolerance", "zero", "left", -2.0, 0.2),
    ],
)
def test_a_fault_is_found_and_named(
    model: Result, healthy: list, change: dict, alarm: str, kind: str, joint: str, size: float, tolerance: float
) -> None:
    watch = watched(model, healthy)
    assert watch.alarm is None
    for k, log in enumerate(days_of(model, 100, 4, **change)):
        status = watch.update_statistics(log, f"{k}", f"2026-01-{16 + k}")
        assert not status.healthy or k < 2  # at the third log at the latest
    best = status.alarm.explanations[0]
    assert (status.alarm.kind, best.kind, best.joint) == (alarm, kind, joint)
    if kind != "load" or best.unit == "kg":
        assert best.size == pytest.approx(size, abs=tolerance)
        assert abs(best.size - size) < 3 * best.half
    assert status.alarm.since == "day 100"


def test_what_was_wrong_from_the_first_log_is_beyond_tolerance(model: Result) -> None:
    watch = Watch(model, baseline=HEALTHY)
    for k, log in enumerate(days_of(model, 0, 4, gain=0.9, payload=0.4)):
        watch.update_statistics(log, f"{k}", f"2026-01-{k + 1:02d}")
    assert (watch.phase, watch.alarm.kind, watch.alarm.since) == ("baseline", "tolerance", "day 0")
    (cause,) = watch.alarm.explanations
    parts = {part.kind: part for part in (cause, cause.and_also)}
    assert parts["gain"].size == pytest.approx(-0.10, abs=0.01)
    assert parts["load"].size == pytest.approx(0.48, abs=0.05)
    wide = Watch(model, baseline=HEALTHY, tolerances=Tolerances(gain=0.2, zero=10.0, delay=0.1))
    for k, log in enumerate(days_of(model, 0, 4, gain=0.93)):
        assert wide.update_statistics(log, f"{k}", f"2026-01-{k + 1:02d}").healthy


def test_contacts_lags_and_clocks_are_named(model: Result, healthy: list[LogStatistics]) -> None:
    def bumped(k: int) -> Run:
        current = day(k).command.copy()
        current[1000 + 200 * (k % 7) :][:250, 0] += 0.5  # A, for half a second
        return replace(day(k), command=current)

    def late(k: int, samples: int = 2) -> Run:
        return replace(day(k), command=np.roll(day(k).command, samples, axis=0))

    def fast(k: int) -> Run:
        return replace(day(k), time=1.05 * day(k).time)

    sizes = {}
    for make, kind, joint in ((bumped, "contact", "left"), (fast, "rate", ""), (late, "clock", "")):
        watch = watched(model, healthy)
        for k in range(100, 104):
            status = watch.update_statistics(statistics_of(model, make(k)), f"{k}", f"2026-02-{k - 99:02d}")
        (named,) = status.alarm.explanations
        assert (named.kind, named.joint) == (kind, joint)
        sizes[kind] = named.size
    assert sizes["contact"] > 2
    assert sizes["rate"] == pytest.approx(0.05, abs=0.003)  # it is not quite linear
    assert sizes["clock"] == pytest.approx(0.004, abs=3e-4)
    assert "lag of all currents +3.9" in alarm_words(status.alarm)[0]
    watch = watched(model, healthy)
    for k in range(100, 103):
        watch.update_statistics(statistics_of(model, late(k, 10)), f"{k}", f"2026-02-{k - 99:02d}")
    assert watch.alarm.explanations[0].kind == "clock"  # 20 ms, of which a part is seen


def made(kind: str, k: int) -> Run:
    """The log of a day with a fault of its signals, that of one joint on the right one."""
    run = day(k)
    q, v = run.position.copy(), run.command.copy()
    place, forward = (q[:, 1] - q[:, 1].min()) / np.ptp(q[:, 1]), np.sign(np.gradient(q[:, 1]))
    match kind:
        case "exchanged position":
            q = q[:, ::-1]
        case "exchanged command":
            v = v[:, ::-1]
        case "frozen":
            q[:, 1] = q[0, 1]
        case "frozen later":
            q[2000:, 1] = q[2000, 1]
        case "frozen, few values":
            q[:, 1] = np.round(6 * place) / 6
        case "rub":
            v[:, 1] += 0.1 * forward * (np.abs(place - 0.6) < 0.15)  # 0.4 N m
        case "ripple":
            v[:, 1] += 0.05 * np.sin(40 * place)
    return replace(run, position=q, command=v)


@pytest.mark.parametrize(
    ("fault", "joint", "size", "words"),
    [
        ("exchanged position", "left and right", 1.0, "positions of left and right exchanged"),
        ("exchanged command", "left and right", 1.0, "currents of left and right exchanged"),
        ("frozen", "right", 1.0, "frozen encoder of right (one position in 100 % of the log)"),
        ("frozen later", "right", 0.5, "frozen encoder of right (one position in 50 % of the log)"),
        ("frozen, few values", "right", None, "frozen encoder of right"),
        ("rub", "right", 0.4, "rub of right (friction that differs by 0.4"),
        ("ripple", "right", 0.4, "ripple of right (torque that differs by 0.3"),
    ],
)
def test_a_fault_of_the_signals_is_named(
    model: Result, healthy: list[LogStatistics], fault: str, joint: str, size: float | None, words: str
) -> None:
    watch = watched(model, healthy)
    for k in range(100, 102):
        watch.update_statistics(statistics_of(model, made(fault, k)), f"{k}", f"2026-02-{k - 99:02d}")
        (cause,) = watch.alarm.explanations
        assert (cause.kind, cause.joint) == (re.split("[ ,]", fault)[0], joint)
        if size is not None:
            assert cause.size == pytest.approx(size, rel=0.1)
        assert words in alarm_words(watch.alarm)[0]


def test_nothing_is_said_beside_a_reversed_current(model: Result, healthy: list[LogStatistics]) -> None:
    watch = watched(model, healthy)
    for k in range(100, 104):
        run = day(k, friction=1.2)  # within tolerance
        log = statistics_of(model, replace(run, command=run.command * [1.0, -1.0]))
        watch.update_statistics(log, f"{k}", f"2026-02-{k - 99:02d}")
    (cause,) = watch.alarm.explanations
    assert (cause.kind, cause.joint, cause.and_also) == ("units", "right", None)
    assert cause.size == pytest.approx(-1.0, abs=0.05)


def test_no_fault_of_the_signals_is_named_without_one(model: Result, healthy: list[LogStatistics]) -> None:
    values = np.mean([log.values for log in healthy], axis=0)
    others = [{"gain": 0.8}, {"friction": 3.0}, {"payload": 1.0}, {"zero": 10.0}, {"gain": 0.9, "payload": 0.4}]
    changed = [log for change in others for log in days_of(model, 100, 1, **change)]
    late = statistics_of(model, replace(day(100), command=np.roll(day(100).command, 10, axis=0)))
    for log in (*healthy, *changed, late):
        assert signal_faults(model, log, values, log.speed, np.ones(2)) == ()


def test_an_odd_log_is_set_aside_until_the_next_agrees(model: Result, healthy: list[LogStatistics]) -> None:
    wrong = statistics_of(model, replace(day(50), command=1000 * day(50).command))  # in mA
    for place in (0, 2, 6):
        watch = watched(model, [*healthy[:place], wrong])
        assert watch.alarm.kind == "log"
        assert watch.count == place
        if place:
            assert [(cause.kind, cause.joint) for cause in watch.alarm.explanations] == [("units", "")]
        watch.update_statistics(healthy[place], "next", "2026-02-01")
        assert watch.alarm is None
        assert watch.count == place + 1
    heavy = days_of(model, 60, 3, payload=2.0)
    watch = watched(model, [*healthy, heavy[0]])
    head, points = alarm_words(watch.alarm)
    assert "is odd by itself and set aside" in head
    load, std = map(float, re.findall(r"load \+([\d.]+) ± ([\d.]+) kg", head)[0])
    assert (load, std) == (pytest.approx(2.397, abs=0.002), pytest.approx(0.0037, abs=0.0003))
    assert points[0].startswith("Repeat it")
    watch.update_statistics(heavy[1], "next", "2026-01-17")
    assert watch.alarm.kind == "change"
    watch.update_statistics(heavy[2], "third", "2026-01-18")
    assert (watch.alarm.kind, watch.alarm.since) == ("tolerance", "day 60")


def test_an_alarm_ends(model: Result, healthy: list[LogStatistics]) -> None:
    def add(watch: Watch, logs: list[LogStatistics], first: int) -> None:
        for k, log in enumerate(logs):
            watch.update_statistics(log, f"{first}.{k}", f"2026-03-{first + k:02d}")

    faulty, later = days_of(model, 100, 3, gain=0.9), days_of(model, 200, 9)
    watch = watched(model, healthy)
    add(watch, faulty, 1)
    assert watch.alarm is not None
    watch.acknowledge("new motor")
    assert watch.alarm is None
    assert verdict_text(watch).points[0] == "Accepted as reference since log day 100: new motor."
    (section,) = (section for section in watch_report(watch).sections if section.id == "of-left")
    (panel,) = (panel for panel in section.items[0].panels if panel.y.label == "drive gain of left, %")
    days, change = (np.concatenate([getattr(each, axis) for each in panel.series]) for axis in "xy")
    change = change[np.argsort(days)]  # from the new reference, the days before included
    assert (len(change), panel.rules[0].label) == (len(healthy) + 3, "new start")
    np.testing.assert_allclose(change[-3:], 0, atol=1)
    np.testing.assert_allclose(change[:-3], 10, atol=2)
    add(watch, days_of(model, 110, 3, gain=0.9), 4)
    assert watch.alarm is None  # the new reference
    watch.undo("day 100")
    assert watch.alarm.since == "day 100"
    add(watch, later, 7)  # the motor is repaired
    assert watch.alarm is None
    assert [(event.kind, event.undone) for event in watch.events] == [("acknowledge", 1), ("repaired", 0)]
    assert "No change since the baseline" in verdict_text(watch).words
    watch.forget("day 203")
    count = watch.count
    watch.undo("day 203")
    assert watch.count == count + 1
    for call, sentence in (
        (lambda: watch.forget("day 999"), "holds no log 'day 999'; give one of its names, such as day 20"),
        (lambda: Watch(model).forget("day 1"), "holds no log 'day 1'; it is empty, watch logs first"),
        (lambda: watch.acknowledge("why"), "there is no alarm to acknowledge"),
        (lambda: watch.undo("day 999"), "nothing was done about 'day 999'"),
    ):
        with pytest.raises(GtauError, match=sentence):
            call()


def test_a_common_warming_is_one_alarm(model: Result, healthy: list[LogStatistics]) -> None:
    known = model.friction_parameters
    size = np.array([abs(known[chart.name].value) if chart.group == "friction" else 0.0 for chart in healthy[0].charts])
    watch, alarms = watched(model, healthy[:12]), []

    def add(share: float, days: int) -> None:
        for _ in range(days):
            k, before = watch.view.logs.ids.max(), watch.alarm
            log = healthy[k % len(healthy)]
            log = replace(log, name=f"log {k}", values=log.values + share * size)
            date = np.datetime64("2026-01-13") + np.timedelta64(int(k) - 12, "D")
            watch.update_statistics(log, f"common {k}", str(date))
            if watch.alarm is not None and before is None:
                alarms.append([(cause.kind, cause.joint) for cause in watch.alarm.explanations])

    add(0.5, 1)
    add(0.0, 2)
    assert not alarms  # one warm day is not odd
    for _ in range(2):  # warm weeks come and go
        add(0.5, 9)
        add(0.0, 9)
    assert alarms == [[("warming", "")]]
    add(1.2, 5)
    assert alarms[1:] == [[("warming", "")]]  # more than ever


def test_the_power_of_a_motion_is_what_is_found(model: Result, healthy: list[LogStatistics]) -> None:
    bias = np.mean([log.values for log in healthy], axis=0)  # which the imagined robot lacks
    for times, wanted in ((1.5, True), (0.3, False)):
        watch = Watch(model, baseline=HEALTHY)
        watch.imagine(day(0))
        assert watch.alarm is None
        k = watch.view.names.index("gain_left")
        week, month, slowly = power(watch.view)[k]
        assert 0 < month <= week <= 0.05 < slowly < 0.1  # the tolerance, and the interval of the gain beside it
        for number, log in enumerate(healthy[:7]):
            step = times * week * np.array([chart.name == "gain_left" for chart in log.charts])
            date = f"2000-02-{number + 1:02d}"
            watch.update_statistics(replace(log, name=date, values=log.values - bias + step), date, date)
        assert (watch.alarm is not None) is wanted


def test_no_motion_shows_the_zero_of_a_vertical_axis(model: Result) -> None:
    arm = load_robot("ur10e")
    assert unseen_zeros(model_of(arm)) == ("shoulder_pan_joint",)
    assert unseen_zeros(model_of(replace(arm, gravity=(1.0, 0.0, -9.7)))) == ()
    assert unseen_zeros(model) == ()


def rows(folder: Path) -> list[tuple]:
    with closing(sqlite3.connect(folder / "history.db")) as database:
        return database.execute("SELECT log, date, numbers, alarm FROM logs ORDER BY id").fetchall()


def test_kills_and_two_writers_lose_nothing(model: Result, healthy: list[LogStatistics], tmp_path: Path) -> None:
    watched(model, healthy, tmp_path / "one")

    def work() -> None:
        watch = Watch(model, tmp_path / "many", baseline=HEALTHY)
        for k, log in enumerate(healthy):
            watch.update_statistics(log, f"digest {k}", f"2026-01-{k + 1:02d}")

    rng = np.random.default_rng(2)
    for _ in range(15):  # the benchmark ends a hundred
        children = []
        for _ in range(2):
            if not (child := os.fork()):
                work()
                os._exit(0)
            children.append(child)
        time.sleep(float(rng.uniform(0.01, 0.3)))
        for child in children:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
    work()
    assert rows(tmp_path / "many") == rows(tmp_path / "one")


def test_logs_of_other_dates_and_copies(model: Result, tmp_path: Path) -> None:
    watch = Watch(model, tmp_path)
    for k in (3, 1, 2):
        watch.update(day(k), date=f"2026-01-0{k}")
    assert watch.view.logs.names.tolist() == ["day 1", "day 2", "day 3"]
    assert watch.update(replace(day(2), name="copy"), "another file", "2026-01-09").copied
    assert watch.history.seen("another file")
    assert len(rows(tmp_path)) == 3


def test_histories_are_refused_where_they_do_not_suit(model: Result, healthy: list, tmp_path: Path) -> None:
    watched(model, healthy[:2], tmp_path)
    assert Watch(model, tmp_path).settings.baseline == HEALTHY  # it stands in the history
    with pytest.raises(GtauError, match="begun with baseline 10, not 12"):
        Watch(model, tmp_path, baseline=12)
    with pytest.raises(GtauError, match="baseline: 2 is out of range; write a number of at least 4"):
        Watch(model, baseline=2)
    with pytest.raises(GtauError, match="holds torques"):
        Watch(model).update(replace(day(0), kind="torque"))
    other = tmp_path / "other"
    other.mkdir()
    for content, sentence in ((b"", "is not a history"), (b"t,q1,q2\n" * 1000, "cannot be used")):
        (other / "history.db").write_bytes(content)
        with pytest.raises(GtauError, match=sentence):
            Watch(model, other)
        assert (other / "history.db").read_bytes() == content
    (other / "history.db").unlink()
    with closing(sqlite3.connect(other / "history.db")) as foreign:
        foreign.execute("CREATE TABLE other (x)")
    with pytest.raises(GtauError, match="is not a history of gtau"):
        Watch(model, other)
    for k, place in enumerate(("logs SET alarm", "events SET details", "settings SET document")):
        damaged = tmp_path / f"{k}"
        watched(model, healthy[:2], damaged).reset("2026-01-02")
        with closing(sqlite3.connect(damaged / "history.db")) as history, history:
            history.execute(f"UPDATE {place} = ?", ("[" * 100_000,))
        with pytest.raises(GtauError, match=r"history.db holds a damaged document \(nested too deep\); restore it"):
            Watch(model, damaged)


def test_years_of_blocks_are_condensed(model: Result, tmp_path: Path) -> None:
    watch = Watch(model, tmp_path)
    width = 2 * (len(watch.charts) + 2)
    history, rng = watch.history, np.random.default_rng(1)
    with history.writing():
        for k in range(6000):
            history.remember(f"block {k}", [f"{k:032x}"])
            history.add_row(f"block {k}", f"2026-01-{1 + k // 1000:02d}T00:00:00", [rng.normal(size=width)])
        history.condense()
    again = Watch(model, tmp_path)
    logs = again.view.logs
    assert len(logs.ids) == 4000 + 2
    assert logs.counts[:2].tolist() == [1000, 1000]
    assert np.abs(logs.charts[:2]).max() < 0.2  # means of a thousand
    assert again.history.seen(f"{17:032x}")


def test_the_command(folder: Path, tmp_path: Path) -> None:
    def call(*words: str):
        experiment, out = str(folder / "experiment.yaml"), str(tmp_path / "fleet" / "SN1")
        common = ["--experiment", experiment, "--out", out]
        return CliRunner().invoke(app, ["watch", str(folder / "model.json"), *words, *common])

    logs = [
        write_log(tmp_path / f"day_2026-01-{k + 1:02d}.csv", day(k, **({"payload": 1.0} if k == 6 else {})))
        for k in range(8)
    ]
    empty = tmp_path / "day_2026-01-03b.csv"
    empty.write_text("")
    for words in (("--reset", "2026-01-01"), ("--forget", "x"), ("--forget", "x", str(logs[0]))):
        assert "SN1 holds no history to act on; give the folder of a watched robot by --out." in call(*words).stderr
    none = CliRunner().invoke(app, ["watch", str(tmp_path)])
    assert "holds a history; give the folder above those given as --out." in none.stderr
    assert "the model knows no payload 'gold'" in call(str(logs[0]), "--carries", "gold").stderr
    assert not (tmp_path / "fleet").exists()
    first = call(*map(str, [*logs[5::-1], empty]), "--json", "--baseline", "4")  # in any order
    assert first.exit_code == 3, first.output
    alone = CliRunner().invoke(app, ["watch", str(tmp_path / "fleet" / "SN1"), "--json"])
    assert [line["robot"] for line in json.loads(alone.stdout)] == ["SN1"]
    lines = [json.loads(line) for line in first.stdout.splitlines()]
    assert [line["log"][-2:] for line in lines] == ["01", "02", "03", "3b", "04", "05", "06"]
    assert "empty" in lines.pop(3)["skipped"]
    assert [line["phase"] for line in lines] == ["baseline"] * 4 + ["watching"] * 2
    assert lines[3]["date"] == "2026-01-04"
    empty.write_text(logs[0].read_text().replace("\n", "\n\n", 1))  # a copy with a blank line
    assert call(str(empty)).exit_code == 0
    faulty = call(*map(str, logs[:7]))  # those that were seen are skipped
    assert faulty.exit_code == 3, faulty.output
    words = " ".join(faulty.stdout.split())
    assert "load" in words
    assert "not a safety function" in words
    fleet = CliRunner().invoke(app, ["watch", str(tmp_path / "fleet"), "--json"])
    assert fleet.exit_code == 3
    (robot,) = json.loads(fleet.stdout)
    assert (robot["robot"], robot["state"], robot["since"]) == ("SN1", "check", "2026-01-07")
    assert call().exit_code == 2
    report = (tmp_path / "fleet" / "SN1" / "report.html").read_text()
    assert "not a safety function" in report
    assert len(report) < 2e6
    assert call(str(logs[6]), "--json").stdout == ""
    found = {row["quantity"]: row for row in json.loads(call(str(logs[0]), "--power", "--json").stdout)}
    assert found["drive gain of left"]["slowly"] > found["drive gain of left"]["week"] > 0
    assert "visible in a week" in call(str(logs[0]), "--power").stdout
    forgotten = call("--forget", logs[6].stem)
    assert forgotten.exit_code == 0, forgotten.output
    assert call("--undo", logs[6].stem).exit_code == 3
    after = call(str(logs[7]), "--reset", "2026-01-08")
    assert after.exit_code == 0, after.output
    assert "1 of 4 healthy logs" in after.stdout
    rows = re.findall(r"^drive gain of left .*$", after.stdout, re.MULTILINE)
    assert [row.split()[-3:] for row in rows] == [["-", "-", "-"]]  # nothing is known yet
    later = write_log(tmp_path / "day_2026-01-09.csv", day(9))
    assert "2 of 4 healthy logs" in call(str(later), "--reset", "2026-01-08").stdout  # the same maintenance
    assert "write it as 2026-03-28" in call(str(later), "--reset", "March").stderr


def test_the_command_says_what_it_works_on(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gtau.cli.console.EVERY", 1e-3)  # s
    monkeypatch.setattr("gtau.cli.watch.EVERY", 1e-3)
    log = write_log(tmp_path / "day.csv", day(0))
    common = [str(folder / "model.json"), "--experiment", str(folder / "experiment.yaml"), "--out", str(tmp_path / "h")]
    power = CliRunner().invoke(app, ["watch", *common, str(log), "--power"])
    assert "gtau: reading day.csv, 0 s" in power.stderr
    usual = CliRunner().invoke(app, ["watch", *common, str(log)])
    for stage in ("starting", "log day.csv", "writing the report"):
        assert f"gtau: {stage}, 0 s" in usual.stderr
    missing = CliRunner().invoke(app, ["watch", *common, "--reset", "2026-01-01", "--power"])
    assert (missing.exit_code, missing.stdout) == (2, "")
    assert "--power shows what the motion of a finished log can reveal; give one." in missing.stderr


def test_the_words_name_the_joint_that_changed(model: Result, healthy: list[LogStatistics]) -> None:
    """Beside the common factor of two joints, a change of one moves both."""
    watch = watched(model, [*healthy, *days_of(model, 100, 3, friction=1.2)])
    assert set(watch.alarm.charts) >= {"friction_left", "friction_right"}
    _, points = alarm_words(watch.alarm)
    assert points[0] == "Quantities: friction_right."


def test_a_worn_drive_is_replaced(model: Result, healthy: list[LogStatistics]) -> None:
    watch = watched(model, [*healthy, *days_of(model, 100, 3, gain=0.9)])
    assert state_of(watch.alarm, watch.events, True) == "replace"


def test_a_full_disk_loses_nothing(model: Result, healthy: list[LogStatistics], tmp_path: Path) -> None:
    watch = watched(model, healthy[:2], tmp_path)
    database = watch.history._database
    (pages,) = database.execute("PRAGMA page_count").fetchone()
    database.execute(f"PRAGMA max_page_count = {pages}")  # as if the disk had no room for more
    refused = []
    for k, log in enumerate(healthy[2:], start=2):
        try:
            watch.update_statistics(log, f"digest {k}", f"2026-01-{k + 1:02d}")
        except GtauError as refusal:
            refused.append("database or disk is full" in str(refusal))
    assert refused
    assert all(refused)
    assert len(rows(tmp_path)) == len(healthy) - len(refused)
    whole = watched(model, healthy, tmp_path / "other")
    watch = watched(model, healthy, tmp_path)
    assert watch.view.logs.names.tolist() == whole.view.logs.names.tolist()
