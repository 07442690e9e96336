"""Simulate logs with one departure at a time and compare the errors of the gains with those of the best fixed choice.

    python benchmarks/preparation_study.py [--quick] [--repetitions 3] [--update docs/zoo.md]

A five-bar whose gains are known is moved along five sines (0.2 to 1 Hz), free and with a known payload. Its logs get
noise of one kind, are written as files and identified: once with default settings, and once for each choice of a grid
of position filters and decimations set by hand. An error is the rms relative error of the gains over both joints and
all repetitions; the best fixed choice is the one of the grid that turns out best with the truth known.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.identify import identify
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.signals.run import Run, read_run
from gtau.signals.settings import CHOSEN, PreparationSettings

MARKS = "<!-- study: begin -->", "<!-- study: end -->"
ROBOT = load_robot("five-bar")
MODEL = InverseDynamics(ROBOT)
JOINTS, GAINS, SECONDS = MODEL.actuated, np.array([2.5, 4.0]), 20.0
STEEL = {"m": 1.2, "mx": 0.36, "my": 0.06, "zz": 0.12}
CHI = {"ia_left": 0.03, "ia_right": 0.028, "fv_left": 0.5, "fv_right": 0.6, "fs_left": 0.8, "fs_right": 0.7, "m_left": 0.9, "mx_left": 0.11, "zz_left": 0.02, "m_right": 1.0, "mx_right": 0.12, "zz_right": 0.025, "m_left_forearm": 0.5, "mx_left_forearm": 0.09, "zz_left_forearm": 0.02, "m_right_forearm": 0.6, "mx_right_forearm": 0.1, "my_right_forearm": 0.02, "zz_right_forearm": 0.022}  # fmt: skip  # noqa: E501
SIGNALS = {"time": "t", "position": {"left": "qa", "right": "qb"}, "current": {"left": "va", "right": "vb"}}
W = 2 * np.pi * 0.2 * np.arange(1, 6)

Log = tuple[np.ndarray, np.ndarray, np.ndarray]  # stamps (N,), positions and currents (N, 2)
Motion = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]  # positions and currents at instants


def motion(loaded: bool, seed: int) -> Motion:
    """Positions, and currents with noise of 0.5 %, at any instants."""
    rng = np.random.default_rng(seed)
    phase = rng.uniform(0, 2 * np.pi, (2, 5))
    size, chi = 0.5 / W, dict(CHI)
    for kind, value in STEEL.items() if loaded else ():
        chi[f"{kind}_right_forearm"] += value

    def at(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        angle = W * time[:, None, None] + phase
        q = np.radians([120.0, 60.0]) + (size * np.sin(angle)).sum(axis=2)
        qd, qdd = (size * W * np.cos(angle)).sum(axis=2), (-size * W**2 * np.sin(angle)).sum(axis=2)
        v = MODEL.torques(q, qd, qdd, chi) / GAINS
        return q, v + 0.005 * v.std(axis=0) * rng.standard_normal(v.shape)

    return at


def white(of: Motion, time: np.ndarray, rng: np.random.Generator, size: float) -> Log:
    """White noise of the positions, in rad."""
    q, v = of(time)
    return time, q + size * rng.standard_normal(q.shape), v


def rounded(of: Motion, time: np.ndarray, rng: np.random.Generator, size: float) -> Log:
    """Encoders of so many bits a turn."""
    q, v = of(time)
    quantum = 2 * np.pi / 2**size
    return time, np.round(q / quantum) * quantum, v


def late(of: Motion, time: np.ndarray, rng: np.random.Generator, size: float) -> Log:
    """Stamps that are late by up to so many steps."""
    return time + size * (time[1] - time[0]) * rng.random(len(time)), *of(time)


def irregular(of: Motion, time: np.ndarray, rng: np.random.Generator, size: float) -> Log:
    """Samples taken at irregular instants, within so many steps, with true stamps."""
    true = time + size * (time[1] - time[0]) * rng.random(len(time))
    return true, *of(true)


def stale(of: Motion, time: np.ndarray, rng: np.random.Generator, size: float) -> Log:
    """A share of the samples repeats the one before."""
    q, v = of(time)
    at = np.flatnonzero(rng.random(len(time) - 1) < size) + 1
    for each in (q, v):
        each[at] = each[at - 1]
    return time, q, v


def held(of: Motion, time: np.ndarray, rng: np.random.Generator, size: float) -> Log:
    """Currents that are new with every so many-th sample only."""
    q, v = of(time)
    return time, q, v[np.arange(len(v)) // int(size) * int(size)]


KINDS: dict[str, tuple[Callable[..., Log], float]] = {
    "white, 1e-4 rad": (white, 1e-4), "white, 1e-3 rad": (white, 1e-3),
    "12 bits": (rounded, 12), "16 bits": (rounded, 16), "20 bits": (rounded, 20),
    "late by 10 %": (late, 0.1), "late by 60 %": (late, 0.6), "irregular by 60 %": (irregular, 0.6),
    "stale 1 %": (stale, 0.01), "stale 10 %": (stale, 0.1), "currents held 5": (held, 5),
}  # fmt: skip
QUICK = ("white, 1e-3 rad", "12 bits", "20 bits", "late by 60 %", "irregular by 60 %", "stale 10 %", "currents held 5")
RATES = (20.0, 100.0, 1000.0, 4000.0)
FILTERS: tuple[float | str, ...] = (3.0, 6.0, 12.0, "none")  # Hz
ROWS = (10.0, 50.0)  # a second


def logs(kind: str, rate: float, seed: int, folder: Path) -> list[Run]:
    """A free and a loaded run, written as files and read."""
    disturb, size = KINDS[kind]
    runs = []
    for loaded in (False, True):
        rng = np.random.default_rng([seed, loaded])
        time = np.arange(int(SECONDS * rate)) / rate
        stamps, q, v = disturb(motion(loaded, 10 * seed + loaded), time, rng, size)
        table = np.column_stack([stamps, q, v])
        path = folder / f"{'loaded' if loaded else 'free'}.csv"
        np.savetxt(path, table, delimiter=",", header="t,qa,qb,va,vb", comments="", fmt="%.12g")
        payload = {"name": "steel", "mass": STEEL["m"]} if loaded else None
        runs.append(read_run(path, SIGNALS, payload))
    return runs


def error(runs: list[Run], settings: PreparationSettings) -> np.ndarray:
    """Relative errors of the gains (2,); infinite where the logs are refused."""
    try:
        found = identify(ROBOT, [replace(run, settings=settings) for run in runs])
    except GtauError:
        return np.full(len(JOINTS), np.inf)
    return np.array([found.drive_gains[joint].value for joint in JOINTS]) / GAINS - 1


def case(kind: str, rate: float, repetitions: int) -> str:
    """One row of the table."""
    choices = [
        PreparationSettings(position_filter=cut, decimation=max(1, round(rate / rows)))
        for cut, rows in product(FILTERS, ROWS)
        if (cut == "none" or float(cut) < 0.45 * rate) and rows <= rate
    ]
    errors: list[list[np.ndarray]] = [[] for _ in (CHOSEN, *choices)]
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(repetitions):
            runs = logs(kind, rate, seed, Path(folder))
            for of, settings in zip(errors, (CHOSEN, *choices), strict=True):
                of.append(error(runs, settings))
    chosen, *fixed = (float(np.sqrt(np.mean(np.square(each)))) for each in errors)
    best = int(np.argmin(fixed))
    cut = choices[best].position_filter
    what = "no filter" if cut == "none" else f"{cut:g} Hz"
    return f"| {kind} | {rate:g} | {100 * chosen:.2g} | {100 * fixed[best]:.2g} ({what}, 1 in {choices[best].decimation}) | {100 * max(fixed):.2g} | {chosen / fixed[best]:.2f} |"  # noqa: E501


def main() -> None:
    """Run the cases and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="seven kinds of noise and three rates")
    parser.add_argument("--repetitions", type=int, default=3)
    parser.add_argument("--update", type=Path, metavar="PAGE")
    arguments = parser.parse_args()
    lines = [
        "| noise | rate, Hz | error of the gains, % | best fixed choice, % | worst, % | ratio |",
        "| --- | ---: | ---: | --- | ---: | ---: |",
    ]
    print("\n".join(lines), flush=True)
    kinds, rates = (QUICK, RATES[:3]) if arguments.quick else (tuple(KINDS), RATES)
    for rate, kind in product(rates, kinds):
        lines.append(case(kind, rate, arguments.repetitions))
        print(lines[-1], flush=True)
    if arguments.update:
        page = arguments.update.read_text(encoding="utf-8")
        begin, end = (page.index(mark) for mark in MARKS)
        arguments.update.write_text(
            page[:begin] + "\n".join([MARKS[0], "", *lines, "", ""]) + page[end:], encoding="utf-8"
        )


if __name__ == "__main__":
    main()
