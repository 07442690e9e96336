"""Rows of the benchmarks' table, and what all of them need: motions, clocks, checks before timing, CSV files."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import process_time

import numpy as np

from gtau.robots.robot import Robot


@dataclass(frozen=True)
class Row:
    """A line of the table: times in microseconds a sample unless the unit says otherwise."""

    work: str
    peer: str
    ours: float
    theirs: float | None
    unit: str
    target: str

    @property
    def ratio(self) -> float | None:
        return None if self.theirs is None else self.theirs / self.ours


def medians(repetitions: int, *works: Callable[[], object], clock: Callable[[], float] = process_time) -> list[float]:
    """Median times in s of works that take turns, after each was done once.

    Of processor time, which other people's work on the machine disturbs less, unless another clock is given.
    """
    times: list[list[float]] = [[] for _ in works]
    for repetition in range(repetitions + 1):
        for each, work in zip(times, works, strict=True):
            start = clock()
            work()
            if repetition:
                each.append(clock() - start)
    return [float(np.median(each)) for each in times]


def motion(
    robot: Robot, samples: int, rate: float = 1000.0, slowest: float = 0.3
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A smooth path near home, five harmonics of ``slowest`` Hz: positions, velocities, accelerations, (N, n) each."""
    rng = np.random.default_rng(0)
    joints = [robot.joint(name) for name in robot.actuated]
    reach = np.array([0.04 if robot.closures else 0.5 for _ in joints])
    t = np.arange(samples)[:, None] / rate
    q, qd, qdd = (np.zeros((samples, len(joints))) for _ in range(3))
    for harmonic in range(1, 6):
        w = 2 * np.pi * slowest * harmonic
        a, b = rng.normal(size=(2, len(joints))) * reach / 5
        q += a * np.sin(w * t) + b * (np.cos(w * t) - 1)
        qd += a * w * np.cos(w * t) - b * w * np.sin(w * t)
        qdd += -a * w * w * np.sin(w * t) - b * w * w * np.cos(w * t)
    return q + [joint.home for joint in joints], qd, qdd


def check(what: str, ours: np.ndarray, theirs: np.ndarray, tolerance: float = 1e-9) -> None:
    """Stop where two results differ by more than the tolerance of the largest."""
    error = np.abs(ours - theirs).max() / np.abs(theirs).max()
    if not error < tolerance:
        raise SystemExit(f"{what}: results differ by {error:.1e} of the largest")


def write_csv(path: Path, lines: Sequence[Sequence[str]]) -> None:
    """Write a table."""
    path.parent.mkdir(exist_ok=True)
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows(lines)
