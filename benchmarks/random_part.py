"""Monte Carlo coverage of the 95 % intervals of gains and main parameters.

    python benchmarks/random_part.py orthoglide ur10e --repetitions 300
    python benchmarks/random_part.py five-bar orthoglide ur10e --repeat --errors white waves load --repetitions 100

Four runs of a robot of the catalog (or of a robot file), two of them with a known payload, are made again and again
with new errors, and identified with the default estimator. The motions stay the same: errors of the currents change
no regressor, so its rows are computed once and factorised; errors of positions and clocks take the whole way each time.
With ``--repeat`` runs with the payload repeat the motions of those without, and a second line has the intervals of a
jackknife that leaves out blocks of one run at a time.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from multiprocessing import Pool
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from gtau.estimation.diagnostics.verdict import delay_verdicts
from gtau.estimation.estimators.estimator import Solution
from gtau.estimation.estimators.maximum_likelihood import ml
from gtau.estimation.estimators.newton import degrees_of_freedom
from gtau.estimation.regression.dataset import Dataset, System, reduce_runs
from gtau.estimation.regression.factors import EXTRA, SIGNALS, Factors, triangle
from gtau.estimation.regression.rows import stream_rows
from gtau.estimation.regression.run_blocks import BLOCKS, block_of
from gtau.findings import Grade
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.geometry import characteristic_length
from gtau.robots.robot import Robot
from gtau.signals.preparation.filters import differentiate
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run
from gtau.simulation.trajectories import envelope, point_to_point, sines

sys.path.append(str(Path(__file__).parents[1] / "tests" / "support"))
from plausible_parameters import random_bodies

RATE, SECONDS = 400.0, 10.0
SEED = 1
LOADED = (False, False, True, True)
NOISE = 0.01  # of a joint's rms current, unless said otherwise
QUIET = 0.003
MAIN = 10.0  # a main parameter is so many standard deviations from zero
MODELS = ("white", "coloured", "drift", "ripple", "waves", "load", "rounding", "jitter")
WAVES = 0.03  # of a joint's rms current: long ripple
LOAD = 0.05  # of what the links take: largest friction that depends on the load


def links(robot: Robot, rng: np.random.Generator) -> dict[str, float]:
    """Standard parameters of a plausible robot, with light drives: the friction shows."""
    length, chi = characteristic_length(robot), random_bodies(robot, rng)
    for name in robot.actuated:
        weight = 5.0 if robot.joint(name).kind == "prismatic" else 3.0 * length**2
        force = 30.0 * (1.0 if robot.joint(name).kind == "prismatic" else length)
        chi |= {f"ia_{name}": weight, f"fv_{name}": 0.5 * force, f"fs_{name}": 0.3 * force, f"off_{name}": 0.02 * force}
    return chi


@dataclass(frozen=True, eq=False)
class Case:
    """A robot, the true motions and torques of its runs, and what they reduce to."""

    model: InverseDynamics
    time: np.ndarray
    paths: tuple[np.ndarray, ...]  # (N, n)
    torques: tuple[np.ndarray, ...]
    friction: tuple[np.ndarray, ...]  # the motors' share of them
    gains: np.ndarray
    payload: Payload
    truth: dict[str, float]


def make_case(source: str, repeated: bool = False) -> Case:
    robot = load_robot(source)
    model, rng = InverseDynamics(robot), np.random.default_rng(SEED)
    if source == "orthoglide":
        from gtau.demo import SIMULATION

        chi = SIMULATION.parameters
    else:
        chi = {k: v for k, v in links(robot, rng).items() if k in model.parameter_names}
    time = np.arange(round(SECONDS * RATE) + 1) / RATE
    within = envelope(robot, 0.7)
    motors = {f"{kind}_{joint}" for kind in ("fv", "fs") for joint in robot.actuated}
    payload = Payload(name="known", mass=2.0)
    paths, positions, torques, friction = [], [], [], []
    for k, loaded in enumerate(LOADED):
        if k < 2 or not repeated:
            paths.append((sines, point_to_point)[k % 2](within, SECONDS, rng)(time))
        motion = paths[-1] if not repeated else paths[k % 2]
        carried = {**chi, f"m_{robot.tool}": chi.get(f"m_{robot.tool}", 0.0) + 2.0 * loaded}
        positions.append(motion[0])
        torques.append(model.torques(*motion, carried))
        friction.append(model.torques(*motion, {name: chi[name] for name in motors}))
    gains = np.sqrt(np.mean(np.concatenate(torques) ** 2, axis=0))  # about 1 A rms
    return Case(model, time, tuple(positions), tuple(torques), tuple(friction), gains, payload, chi)


def spoilt(case: Case, errors: str, rng: np.random.Generator) -> Iterator[Run]:
    """The runs as they are logged with one kind of errors."""
    n, count = len(case.gains), len(LOADED)
    drift = 0.02 * rng.standard_normal((count, n))
    drift -= drift.mean(axis=0)  # the parameters stand for the mean of the runs
    low, high = (end([end(q, axis=0) for q in case.paths], axis=0) for end in (np.min, np.max))
    # the same in all runs
    periods, phase = rng.uniform(0.5, 3.0, n) if errors == "waves" else np.full(n, 40.0), rng.uniform(size=n)
    rub = rng.uniform(0.0, LOAD, n)
    for k in range(count):
        time, q = case.time, case.paths[k]
        current = case.torques[k] / case.gains
        if errors == "white":
            current = current + NOISE * rng.standard_normal(q.shape)
        else:
            current = current + QUIET * rng.standard_normal(q.shape)
        if errors == "coloured":
            current = current + NOISE * _coloured(rng, *q.shape)
        elif errors == "drift":
            current = current + drift[k] * case.friction[k] / case.gains
        elif errors in ("ripple", "waves"):
            wave = np.sin(2 * np.pi * (periods * (q - low) / (high - low) + phase))
            current = current + (WAVES if errors == "waves" else NOISE) * wave
        elif errors == "load":
            links = np.abs(case.torques[k] - case.friction[k])
            current = current + rub * links * np.sign(np.gradient(q, time, axis=0)) / case.gains
        elif errors == "rounding":
            quantum = np.ptp(q, axis=0) / 2**16
            q = quantum * np.round(q / quantum + rng.uniform(size=n))
        elif errors == "jitter":
            late = time + 1e-4 * rng.standard_normal(len(time))
            q = np.column_stack([np.interp(late, time, each) for each in q.T])
            current = np.column_stack([np.interp(late, time, each) for each in current.T])
        payload = case.payload if LOADED[k] else None
        yield Run(f"run {k + 1}", case.model.actuated, time, q, current, payload=payload)


def _coloured(rng: np.random.Generator, samples: int, n: int) -> np.ndarray:
    """Noise of unit variance whose correlation decays in 0.1 s."""
    from scipy.signal import lfilter

    decay = np.exp(-1 / (0.1 * RATE))
    start = rng.standard_normal((1, n))
    noise = np.sqrt(1 - decay**2) * rng.standard_normal((samples, n))
    return lfilter([1.0], [1.0, -decay], noise, axis=0, zi=decay * start)[0]


@dataclass(frozen=True, eq=False)
class Fixed:
    """Factorised regressor rows of a run: for each block and joint the rows meant, Q (k, m) and R (m, columns)."""

    rows: list[list[tuple[np.ndarray, np.ndarray, np.ndarray]]]
    samples: slice
    rate: float


def fix(data: Dataset, k: int) -> Fixed:
    """The regressor of run k, which errors of the currents leave as it is."""
    prepared, decimator = data.prepared[k], data.preparation.decimator
    regressor = data.model.columns(data.base.standard)
    parts = list(stream_rows(data.model, regressor, prepared, decimator))
    entries, keep = np.hstack([p.entries for p in parts]), np.hstack([p.keep for p in parts])
    block = block_of(data.prepared.edges[k], entries.shape[1])
    rows = []
    for s in range(BLOCKS):
        of_joints = []
        for j in range(len(data.model.actuated)):
            mine = np.flatnonzero(regressor.rows == j)
            at = np.flatnonzero((block == s) & keep[j])
            W = np.zeros((len(at), data.base.count))
            W[:, regressor.columns[mine]] = entries[mine][:, at].T
            of_joints.append((at, *np.linalg.qr(W)))
        rows.append(of_joints)
    begin = int(np.argmin(np.abs(prepared.run.time - prepared.time[0])))
    return Fixed(rows, slice(begin, begin + len(prepared.time)), prepared.run.rate)


def refactor(data: Dataset, fixed: Fixed, run: Run) -> Factors:
    """Factors of a run from its fixed regressor and new currents."""
    decimator, n = data.preparation.decimator, len(run.joints)
    d, dd = differentiate(run.command, fixed.rate)
    signals = np.stack([x[fixed.samples].T for x in (run.command, d, dd)])
    V = decimator.apply(signals)  # (3, n, K)
    p = data.base.count + EXTRA
    R, rows = np.zeros((BLOCKS, n, p, p)), np.zeros((BLOCKS, n), dtype=int)
    for s, of_joints in enumerate(fixed.rows):
        for j, (at, Q, upper) in enumerate(of_joints):
            if not len(at):
                continue
            v = V[:, j, at].T
            along = Q.T @ v
            rest = triangle(v - Q @ along)
            m = len(upper)
            R[s, j, :m, : data.base.count], R[s, j, :m, SIGNALS] = upper, along
            R[s, j, m : m + len(rest), SIGNALS] = rest[: p - m]
            rows[s, j] = len(at)
    return Factors(R, rows)


@dataclass(frozen=True, eq=False)
class Repetition:
    """Errors, random standard deviations and their degrees of freedom.

    ``told`` says which delays have a standard deviation, (n,); ``apart`` are the standard deviations of a jackknife
    that leaves out blocks of one run at a time, and ``apart_freedom`` their degrees of freedom.
    """

    names: tuple[str, ...]
    error: np.ndarray
    std: np.ndarray
    freedom: np.ndarray
    told: np.ndarray
    apart: np.ndarray
    apart_freedom: np.ndarray


def repeat(case: Case, errors: str, seeds: Sequence[int]) -> list[Repetition]:
    """Identify the case once for each seed."""
    with threadpool_limits(1):
        exact = list(spoilt(case, "none", np.random.default_rng(0)))
        data = reduce_runs(case.model.robot, exact)
        slow = errors in ("rounding", "jitter")
        fixed = [] if slow else [fix(data, k) for k in range(len(exact))]
        found = []
        for seed in seeds:
            runs = list(spoilt(case, errors, np.random.default_rng([SEED, seed])))
            if slow:
                now = reduce_runs(case.model.robot, runs, data.preparation)
            else:
                now = data.with_factors(list(map(refactor, [data] * len(runs), fixed, runs)))
            system = now.system(per_run=True)
            solution = ml(system.problem)
            found.append(judge(case, system, solution))
    return found


def judge(case: Case, system: System, solution: Solution) -> Repetition:
    problem, base = system.problem, system.base
    std = np.sqrt(np.diag(solution.jackknife))
    chi = np.array([case.truth.get(name, 0.0) for name in case.model.parameter_names])
    truth = dict(zip(base.names, base.matrix @ chi, strict=True))
    index = [k for k, name in enumerate(problem.parameters) if name in truth]
    n = len(problem.joints)
    gains = np.arange(problem.n_theta, problem.n_theta + n)
    expected = np.concatenate([[truth[problem.parameters[k]] for k in index], case.gains, np.zeros(n)])
    names = (
        *(problem.parameters[k] for k in index),
        *(f"{what}_{joint}" for what in ("gain", "delay") for joint in problem.joints),
    )
    which = np.concatenate([np.array(index, dtype=int), gains, gains + n])
    apart = replace(problem, clusters=None)
    alone = ml(apart)
    delays = delay_verdicts(problem, solution, std[gains + n], 0.0)
    return Repetition(
        names,
        solution.values[which] - expected,
        std[which],
        degrees_of_freedom(problem, solution, True)[which],
        np.array([each.outcome != Grade.NOT_IDENTIFIABLE for each in delays]),
        np.sqrt(np.diag(alone.jackknife))[which],
        degrees_of_freedom(apart, alone, True)[which],
    )


def report(case: Case, source: str, errors: str, repetitions: Sequence[Repetition], apart: bool) -> dict[str, object]:
    from scipy.special import stdtrit

    from gtau.model.base_parameters import base_parameters

    base = base_parameters(case.model)
    chi = np.array([case.truth.get(name, 0.0) for name in case.model.parameter_names])
    truth = dict(zip(base.names, base.matrix @ chi, strict=True))
    error, std = np.array([r.error for r in repetitions]), np.array([r.apart if apart else r.std for r in repetitions])
    freedoms = np.array([r.apart_freedom if apart else r.freedom for r in repetitions])
    half = stdtrit(freedoms, 0.975) * std
    hits = np.abs(error) < half
    inside, told = np.mean(hits, axis=0), np.array([r.told for r in repetitions])
    names = repetitions[0].names
    gain = np.array([name.startswith("gain_") for name in names])
    size = np.array([abs(truth.get(name, np.inf)) for name in names])
    delay = np.array([name.startswith("delay_") for name in names])
    main = ~gain & ~delay & (size > MAIN * np.median(std, axis=0))
    return {
        "robot": source,
        "errors": errors,
        "repetitions": len(repetitions),
        "gains": [round(100 * float(x), 1) for x in inside[gain]],
        "gains_pooled": round(100 * float(inside[gain].mean()), 1),
        "z": float(np.sqrt(np.mean((error / std)[:, gain] ** 2))),
        "half_width": 100 * float(np.exp(np.mean(np.log(half[:, gain] / case.gains)))),
        "main_parameters": int(main.sum()),
        "main_pooled": round(100 * float(inside[main].mean()), 1),
        "pooled": round(100 * float(inside[gain | main].mean()), 1),
        "delays": round(100 * float(hits[:, delay][told].mean()), 1) if told.any() else None,
        "delays_told": round(100 * float(told.mean()), 1),
        "smallest": round(100 * float(inside[gain | main].min()), 1),
        "smallest_of": names[int(np.flatnonzero(gain | main)[np.argmin(inside[gain | main])])],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("robots", nargs="+", help="catalog names or robot files")
    parser.add_argument("--errors", nargs="+", choices=MODELS, default=["white", "coloured", "drift"])
    parser.add_argument("--repeat", action="store_true", help="runs with the payload repeat the motions of the others")
    parser.add_argument("--repetitions", type=int, default=300)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--json", help="file for the table")
    options = parser.parse_args()
    heads = (
        "robot",
        "errors",
        "times",
        "each gain",
        "gains",
        "rms z",
        "half-width, %",
        "parameters",
        "all",
        "smallest cell",
        "delays (told)",
    )
    print(f"| {' | '.join(heads)} |\n|{' --- |' * 11}")
    rows = []
    for source in options.robots:
        case = make_case(source, options.repeat)
        for errors in options.errors:
            seeds = np.array_split(np.arange(options.repetitions), options.processes)
            if options.processes == 1:
                found = repeat(case, errors, seeds[0])
            else:
                with Pool(options.processes) as pool:
                    parts = pool.starmap(_apart, [(source, options.repeat, errors, part) for part in seeds])
                    found = [each for part in parts for each in part]
            for apart in (False, True)[: 1 + options.repeat]:
                row = report(case, source, errors, found, apart)
                rows.append(row)
                each = " ".join(f"{x:.0f}" for x in row["gains"])
                print(
                    f"| {source} | {errors}{', one run at a time' * apart} | {row['repetitions']} | {each} | "
                    f"{row['gains_pooled']} | {row['z']:.2f} | {row['half_width']:.2g} | {row['main_pooled']} "
                    f"({row['main_parameters']}) | {row['pooled']} | {row['smallest']} ({row['smallest_of']}) | "
                    f"{row['delays']} ({row['delays_told']}) |",
                    flush=True,
                )
    if options.json:
        with open(options.json, "w", encoding="utf-8") as file:
            json.dump(rows, file, indent=1)


def _apart(source: str, repeated: bool, errors: str, seeds: Sequence[int]) -> list[Repetition]:
    return repeat(make_case(source, repeated), errors, seeds)


if __name__ == "__main__":
    main()
