"""Watching robots: faults put into measured logs, false alarms over simulated years, throughput, and kills.

    python benchmarks/watch.py faults ur10e orthoglide panda dvrk
    python benchmarks/watch.py years --count 50
    python benchmarks/watch.py throughput --count 200
    python benchmarks/watch.py kills --count 50

Days are made of a measured log of the reference motion: the residual that the model leaves of it is moved along the
log by a time drawn for each day, so that the noise is the measured one with its autocorrelation and differs from day to
day, and friction differs between days by ``DRIFT`` of its size, correlated from day to day. Faults are exact changes of
the current: times 1 / (1 + delta) a drive gain, plus c sign(qd) friction, plus the regressor times a payload a load,
and an encoder zero is added to the positions. The ground truth is therefore known, on measured noise.
"""

from __future__ import annotations

import argparse
import os
import resource
import signal
import time as clock
from copy import deepcopy
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import zoo
from scipy.signal import butter, sosfiltfilt
from scipy.stats import chi2
from threadpoolctl import threadpool_limits

from gtau.estimation.experiment_runs import read_runs
from gtau.estimation.identify import identify
from gtau.estimation.results.result import Result
from gtau.signals.preparation.filters import differentiate
from gtau.signals.reading.experiment import read_experiment
from gtau.signals.run import Run
from gtau.uses.runs import read_log
from gtau.watch import follow as following
from gtau.watch.detectors import Chart, add, combined, evidence
from gtau.watch.state import HISTORY
from gtau.watch.statistics import statistics_of
from gtau.watch.watch import Watch

DRIFT = 0.05  # of Coulomb friction, standard deviation between days, as that of the UR10e over its weeks
MEMORY = 0.7  # correlation of friction from day to day
HEALTHY, FAULTY = 20, 25  # days before and at most after a fault
SCENARIOS = ((0.9, 0.7, 1.0), (0.9, 0.85, 0.0), (0.7, 0.0, 0.0), (0.7, 0.7, 0.0), (0.7, 0.85, 0.0), (0.7, 0.7, 1.0))
STORE = Path(mkdtemp(prefix="watch-"))


@dataclass(frozen=True, eq=False)
class Reference:
    """A model, its reference motion, and what the model leaves of the measured torque at every sample (N, n)."""

    name: str
    model: Result
    run: Run
    residual: np.ndarray
    speed: np.ndarray
    friction: np.ndarray
    torque: np.ndarray


@dataclass(frozen=True)
class Fault:
    """A change of ``size`` at a joint (its number), reached after ``ramp`` days."""

    kind: str
    joint: int
    size: float
    ramp: int = 0


def reference(name: str, data: Path) -> Reference:
    entry = next(each for each in zoo.ENTRIES if each.name == name)
    folder = STORE / name
    folder.mkdir(exist_ok=True)
    path = folder / "experiment.yaml"
    path.write_text(entry.write(data.resolve(), folder), encoding="utf-8")
    model = identify(path)
    described = read_experiment(path)
    runs = read_runs(described, described.runs)
    run = next(each for each in runs if each.payload is None)
    run = run.ordered(model.robot.actuated, link_side=False)
    found = model.predict(run).in_band
    residual = np.where(found.valid, found.measured - found.predicted, 0.0)
    speed, _ = differentiate(run.position, run.rate)
    values = {**model.parameters, **model.friction_parameters}
    coulomb = np.array([getattr(values.get(f"fs_{j}"), "value", None) or 0.0 for j in model.robot.actuated])
    return Reference(name, model, run, residual, speed, np.abs(coulomb), found.predicted)


def day(of: Reference, rng: np.random.Generator, drift: np.ndarray, faults: list[tuple[Fault, float]]) -> Run:
    """A day's log, with ``drift`` (n,) of Coulomb friction relative to the model's and faults of these shares."""
    gains = of.model.gains
    shift = round(len(of.residual) * rng.uniform(0.1, 0.9))  # not near 0, where the residual would be its own
    torque = np.roll(of.residual, shift, axis=0) - of.residual
    sign = np.tanh(of.speed / (0.02 * np.sqrt(np.mean(of.speed**2, axis=0)) + 1e-12))
    torque = torque + of.friction * drift * sign
    current, position = np.array(of.run.command), np.array(of.run.position)
    for fault, share in faults:
        size, j = fault.size * share, fault.joint
        match fault.kind:
            case "friction":
                torque[:, j] += size * of.friction[j] * sign[:, j]
            case "load":
                torque += size * _of_mass(of)
            case "zero":
                turns = of.model.robot.joint(of.model.robot.actuated[j]).kind == "revolute"
                position[:, j] -= size * (np.pi / 180 if turns else 1e-3)
    current = current + torque / gains
    for fault, share in faults:
        if fault.kind == "gain":
            current[:, fault.joint] /= 1 + fault.size * share
    return replace(of.run, position=position, command=current)


_MASS: dict[str, np.ndarray] = {}


def _of_mass(of: Reference) -> np.ndarray:
    """Torque (N, n) of a kilogram at the origin of the body that carries payloads."""
    if of.name not in _MASS:
        idm, run = of.model.model, of.run
        cut = min(4 * of.model.preparation.bandwidth, 0.4 * run.rate)
        q = sosfiltfilt(butter(4, cut, fs=run.rate, output="sos"), run.position, axis=0)
        qd, _ = differentiate(q, run.rate)
        qdd, _ = differentiate(qd, run.rate)
        chi = {f"m_{of.model.robot.tool}": 1.0}
        centre = 0.1  # m, so that first moments change too
        chi |= {f"mx_{of.model.robot.tool}": centre / 2, f"my_{of.model.robot.tool}": -centre / 2}
        chi = {name: value for name, value in chi.items() if name in idm.parameter_names}
        _MASS[of.name] = idm.torques(q, qd, qdd, chi)
    return _MASS[of.name]


_HEALTHY: dict[tuple[str, int], tuple[Watch, np.ndarray]] = {}


def healthy_weeks(of: Reference, seed: int) -> tuple[Watch, np.ndarray]:
    """A robot watched over its healthy days, and the drift of the last one."""
    if (of.name, seed) not in _HEALTHY:
        watch = Watch(of.model, baseline=10)
        drift = DRIFT * np.random.default_rng([5, seed]).normal(size=len(of.friction))
        for k in range(HEALTHY):
            drift = _another(watch, of, seed, k, drift, [])
        _HEALTHY[of.name, seed] = watch, drift
    watch, drift = _HEALTHY[of.name, seed]
    return deepcopy(watch, {id(of.model): of.model}), drift


def _another(watch: Watch, of: Reference, seed: int, k: int, drift: np.ndarray, faults: list) -> np.ndarray:
    rng = np.random.default_rng([7, seed, k])
    drift = MEMORY * drift + DRIFT * np.sqrt(1 - MEMORY**2) * rng.normal(size=len(drift))
    log = statistics_of(of.model, replace(day(of, rng, drift, faults), name=f"day {k + 1}"))
    watch.update_statistics(log, f"{k}", "2026-01-01")
    return drift


def weeks(of: Reference, fault: Fault | None, seed: int) -> dict:
    """Watch days of a robot until it alarms: days to the alarm, and what is named on the day after it."""
    watch, drift = healthy_weeks(of, seed)
    first = None
    for k in range(HEALTHY, HEALTHY + FAULTY):
        share = 0.0 if fault is None else 1.0 if not fault.ramp else min((k - HEALTHY + 1) / fault.ramp, 1.0)
        drift = _another(watch, of, seed, k, drift, [] if fault is None else [(fault, share)])
        if first is not None:
            break
        if watch.alarm is not None:
            first = k - HEALTHY + 1
    return {"day": first, "alarm": watch.alarm}


# Faults


def faults_of(of: Reference, joint: int | None) -> list[Fault]:
    """Faults of a joint, the middle one if left out: by a step, of gains also slowly over 20 days."""
    j = len(of.friction) // 2 if joint is None else joint
    payload = {"ur10e": 2.805, "orthoglide": 1.983, "panda": 2.0, "dvrk": 0.205}[of.name]
    steps = [Fault("gain", j, size) for size in (-0.02, -0.05, -0.10)]
    slow = [Fault("gain", j, size, 20) for size in (-0.02, -0.05, -0.10)]
    rubbing = [Fault("friction", j, size) for size in (0.2, 0.5)]
    loads = [Fault("load", 0, share * payload) for share in (0.05, 0.2)]
    return [*steps, *slow, *rubbing, *loads, Fault("zero", j, 0.5)]


def faults(names: list[str], seeds: int, data: Path, at: int | None) -> None:
    print("| robot | fault | found | days to the alarm, median (range) | named | size, mean of those named |")
    print("| --- | --- | --- | --- | --- | --- |")
    for name in names:
        of = reference(name, data)
        for fault in [None, *faults_of(of, at)]:
            found = [weeks(of, fault, seed) for seed in range(seeds)]
            days = [each["day"] for each in found if each["day"] is not None]
            said = [each["alarm"].explanations for each in found if each["alarm"] is not None]
            joint = of.model.robot.actuated[fault.joint] if fault is not None and fault.kind != "load" else ""
            right = [e[0] for e in said if fault is not None and e and (e[0].kind, e[0].joint) == (fault.kind, joint)]
            among = sum(
                any((each.kind, each.joint) == (fault.kind, joint) for each in e) for e in said if fault is not None
            )
            what = "none" if fault is None else f"{fault.kind} {fault.size:+.3g}{' slow' if fault.ramp else ''}"
            when = "-" if not days else f"{np.median(days):.0f} ({min(days)} to {max(days)})"
            share = [each.size if fault.kind != "friction" else each.relative or np.nan for each in right]
            size = f"{np.nanmean(share):+.3g}" if share else "-"
            print(
                f"| {name} | {what} | {len(days)} of {seeds} | {when} | {len(right)} first, {among} listed | {size} |",
                flush=True,
            )


# False alarms


def years(robots: int, count: int, charts: int, healthy: float, memory: float, season: float, logs: int = 365) -> None:
    """Simulate charts of healthy robots at the level of statistics.

    Charts of a robot share a third of their variance (a model error moves all); each follows an autoregression with
    ``memory`` from day to day, and ``season`` standard deviations of a yearly cycle.
    """
    alarms, days = 0, 0
    limit = np.log(logs)  # one a robot and year
    for robot in range(robots):
        rng = np.random.default_rng([13, robot])
        mix = np.sqrt(1 / 3), np.sqrt(2 / 3)

        def draw(rng=rng, mix=mix) -> np.ndarray:
            return mix[0] * rng.normal() + mix[1] * rng.normal(size=charts)

        state, phase = draw(), rng.uniform(0, 2 * np.pi)
        of = [Chart(10, memory=healthy)] * charts
        since = 0
        for day in range(count * logs):
            x = state + season * np.sin(2 * np.pi * day / 365 + phase)
            state = memory * state + np.sqrt(1 - memory**2) * draw()
            of = [add(chart, float(value)) for chart, value in zip(of, x, strict=True)]
            since += 1
            if since <= 10:
                continue
            days += 1
            if combined(np.array([evidence(chart).log_e for chart in of])) >= limit:
                alarms, of, since = alarms + 1, [Chart(10, memory=healthy)] * charts, 0  # as after a reset
    watched = days / logs
    low, high = chi2.ppf(0.025, 2 * alarms) / 2 if alarms else 0.0, chi2.ppf(0.975, 2 * alarms + 2) / 2
    print(
        f"| {charts} | {healthy:g} | {memory:g} | {season:g} | {watched:.0f} | {watched:.0f} | {alarms} | "
        f"{alarms / watched:.2f} ({low / watched:.2f} to {high / watched:.2f}) |",
        flush=True,
    )


# Throughput, and kills


def throughput(data: Path, blocks: int) -> None:
    """Follow a log of 500 Hz in one process: seconds of work a block of 30 s, and memory over the blocks."""
    of = reference("ur10e", data)
    run = of.run
    rate = 500.0
    time = np.arange(round(30.0 * rate)) / rate
    columns = [np.interp(time, run.time - run.time[0], run.position[:, j]) for j in range(6)]
    columns += [np.interp(time, run.time - run.time[0], run.command[:, j]) for j in range(6)]
    names = ["t", *(f"q{j}" for j in run.joints), *(f"v{j}" for j in run.joints)]
    log = STORE / "grows.csv"
    rng = np.random.default_rng(3)
    watch, memory, spent = Watch(of.model, STORE / "throughput"), [], []
    written = 0

    def more() -> bool:
        nonlocal written
        if written >= blocks:
            return True
        noise = np.hstack([1e-5 * rng.normal(size=(len(time), 6)), 0.05 * rng.normal(size=(len(time), 6))])
        table = np.column_stack([time + 30.0 * written, np.stack(columns, axis=1) + noise])
        with log.open("a") as file:
            if not written:
                file.write(",".join(names) + "\n")
            np.savetxt(file, table, delimiter=",", fmt="%.6f")
        written += 1
        return False

    more()
    before = clock.perf_counter()
    for _ in following.follow(watch, log, lambda path: read_log(of.model, path), 30.0, more):
        now = os.times()
        spent.append(now.user + now.system)
        memory.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    each = np.diff(spent)
    print(
        f"{len(spent)} blocks of 30 s at 500 Hz ({len(spent) * len(time):.3g} samples), "
        f"{clock.perf_counter() - before:.0f} s"
    )
    print(f"CPU a block (the writing of the log included): median {np.median(each):.3f} s, largest {each.max():.3f} s")
    print(f"robots that two cores follow in real time: {2 * 30 / np.median(each):.0f}")
    print(
        f"peak memory after 5, half, all blocks: {memory[4]:.0f}, {memory[len(memory) // 2]:.0f}, {memory[-1]:.0f} MiB"
    )


def kills(times: int, data: Path) -> None:
    """End a process that watches at random moments; compare its history with one that was not ended."""
    of, rng = reference("ur10e", data), np.random.default_rng(5)
    logs = []
    for k in range(40):
        made = day(of, rng, DRIFT * rng.normal(size=6), [(Fault("gain", 1, -0.05), 1.0)] if k >= 30 else [])
        logs.append(statistics_of(of.model, replace(made, name=f"day {k + 1}")))

    def work(out: Path) -> int:
        """Take the logs that are not yet in the history, as the command does; return its exit code."""
        watch = Watch(of.model, out)
        for k, log in enumerate(logs):
            if f"{k}" not in watch.seen:
                watch.update_statistics(log, f"{k}", "2026-01-01")
        return 0 if watch.alarm is None else 3

    begun = clock.perf_counter()
    code, length = work(STORE / "whole"), clock.perf_counter() - begun
    history, ended = STORE / "killed" / HISTORY, 0
    while ended < times:  # a child of this process, which knows the statistics already
        child = os.fork()
        if not child:
            work(STORE / "killed")
            os._exit(0)
        clock.sleep(float(rng.uniform(0, 3 * length / times)))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        ended += 1
    done = history.read_bytes().count(b"\n") - 1
    last = work(STORE / "killed")
    same = history.read_bytes() == (STORE / "whole" / HISTORY).read_bytes()
    print(
        f"{ended} kills, after which {done} of {len(logs)} logs are in the history; finished, the histories are "
        f"{'equal' if same else 'NOT equal'}; exit codes {code}, {last}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("what", choices=("faults", "years", "throughput", "kills"))
    parser.add_argument("robots", nargs="*", default=["ur10e", "orthoglide", "panda", "dvrk"])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--count", type=int, default=50, help="robots, blocks or kills")
    parser.add_argument("--joint", type=int, help="number of the joint that fails, from 0")
    parser.add_argument("--years", type=int, default=1)
    parser.add_argument("--charts", type=int, default=40)
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    given = parser.parse_args()
    match given.what:
        case "faults":
            faults(given.robots, given.seeds, given.data, given.joint)
        case "years":
            print("| charts | counts as healthy | memory | season | robot years | at most | alarms | a year (95 %) |")
            print("| --- | --- | --- | --- | --- | --- | --- | --- |")
            for healthy, memory, season in SCENARIOS:
                years(given.count, given.years, given.charts, healthy, memory, season)
        case "throughput":
            throughput(given.data, given.count)
        case "kills":
            kills(given.count, given.data)


if __name__ == "__main__":
    with threadpool_limits(1):
        main()
