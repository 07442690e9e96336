"""Watching robots: faults on every joint, false alarms over simulated years, kills, and long histories.

    python benchmarks/watch.py faults ur10e --seeds 2
    python benchmarks/watch.py signals ur10e xmate7p
    python benchmarks/watch.py years --robots 100
    python benchmarks/watch.py kills --count 100
    python benchmarks/watch.py size

Days are simulated at the level of a log's estimates. Those of a measured log, without a fault and with each, are
computed by the whole program; the fault is an exact change of its currents and positions. The difference is what the
fault adds to the estimates of a day. The scatter from day to day has the covariance of the block jackknife of that log,
and beside it ``DRIFT`` of friction and gains, correlated by ``MEMORY``.
"""

from __future__ import annotations

import argparse
import os
import signal
import time as clock
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import date, timedelta
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import zoo
from scipy.signal import butter, sosfiltfilt
from scipy.stats import chi2
from threadpoolctl import threadpool_limits

from gtau.estimation.experiment_runs import read_runs
from gtau.result import Result, identify
from gtau.signals.preparation.filters import differentiate
from gtau.signals.reading.experiment import read_experiment
from gtau.signals.run import Run
from gtau.watch.alarms import visible_changes
from gtau.watch.causes import signal_faults
from gtau.watch.detectors import evidence
from gtau.watch.statistics import LogStatistics, statistics_of
from gtau.watch.watch import Watch

DRIFT = {"friction": 0.05, "gain": 0.003}  # relative standard deviations between days
MEMORY = 0.8  # their correlation from day to day
HEALTHY, FAULTY = 30, 45  # days before and at most after a fault
LOGS, FIRST = 385, 20  # of a simulated robot, of which the first are not judged
BATCH = 10  # robots computed at once, so that the arrays fit the cache
QUANTITIES = 10  # of a simulated robot, of which the last six are friction
STORE = Path(mkdtemp(prefix="watch-"))


@dataclass(frozen=True)
class Fault:
    """A change of ``size`` at a joint (its number), reached after ``ramp`` days."""

    kind: str
    joint: int
    size: float
    ramp: int = 0


def reference(name: str, data: Path) -> tuple[Result, Run]:
    """Identify a robot, and take its first unloaded log."""
    entry = next(entry for entry in zoo.ENTRIES if entry.name == name)
    path = STORE / name / "experiment.yaml"
    path.parent.mkdir(exist_ok=True)
    path.write_text(entry.write(data.resolve(), path.parent), encoding="utf-8")
    model = identify(path)
    described = read_experiment(path)
    run = next(run for run in read_runs(described, described.runs) if run.payload is None)
    return model, run.ordered(model.robot.actuated, link_side=False)


def with_fault(model: Result, run: Run, fault: Fault) -> Run:
    """Put a fault into a log."""
    j, current, position = fault.joint, np.array(run.command), np.array(run.position)
    known = {**model.parameters, **model.friction_parameters}
    qd, _ = differentiate(run.position, run.rate)
    joint = model.robot.actuated[j]
    match fault.kind:
        case "gain":
            current[:, j] /= 1 + fault.size
        case "friction":
            speed = 0.02 * np.sqrt(np.mean(qd[:, j] ** 2)) + 1e-12
            coulomb, viscous = (getattr(known.get(f"{kind}_{joint}"), "value", None) or 0.0 for kind in ("fs", "fv"))
            added = coulomb * np.tanh(qd[:, j] / speed) + viscous * qd[:, j]
            current[:, j] += fault.size * added / model.gains[j]
        case "load":
            current += fault.size * of_mass(model, run) / model.gains
        case "zero":
            position[:, j] -= fault.size * np.pi / 180
        case "lag":
            current = np.stack([np.interp(run.time - fault.size, run.time, column) for column in current.T], axis=1)
        case "clock":
            run = replace(run, time=(1 + fault.size) * run.time)
        case "rub" | "ripple" | "contact":  # of a size in residuals of the model
            place = (run.position[:, j] - run.position[:, j].min()) / np.ptp(run.position[:, j])
            shape = {
                "rub": np.sign(qd[:, j]) * (np.abs(place - 0.6) < 0.15),
                "ripple": np.sin(40 * place),
                "contact": np.abs(run.time - run.time.mean()) < 0.3,
            }[fault.kind]
            (rms,) = (error.rms for error in model.residuals if error.joint == joint)
            current[:, j] += fault.size * rms / model.gains[j] * shape
    return replace(run, position=position, command=current)


def of_mass(model: Result, run: Run) -> np.ndarray:
    """Torque (N, n) of a kilogram 5 cm from the origin of the body that carries payloads."""
    idm = model.idm
    low = butter(4, min(4 * model.preparation.bandwidth, 0.4 * run.rate), fs=run.rate, output="sos")
    q = sosfiltfilt(low, run.position, axis=0)
    qd, _ = differentiate(q, run.rate)
    qdd, _ = differentiate(qd, run.rate)
    chi = {f"m_{model.robot.tool}": 1.0, f"mz_{model.robot.tool}": 0.05}
    return idm.torques(q, qd, qdd, {name: value for name, value in chi.items() if name in idm.parameter_names})


def days(model: Result, healthy: LogStatistics, faulty: LogStatistics, ramp: int, seed: int) -> Iterator[LogStatistics]:
    """Draw the estimates of days, the fault from day HEALTHY on."""
    rng = np.random.default_rng([7, seed])
    known = {**model.parameters, **model.friction_parameters}
    shown = np.flatnonzero(healthy.shown & faulty.shown)
    covariance = healthy.covariance[np.ix_(shown, shown)]
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    scale = np.zeros(len(healthy.charts))
    for k, chart in enumerate(healthy.charts):
        if chart.kind in ("fs", "fv"):
            scale[k] = DRIFT["friction"] * abs(getattr(known.get(chart.name), "value", None) or 0.0)
        elif chart.kind == "gain":
            scale[k] = DRIFT["gain"]
    drift = rng.normal(size=len(scale))
    for k in range(HEALTHY + FAULTY):
        share = 0.0 if k < HEALTHY else 1.0 if not ramp else min((k - HEALTHY + 1) / ramp, 1.0)
        drift = MEMORY * drift + np.sqrt(1 - MEMORY**2) * rng.normal(size=len(scale))
        x = healthy.values + scale * drift + share * (faulty.values - healthy.values)
        x[shown] += root @ rng.normal(size=len(shown))
        yield replace(faulty if k >= HEALTHY else healthy, name=f"day {k + 1}", values=x)


def faults_of(model: Result, joint: int) -> list[Fault]:
    """Faults of a joint."""
    steps = [Fault("gain", joint, size) for size in (-0.02, -0.05, -0.10)]
    rubbing = [Fault("friction", joint, 0.3), Fault("friction", joint, 0.3, 30), Fault("friction", joint, 0.6, 30)]
    return [*steps, *rubbing, Fault("zero", joint, 0.5), Fault("zero", joint, 1.0)]


def faults(names: list[str], seeds: int, data: Path) -> None:
    """Print the days to the alarm and the cause of each fault on each joint."""
    print("| robot | joint | fault | visible in a week | found | days to the alarm | cause named |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for name in names:
        model, run = reference(name, data)
        healthy = statistics_of(model, run)
        sizes = {"load": (0.2, 0.5, 1.0), "lag": (0.005, 0.02), "clock": (0.01, 0.05)}
        common = [Fault(kind, -1, size) for kind, listed in sizes.items() for size in listed]
        for fault in [*common, *(f for j in range(len(model.robot.actuated)) for f in faults_of(model, j))]:
            row = fault_row(model, healthy, statistics_of(model, with_fault(model, run, fault)), fault, seeds)
            print(f"| {name} | {row} |", flush=True)


def fault_row(model: Result, healthy: LogStatistics, faulty: LogStatistics, fault: Fault, seeds: int) -> str:
    """Watch a robot over a fault, and write its row."""
    joint = "" if fault.joint < 0 else model.robot.actuated[fault.joint]
    first, named, visible = [], 0, "-"
    for seed in range(seeds):
        watch = Watch(model)
        for k, log in enumerate(days(model, healthy, faulty, fault.ramp, seed)):
            if k == HEALTHY and not seed:
                visible = visible_words(watch, fault, joint)
            watch.update_statistics(log, f"{k}", (date(2026, 1, 1) + timedelta(k)).isoformat())
            alarm = None if watch.alarm is None or watch.alarm.kind == "log" else watch.alarm
            if k < HEALTHY and alarm is not None:
                print(f"a false alarm on day {k + 1}: {alarm}")
                break
            if k >= HEALTHY + 1 and alarm is not None:
                first.append(k - HEALTHY + 1)
                kind = {"lag": "clock", "clock": "rate"}.get(fault.kind, fault.kind)
                named += any((cause.kind, cause.joint) == (kind, joint) for cause in alarm.explanations)
                break
    words = f"{fault.kind} {fault.size:+g}{f', over {fault.ramp} days' if fault.ramp else ''}"
    when = "-" if not first else f"{np.median(first):.0f}"
    return f"{joint or '-'} | {words} | {visible} | {len(first)} of {seeds} | {when} | {named} of {len(first)}"


def signals(names: list[str], data: Path) -> None:
    """Print which rubs, ripples and contacts of each joint are named as rubs or ripples."""
    print("| robot | fault, residuals | named | another name |")
    print("| --- | --- | ---: | ---: |")
    for name in names:
        model, run = reference(name, data)
        healthy = statistics_of(model, run)
        before = np.nan_to_num(healthy.values), healthy.speed, healthy.uneven
        joints = model.robot.actuated
        for kind, sizes in {"rub": (3, 4, 6, 8), "ripple": (3, 4, 6, 8), "contact": (4, 8, 16, 40)}.items():
            for size in sizes:
                logs = [statistics_of(model, with_fault(model, run, Fault(kind, j, size))) for j in range(len(joints))]
                causes = [signal_faults(model, log, *before) for log in logs]
                said = [[(cause.kind, cause.joint) for cause in named] for named in causes]
                right = sum(named == [(kind, joint)] for named, joint in zip(said, joints, strict=True))
                print(
                    f"| {name} | {kind} {size} | {right} of {len(joints)} | {sum(map(bool, said)) - right} |",
                    flush=True,
                )


def visible_words(watch: Watch, fault: Fault, joint: str) -> str:
    """Write the smallest visible change of the quantity of a fault."""
    kind = {"load": "m_load", "lag": "delay_"}.get(fault.kind, f"{fault.kind}_{joint}")
    changes = visible_changes(watch.view)[:, 0]
    of_kind = [changes[k] for k, name in enumerate(watch.view.names) if name.startswith(kind)]
    smallest = np.nanmin(of_kind) if len(of_kind) and np.isfinite(of_kind).any() else np.nan
    return "no" if np.isnan(smallest) else f"{smallest:.2g}"


# False alarms


def autoregression(rng: np.random.Generator, logs: int, memory: float) -> np.ndarray:
    """Draw QUANTITIES series of a correlation."""
    x = rng.normal(size=(logs, QUANTITIES))
    for t in range(1, logs):
        x[t] = memory * x[t - 1] + np.sqrt(1 - memory**2) * x[t]
    return x


def weather(kind: str, rng: np.random.Generator, logs: int) -> tuple[np.ndarray, np.ndarray]:
    """Draw values and variances (logs, QUANTITIES) of a healthy robot; the last six quantities are friction."""
    variances, x = np.ones((logs, QUANTITIES)), rng.normal(size=(logs, QUANTITIES))
    friction = np.arange(QUANTITIES) >= QUANTITIES - 6
    match kind.split():
        case ["correlated", memory]:
            x = autoregression(rng, logs, float(memory))
        case ["season"]:
            year = np.sin(2 * np.pi * np.arange(logs) / 365 + rng.uniform(0, 2 * np.pi))
            x = autoregression(rng, logs, 0.7) + np.where(friction, 3.0, 0.5) * year[:, None]
        case ["tails"]:
            x = rng.standard_t(3, size=x.shape)
        case ["outliers"]:
            bad = rng.random((logs, 1)) < 0.02
            x = x + 10 * bad * rng.choice([-1, 1], size=x.shape)
        case ["motions"]:
            wide = rng.random((logs, 1)) < 0.3
            variances = np.where(wide, rng.uniform(4, 30, size=(logs, 1)), 1.0) * variances
            x = np.sqrt(variances) * x
        case ["warming"]:
            x = x + np.where(friction, 5.0, 0.0) * autoregression(rng, logs, 0.9)[:, :1]
        case ["mornings"]:
            cold = (np.arange(logs) % 7 == rng.integers(7)) & (rng.random(logs) < 0.7)
            x = x + np.where(friction, 6.0, 0.3) * cold[:, None]
    return x - np.where(friction, np.median(x[:, friction], axis=1, keepdims=True), 0.0), variances


WEATHERS = ("white", "correlated 0.7", "correlated 0.85", "correlated 0.95", "season", "tails", "outliers", "motions")


def years(robots: int, stride: int) -> None:
    """Count the false alarms of healthy robots with a log a day, one a robot and year being stated."""
    print("| scatter from day to day | robot-years | false alarms | a year (95 % interval) |")
    print("| --- | --- | --- | --- |")
    for kind in (*WEATHERS, "warming", "mornings"):
        drawn = [weather(kind, np.random.default_rng([13, robot]), LOGS) for robot in range(robots)]
        batches = [drawn[k : k + BATCH] for k in range(0, robots, BATCH)]
        alarms, time = sum(false_alarms(batch, stride) for batch in batches), robots * (LOGS - FIRST) / 365
        low, high = chi2.ppf(0.025, 2 * alarms) / 2 if alarms else 0.0, chi2.ppf(0.975, 2 * alarms + 2) / 2
        rate = f"{alarms / time:.2f} ({low / time:.2f} to {high / time:.2f})"
        print(f"| {kind} | {time:.0f} | {alarms} | {rate} |", flush=True)


def false_alarms(robots: list[tuple[np.ndarray, np.ndarray]], stride: int) -> int:
    """Count the alarms of robots, each of which begins anew after one as after a reset."""
    x, variances = (np.concatenate(part, axis=1) for part in zip(*robots, strict=True))
    alarms = 0
    for t in range(FIRST, LOGS, stride):
        proof = evidence(x[: t + 1], variances[: t + 1], 10)
        raised = ((proof.log_e >= np.log(365 * QUANTITIES)) & proof.confirmed).reshape(-1, QUANTITIES).any(axis=1)
        alarms += int(raised.sum())
        x[: t + 1, np.repeat(raised, QUANTITIES)] = np.nan
    return alarms


# The history


def kills(count: int, data: Path) -> None:
    """End two programs that write one history at random moments; compare it with that of one that was not ended."""
    model, run = reference("ur10e", data)
    healthy = statistics_of(model, run)
    faulty = statistics_of(model, with_fault(model, run, Fault("gain", 1, -0.05)))
    logs, rng = list(days(model, healthy, faulty, 0, 1))[:50], np.random.default_rng(5)

    def work(out: Path) -> Watch:
        watch = Watch(model, out)
        for k, log in enumerate(logs):
            watch.update_statistics(log, f"{k}", (date(2026, 1, 1) + timedelta(k)).isoformat())
        return watch

    def rows(watch: Watch) -> list:
        return watch.history._database.execute("SELECT log, date, numbers, alarm FROM logs ORDER BY id").fetchall()

    begun = clock.perf_counter()
    expected, length = rows(work(STORE / "one")), clock.perf_counter() - begun
    for _ in range(count // 2):
        children = []
        for _ in range(2):
            if not (child := os.fork()):
                work(STORE / "many")
                os._exit(0)
            children.append(child)
        clock.sleep(float(rng.uniform(0, 20 * length / count)))
        for child in children:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
    before = len(Watch(model, STORE / "many").view.logs.ids)
    same = rows(work(STORE / "many")) == expected
    print(f"{count} kills of two writers; {before} of {len(logs)} logs were there; equal in the end: {same}")


def size(data: Path) -> None:
    """Time the opening of long histories, and measure their files."""
    model, _ = reference("ur10e", data)
    for count in (20_000, 200_000):
        folder = STORE / f"{count}"
        watch, rng = Watch(model, folder), np.random.default_rng(1)
        width = 2 * (len(watch.charts) + len(model.robot.actuated))
        with watch.history.writing():
            for k in range(count):
                day = date(2026, 1, 1) + timedelta(int(365 * k / count))
                watch.history.remember(f"{k}", [f"{k:032x}", f"{count + k:032x}"])
                watch.history.add_row(f"{k}", f"{day}", [rng.normal(size=width)])
                if k % 2000 == 1999:
                    watch.history.condense()
        watch.history._database.close()
        begun = clock.perf_counter()
        again = Watch(model, folder)
        spent, bytes_ = clock.perf_counter() - begun, sum(path.stat().st_size for path in folder.iterdir())
        rows = len(again.view.logs.ids)
        print(f"{count} logs: opened in {spent:.2f} s, {bytes_ / 1e6:.0f} MB, {rows} rows", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("what", choices=("faults", "signals", "years", "kills", "size"))
    parser.add_argument("names", nargs="*", default=["ur10e"])
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--robots", type=int, default=100)
    parser.add_argument("--stride", type=int, default=1, help="days between two looks at a simulated robot")
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    given = parser.parse_args()
    match given.what:
        case "faults":
            faults(given.names, given.seeds, given.data)
        case "signals":
            signals(given.names, given.data)
        case "years":
            years(given.robots, given.stride)
        case "kills":
            kills(given.count, given.data)
        case "size":
            size(given.data)


if __name__ == "__main__":
    with threadpool_limits(1):
        main()
