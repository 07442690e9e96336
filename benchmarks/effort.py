"""What 'effort' means: logs whose torques mean something else, and whether that is named.

    python benchmarks/effort.py arm ur10e scara five-bar delta --seeds 3
    python benchmarks/effort.py --real [--update docs/evidence/coverage.md]

Robots, motions, friction and noise are those of benchmarks/false_alarms.py, logged as torques; each log is then spoilt
in one way. "said" is what is looked for in notes, verdicts and refusals. Of the measured logs of the zoo nothing of
the kind is to be said.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import polars as pl
import zoo
from realism.departures import DEPARTURES
from realism.logs import make_logs
from realism.plants import PLANTS, Plant, of_limits
from threadpoolctl import threadpool_limits

from gtau.errors import GtauError
from gtau.estimation.identify import identify
from gtau.estimation.results.conclusions import findings
from gtau.robots.robot import Joint, Limits, Mdh, Robot
from gtau.signals.run import Run, read_run

MARKS = "<!-- effort: begin -->", "<!-- effort: end -->"
KINDS = {"position": "q", "torque": "tau"}
SECONDS = 8.0
GEAR = 101.0
LATE = 0.06  # s
LIMITS = Limits(position=(-2.0, 2.0), velocity=3.0, acceleration=15.0)
SCARA = Robot(
    "scara",
    (
        Joint("1", "ground", "revolute", Mdh(), limits=replace(LIMITS, effort=80.0)),
        Joint("2", "1", "revolute", Mdh(d=0.3), limits=replace(LIMITS, effort=40.0)),
        Joint("3", "2", "prismatic", Mdh(d=0.25), limits=Limits(position=(0.0, 0.2), velocity=0.5, effort=200.0)),
    ),
)


@dataclass(frozen=True)
class Meaning:
    """Something that effort may hold: how a log is spoilt, with a payload or without, and what is to be said."""

    said: Sequence[str]
    spoil: Callable[[Run, np.ndarray], np.ndarray] = lambda run, rated: run.command
    loaded: bool = False
    gravity: bool = True
    friction: bool = True


MEANINGS = {
    "true torques": Meaning(()),
    "true torques, known payload": Meaning((), loaded=True),
    "without gravity": Meaning(("torques without gravity",), gravity=False),
    "motor side, known payload": Meaning(
        ("torques of the motors",), lambda run, rated: run.command / GEAR, loaded=True
    ),
    "motor side": Meaning(("torques of the motors",), lambda run, rated: run.command / GEAR),
    "magnitude": Meaning(("hold magnitudes",), lambda run, rated: np.abs(run.command)),
    "per mille of the rated torque": Meaning(
        ("whole numbers",), lambda run, rated: np.round(1000 * run.command / rated)
    ),
    "per cent of the rated torque": Meaning(("whole numbers",), lambda run, rated: np.round(100 * run.command / rated)),
    "the controller's model": Meaning(("torques of a model",), friction=False),
    "late by 60 ms": Meaning(
        ("currents logged late", "command lag"),
        lambda run, rated: np.roll(run.command, round(LATE / float(np.median(np.diff(run.time)))), axis=0),
    ),
}
ALL = {word for each in MEANINGS.values() for word in each.said}


def plant_of(name: str) -> Plant:
    if name == "scara":
        return replace(PLANTS["arm"], robot=lambda: SCARA, within=of_limits, centre=(0.1, 0.02, 0.0), seconds=SECONDS)
    return replace(PLANTS[name], seconds=2 * SECONDS if name == "ur10e" else SECONDS)


def with_limits(robot: Robot, torques: np.ndarray) -> Robot:
    """Give joints limits of effort a little above three times their torque, as the file of a robot would have."""
    limits = {
        joint: 3.0 * (1 + 0.1 * k) * peak for k, (joint, peak) in enumerate(zip(robot.actuated, torques, strict=True))
    }
    joints = (
        replace(each, limits=replace(each.limits, effort=limits[each.name])) if each.name in limits else each
        for each in robot.joints
    )
    return replace(robot, joints=tuple(joints))


def logs(name: str, meaning: Meaning, seed: int) -> tuple[Robot, list[Run]]:
    plant = plant_of(name)
    robot = plant.robot()
    if not meaning.gravity:
        plant = replace(plant, robot=lambda: replace(robot, gravity=(0.0, 0.0, 0.0)))
    if not meaning.friction:

        def frictionless(model, rng, drawn=plant.parameters):
            return {
                name: 0.0 if name.startswith(("fs_", "fv_", "off_")) else value
                for name, value in drawn(model, rng).items()
            }

        plant = replace(plant, parameters=frictionless)
    runs, gains = make_logs(plant, DEPARTURES["none"], 500 + seed)
    runs = [replace(run, kind="torque", command=run.command * gains) for run in runs[: 4 if meaning.loaded else 1]]
    if not meaning.friction:  # what a controller computes has no noise, but the steps of its numbers
        runs = [replace(run, command=_without_noise(run)) for run in runs]
    peaks = np.max([np.abs(run.command).max(axis=0) for run in runs], axis=0)
    return with_limits(robot, peaks), [_read(replace(run, command=meaning.spoil(run, 0.7 * peaks))) for run in runs]


def _read(run: Run) -> Run:
    """Read the run from a table, with the checks of a log."""
    n = range(len(run.joints))
    table = pl.DataFrame(
        {"t": run.time}
        | {f"q{j}": run.position[:, j] for j in n}
        | {f"tau{j}": np.asarray(run.command)[:, j] for j in n}
    )
    columns = {kind: {joint: f"{letter}{j}" for j, joint in enumerate(run.joints)} for kind, letter in KINDS.items()}
    return replace(read_run(table, {"time": "t", **columns}, run.payload), name=run.name)


def _without_noise(run: Run) -> np.ndarray:
    from scipy.ndimage import gaussian_filter1d

    return gaussian_filter1d(run.command, 4.0, axis=0)


def said(source: object, runs: list[Run] | None = None) -> set[str]:
    """What of the meanings is named."""
    try:
        result = identify(source, runs)  # type: ignore[arg-type]
    except GtauError as refusal:
        return {word for word in ALL if word in str(refusal)}
    found = [each.verdict.finding for each in result.drive_gains.values() if each.verdict.finding is not None]
    kinds = {str(each.kind) for of in found for each in (of, *of.causes)}
    kinds |= {each.finding for each in findings(result) if each.finding}
    return {word for word in ALL if any(word in kind for kind in kinds)}


def spoilt(robot: str, meaning: Meaning, seed: int) -> set[str]:
    try:
        return said(*logs(robot, meaning, seed))
    except GtauError as refusal:
        return {word for word in ALL if word in str(refusal)}


def measured(entry: zoo.Entry, data: Path) -> set[str]:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "experiment.yaml"
        path.write_text(entry.write(data, Path(folder)), encoding="utf-8")
        return said(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("robots", nargs="*")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--only", nargs="+", choices=list(MEANINGS))
    parser.add_argument("--real", action="store_true", help="the measured logs too")
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument("--update", type=Path, metavar="PAGE")
    options = parser.parse_args()
    lines = [f"| effort holds | {' | '.join(options.robots)} |", "| --- |" + " --- |" * len(options.robots)]
    with threadpool_limits(1, "blas"):
        for name in options.only or (MEANINGS if options.robots else ()):
            meaning, cells = MEANINGS[name], []
            for robot in options.robots:
                heard = [spoilt(robot, meaning, seed) for seed in range(options.seeds)]
                right = sum(bool(each & set(meaning.said)) for each in heard)
                others = Counter(word for each in heard for word in each - set(meaning.said))
                wrong = "".join(f"; {word}: {count}" for word, count in sorted(others.items()))
                cells.append((f"{right} of {len(heard)}" if meaning.said else "nothing" if not others else "") + wrong)
                print(name, robot, cells[-1], flush=True)
            lines.append(f"| {name} | {' | '.join(cells)} |")
        if options.real:
            heard = {entry.name: measured(entry, options.data) for entry in zoo.ENTRIES}
            alarms = {entry: sorted(each) for entry, each in heard.items() if each}
            lines += ["", f"Of {len(heard)} measured logs of the zoo, said of: {alarms or 'none'}."]
    print("\n".join(lines))
    if options.update:
        page = options.update.read_text(encoding="utf-8")
        begin, end = (page.index(mark) for mark in MARKS)
        options.update.write_text(
            page[:begin] + "\n".join([MARKS[0], "", *lines, "", ""]) + page[end:], encoding="utf-8"
        )


if __name__ == "__main__":
    main()
