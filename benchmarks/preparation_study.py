"""Simulate logs with one departure at a time and compare the errors of the gains with those of the best fixed choice.

    python benchmarks/preparation_study.py [--robots arm five-bar] [--rates 20 100] [--kinds "12 bits"] [--seeds 5]
                                           [--out docs/evidence/zoo]

Two robots whose gains are known are moved free and with a known payload: a two-joint arm from point to point with
rests, a five-bar along five sines. Positions and currents at the sampled instants are computed once for a rate; every
seed adds noise of one kind anew. The gains are identified by maximum likelihood once with what is chosen from the logs,
and once for each choice of a grid of position filters and decimations set by hand, from the same logs. An error is the
rms relative error of the gains over both joints and all seeds; the best fixed choice is the one of the grid with the
least error, that is with the truth known. A ratio of two such errors is random itself: its standard error is that of
the delete-one jackknife over the seeds.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import product
from pathlib import Path

import numpy as np
from table import write_csv
from threadpoolctl import threadpool_limits

from gtau.errors import GtauError
from gtau.estimation.estimators import estimator_of
from gtau.estimation.estimators.estimator import jackknife
from gtau.estimation.regression.dataset import reduce_runs
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.robot import Joint, Mdh, Robot
from gtau.signals.reading.statements import CHOSEN, PreparationSettings
from gtau.signals.run import Run, read_run

LIMIT = 1.2  # times the error of the best fixed choice
GAINS = np.array([2.5, 4.0])
CURRENT_NOISE = 0.005  # of a current's standard deviation, white

Motion = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]  # q, qd, qdd (N, 2) at instants (N,)


def sines(time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Five harmonics of 0.2 Hz around the five-bar's home."""
    w = 2 * np.pi * 0.2 * np.arange(1, 6)
    angle = w * time[:, None, None] + np.random.default_rng(1).uniform(0, 2 * np.pi, (2, 5))
    q = np.radians([120.0, 60.0]) + (0.5 / w * np.sin(angle)).sum(axis=2)
    return q, (0.5 * np.cos(angle)).sum(axis=2), (-0.5 * w * np.sin(angle)).sum(axis=2)


def points(time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Moves of 1.2 s along polynomials of fifth degree, and rests of 0.4 s between them."""
    targets = np.random.default_rng(2).uniform([-1.2, -1.5], [1.2, 1.5], (40, 2))
    last = np.minimum((time // 1.6).astype(int), len(targets) - 2)
    s, far = np.clip((time - 1.6 * last) / 1.2, 0, 1)[:, None], targets[last + 1] - targets[last]
    shape = s**3 * (10 - 15 * s + 6 * s**2), 30 * s**2 * (1 - s) ** 2 / 1.2, 60 * s * (1 - s) * (1 - 2 * s) / 1.2**2
    return targets[last] + far * shape[0], far * shape[1], far * shape[2]


@dataclass(frozen=True, eq=False)
class Plant:
    """A robot with known parameters along a motion; ``steel`` is what the payload adds to parameters of its body."""

    robot: Robot
    motion: Motion
    chi: dict[str, float]
    steel: dict[str, float]
    payload: dict[str, object]

    @cached_property
    def model(self) -> InverseDynamics:
        """Its inverse dynamics."""
        return InverseDynamics(self.robot)

    def at(self, time: np.ndarray, loaded: bool) -> tuple[np.ndarray, np.ndarray]:
        """Positions and currents without noise."""
        q, qd, qdd = self.motion(time)
        chi = {name: value + (self.steel.get(name, 0.0) if loaded else 0.0) for name, value in self.chi.items()}
        return q, self.model.torques(q, qd, qdd, chi) / GAINS


ARM = Robot(
    "arm",
    (
        Joint("left", "ground", "revolute", Mdh(alpha=np.pi / 2), actuated=True),
        Joint("right", "left", "revolute", Mdh(d=0.5), actuated=True),
    ),
)
PLANTS = {
    "arm": Plant(
        ARM, points,
        {"ia_left": 0.05, "ia_right": 0.02, "fv_left": 0.5, "fv_right": 0.4, "fs_left": 0.8, "fs_right": 0.6, "mx_left": 0.6, "zz_left": 0.2, "m_right": 1.5, "mx_right": 0.3, "my_right": 0.02, "zz_right": 0.09},  # noqa: E501
        {"m_right": 1.2, "mx_right": 0.48, "my_right": 0.0, "zz_right": 0.2},
        {"name": "steel", "mass": 1.2},
    ),
    "five-bar": Plant(
        load_robot("five-bar"), sines,
        {"ia_left": 0.03, "ia_right": 0.028, "fv_left": 0.5, "fv_right": 0.6, "fs_left": 0.8, "fs_right": 0.7, "m_left": 0.9, "mx_left": 0.11, "zz_left": 0.02, "m_right": 1.0, "mx_right": 0.12, "zz_right": 0.025, "m_left_forearm": 0.5, "mx_left_forearm": 0.09, "zz_left_forearm": 0.02, "m_right_forearm": 0.6, "mx_right_forearm": 0.1, "my_right_forearm": 0.02, "zz_right_forearm": 0.022},  # noqa: E501
        {"m_right_forearm": 1.2, "mx_right_forearm": 0.36, "my_right_forearm": 0.06, "zz_right_forearm": 0.12},
        {"name": "steel", "mass": 1.2},
    ),
}  # fmt: skip
SIGNALS = {"time": "t", "position": {"left": "qa", "right": "qb"}, "current": {"left": "va", "right": "vb"}}


def seconds(rate: float) -> float:
    """Length of a log: shorter where the samples are many."""
    return 20.0 if rate <= 500 else 10.0


@lru_cache(maxsize=4)
def truth(plant: str, rate: float, loaded: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Instants, positions and currents of a log without noise."""
    time = np.arange(int(seconds(rate) * rate)) / rate
    return time, *PLANTS[plant].at(time, loaded)


@dataclass(frozen=True)
class Log:
    """What a log would hold: stamps (N,), positions and currents (N, 2)."""

    stamps: np.ndarray
    position: np.ndarray
    current: np.ndarray

    def run(self, payload: dict[str, object] | None) -> Run:
        """The log as it is read."""
        columns = {"t": self.stamps}
        for letter, k in (("a", 0), ("b", 1)):
            columns |= {f"q{letter}": self.position[:, k], f"v{letter}": self.current[:, k]}
        return read_run(columns, SIGNALS, payload)


@dataclass(frozen=True)
class Kind:
    """A departure from the ideal log, of a ``size``; ``of`` takes plant, rate, load, generator and size."""

    of: Callable[[str, float, bool, np.random.Generator, float], Log]
    size: float


def noisy(current: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Currents with white noise."""
    return current + CURRENT_NOISE * current.std(axis=0) * rng.standard_normal(current.shape)


def white(plant: str, rate: float, loaded: bool, rng: np.random.Generator, size: float) -> Log:
    """White noise of the positions, in rad."""
    time, q, v = truth(plant, rate, loaded)
    return Log(time, q + size * rng.standard_normal(q.shape), noisy(v, rng))


def rounded(plant: str, rate: float, loaded: bool, rng: np.random.Generator, size: float) -> Log:
    """Encoders of so many bits a turn, whose zero differs from seed to seed."""
    time, q, v = truth(plant, rate, loaded)
    quantum = 2 * np.pi / 2**size
    zero = quantum * rng.random(2)
    return Log(time, np.round((q - zero) / quantum) * quantum + zero, noisy(v, rng))


def late(plant: str, rate: float, loaded: bool, rng: np.random.Generator, size: float) -> Log:
    """Stamps that are late by up to so many steps."""
    time, q, v = truth(plant, rate, loaded)
    return Log(time + size / rate * rng.random(len(time)), q, noisy(v, rng))


def irregular(plant: str, rate: float, loaded: bool, rng: np.random.Generator, size: float) -> Log:
    """Samples taken at irregular instants, within so many steps, with true stamps."""
    time = truth(plant, rate, loaded)[0]
    time = time + size / rate * rng.random(len(time))
    q, v = PLANTS[plant].at(time, loaded)
    return Log(time, q, noisy(v, rng))


def stale(plant: str, rate: float, loaded: bool, rng: np.random.Generator, size: float) -> Log:
    """A share of the samples repeats the one before."""
    time, q, v = truth(plant, rate, loaded)
    repeats = np.r_[False, rng.random(len(time) - 1) < size]
    source = np.maximum.accumulate(np.where(repeats, 0, np.arange(len(time))))
    return Log(time, q[source], noisy(v, rng)[source])


def held(plant: str, rate: float, loaded: bool, rng: np.random.Generator, size: float) -> Log:
    """Currents that are new with every so many-th sample only."""
    time, q, v = truth(plant, rate, loaded)
    return Log(time, q, noisy(v, rng)[np.arange(len(v)) // int(size) * int(size)])


KINDS = {
    "white, 1e-4 rad": Kind(white, 1e-4), "white, 1e-3 rad": Kind(white, 1e-3),
    "12 bits": Kind(rounded, 12), "16 bits": Kind(rounded, 16), "20 bits": Kind(rounded, 20),
    "late by 60 %": Kind(late, 0.6), "irregular by 60 %": Kind(irregular, 0.6),
    "stale, 1 %": Kind(stale, 0.01), "stale, 10 %": Kind(stale, 0.1), "currents held 5": Kind(held, 5),
}  # fmt: skip
RATES = (20.0, 50.0, 100.0, 250.0, 500.0, 1000.0, 4000.0)
FILTERS: tuple[float | str, ...] = (3.0, 6.0, 12.0, "none")  # Hz
ROWS = (12.5, 50.0)  # a second


def grid(rate: float) -> list[PreparationSettings]:
    """Fixed choices at a rate."""
    factors = sorted({max(1, round(rate / rows)) for rows in ROWS})
    cuts = [cut for cut in FILTERS if cut == "none" or float(cut) < 0.4 * rate]
    return [PreparationSettings(position_filter=cut, decimation=factor) for cut, factor in product(cuts, factors)]


@dataclass(frozen=True, eq=False)
class Outcome:
    """Errors of the gains of one case.

    ``chosen`` (S, 2) with what is chosen from the logs, ``in_sds`` (S, 2) the same in standard deviations that the
    identification reports, ``fixed`` (C, S, 2) with each of the fixed ``choices``; infinite where logs are refused.
    """

    chosen: np.ndarray
    in_sds: np.ndarray
    fixed: np.ndarray
    choices: Sequence[PreparationSettings]
    used: str

    @property
    def best(self) -> int:
        """The fixed choice with the least error."""
        return int(np.argmin([rms(each) for each in self.fixed]))

    @property
    def ratio(self) -> float:
        """Error of what is chosen over that of the best fixed choice."""
        return rms(self.chosen) / rms(self.fixed[self.best])

    @property
    def ratio_std(self) -> float:
        """Standard error of the ratio by the jackknife over the seeds, the best choice fixed."""
        best = self.fixed[self.best]
        without = [rms(np.delete(self.chosen, k, 0)) / rms(np.delete(best, k, 0)) for k in range(len(best))]
        return float(np.sqrt(jackknife(np.array(without)[:, None]))[0, 0])

    @property
    def misses(self) -> bool:
        """Whether the ratio is above the limit by more than two standard errors."""
        return self.ratio - 2 * self.ratio_std > LIMIT

    @property
    def cell(self) -> str:
        """Of the table: ratio and its standard error, and the error in per cent."""
        mark = "**" if self.misses else ""
        return f"{mark}{self.ratio:.2f} ± {self.ratio_std:.2f}{mark} ({100 * rms(self.chosen):.2g})"

    def line(self, name: str) -> str:
        """One line with everything."""
        best = self.choices[self.best]
        return (
            f"{name:38s} {100 * rms(self.chosen):8.3g} % = {rms(self.in_sds):5.2f} sd ({self.used}); best "
            f"{100 * rms(self.fixed[self.best]):8.3g} % ({best.position_filter} Hz, 1 in {best.decimation}); worst "
            f"{100 * max(map(rms, self.fixed)):8.3g} %; {self.ratio:.2f} +- {self.ratio_std:.2f}"
            + (" MISSES" if self.misses else "")
        )


def rms(errors: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(errors))))


def errors(robot: Robot, runs: Sequence[Run], settings: PreparationSettings) -> tuple[np.ndarray, np.ndarray, str]:
    """Relative errors of the gains (2,), their reported standard deviations (2,), and what was prepared how."""
    try:
        with threadpool_limits(limits=1, user_api="blas"):
            dataset = reduce_runs(robot, [replace(run, settings=settings) for run in runs])
            found = estimator_of("ml").fit(dataset.system()).solution
    except GtauError as error:
        return np.full(2, np.inf), np.ones(2), f"refused: {error}"
    gains = slice(len(found.theta), len(found.theta) + 2)
    std = np.sqrt(np.diag(found.jackknife)[gains]) if settings == CHOSEN else np.ones(2)
    used = dataset.preparation
    cut = "no filter" if used.cutoff is None else f"{used.cutoff:.3g} Hz"
    return found.gains / GAINS - 1, std / GAINS, f"{used.bandwidth:.2g} Hz, {cut}, 1 in {used.decimator.factor}"


def outcome(plant: str, kind: str, rate: float, seeds: int) -> Outcome:
    """Errors with all choices for the same logs."""
    of, choices = PLANTS[plant], grid(rate)
    found: list[list[np.ndarray]] = [[] for _ in (CHOSEN, *choices)]
    in_sds, used = [], ""
    for seed in range(seeds):
        rng = np.random.default_rng([seed, int(rate)])
        try:
            runs = [
                KINDS[kind].of(plant, rate, loaded, rng, KINDS[kind].size).run(of.payload if loaded else None)
                for loaded in (False, True)
            ]
        except GtauError as error:
            for errs in found:
                errs.append(np.full(2, np.inf))
            in_sds, used = [*in_sds, np.full(2, np.inf)], f"refused: {error}"
            continue
        for errs, settings in zip(found, (CHOSEN, *choices), strict=True):
            error_, std, how = errors(of.robot, runs, settings)
            errs.append(error_)
            if settings is CHOSEN:
                in_sds.append(error_ / std)
                used = how
    chosen, *fixed = (np.array(each) for each in found)
    return Outcome(chosen, np.array(in_sds), np.array(fixed), choices, used)


def main() -> None:
    """Run the cases and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", nargs="+", choices=PLANTS, default=list(PLANTS))
    parser.add_argument("--rates", nargs="+", type=float, default=RATES)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="of a CSV file for each robot")
    arguments = parser.parse_args()
    cells: dict[tuple[str, str], list[str]] = {each: [] for each in product(arguments.robots, arguments.kinds)}
    for k, rate in enumerate(arguments.rates, start=1):
        for plant, kind in cells:
            found = outcome(plant, kind, rate, arguments.seeds)
            print(found.line(f"{plant}, {rate:g} Hz, {kind}:"), flush=True)
            cells[plant, kind].append(found.cell)
        for name, rows in tables(cells, arguments.rates[:k]).items():
            if arguments.out:
                write_csv(arguments.out / f"preparation-{name}.csv", rows)
            if k == len(arguments.rates):
                print(f"\n{name}", *map(" | ".join, rows), sep="\n")


def tables(cells: Mapping[tuple[str, str], Sequence[str]], rates: Sequence[float]) -> dict[str, list[list[str]]]:
    """Return a table for each robot, of the rates that are done."""
    made = {plant: [["kind", *(f"{rate:g} Hz" for rate in rates)]] for plant, _ in cells}
    for (plant, kind), row in cells.items():
        made[plant].append([kind, *row])
    return made


if __name__ == "__main__":
    main()
