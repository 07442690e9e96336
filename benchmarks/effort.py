"""What 'effort' means: logs whose torques mean something else, and whether that is named.

    python benchmarks/effort.py arm ur10e scara five-bar delta --seeds 3
    python benchmarks/effort.py --measured ur10e tx40 panda airbot [--out docs/evidence/coverage]

Robots, motions, friction and noise are those of benchmarks/false_alarms.py, logged as torques; each log is then spoilt
in one way. "said" is what is looked for in notes, verdicts and refusals. The measured logs of the zoo are spoilt too,
and the most likely meaning of each is printed, without the checks of reading (which refuse most magnitudes before).
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
from table import write_csv
from threadpoolctl import threadpool_limits

from gtau.errors import GtauError
from gtau.estimation.diagnostics.effort import columns_of_effort, middle_rows, shows_gravity
from gtau.estimation.diagnostics.log_checks import doubtful_commands, lack_of_fit
from gtau.estimation.estimators.least_squares import fit_by
from gtau.estimation.estimators.maximum_likelihood import ml_or_wls
from gtau.estimation.experiment_runs import describe, read_runs
from gtau.estimation.regression.dataset import Dataset, reduce_runs
from gtau.estimation.results.conclusions import findings
from gtau.result import identify
from gtau.robots.parameter import parameter_of
from gtau.robots.robot import INERTIAL, Joint, Limits, Mdh, Robot
from gtau.signals.run import Run, read_run

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
    kinds |= {each.kind for each in findings(result)}
    return {word for word in ALL if any(word in kind for kind in kinds)}


def spoilt(robot: str, meaning: Meaning, seed: int) -> set[str]:
    try:
        return said(*logs(robot, meaning, seed))
    except GtauError as refusal:
        return {word for word in ALL if word in str(refusal)}


# Measured logs


def airbot(data: Path, folder: Path) -> str:
    """An AIRBOT Play without and with 0.48 kg."""
    joints, logs = [f"joint{k}" for k in range(1, 7)], data / "airbot_play"
    runs = [(logs / "chirp_unloaded.csv", ""), (logs / "chirp_loaded_480g.csv", ", payload: {name: load, mass: 0.48}")]
    signals = zoo.numbered("q", joints), ("torque", zoo.numbered("tau", joints))
    return zoo.experiment_file(str(logs / "airbot_play_v3_0_gripper.urdf"), "t", *signals, runs, [])


LOGS = {entry.name: entry.write for entry in zoo.ENTRIES} | {"airbot": airbot}
Alteration = Callable[[np.ndarray, np.ndarray, np.ndarray, int], np.ndarray]
ALTERED: dict[str, Alteration] = {  # the command, that due to gravity, rated values, and samples of a delay
    "nothing": lambda command, gravity, rated, late: command,
    "without gravity": lambda command, gravity, rated, late: command - gravity,
    "before gears of 100:1": lambda command, gravity, rated, late: command / 100,
    "‰ of rated values": lambda command, gravity, rated, late: np.round(1000 * command / rated),
    "late": lambda command, gravity, rated, late: np.roll(command, late, axis=0),
    "magnitudes": lambda command, gravity, rated, late: np.abs(command),
    "two exchanged": lambda command, gravity, rated, late: swapped(command, (1, 2)),
    "three permuted": lambda command, gravity, rated, late: swapped(swapped(command, (0, 1)), (1, 2)),
    "scaled by 0.7": lambda command, gravity, rated, late: 0.7 * command,
    "all reversed": lambda command, gravity, rated, late: -command,
    "backwards in time": lambda command, gravity, rated, late: command[::-1],
}


def swapped(command: np.ndarray, pair: tuple[int, int]) -> np.ndarray:
    order = list(range(command.shape[1]))
    order[pair[0]], order[pair[1]] = order[pair[1]], order[pair[0]]
    return command[:, order]


def measured(name: str, data: Path) -> dict[str, str]:
    """The most likely meaning of a measured log, as it is and altered."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "experiment.yaml"
        path.write_text(LOGS[name](data, Path(folder)), encoding="utf-8")
        subject = describe(path)
        dataset = reduce_runs(subject.robot, read_runs(subject.experiment, subject.experiment.runs))
    n, runs = len(dataset.model.actuated), dataset.runs
    slowest = dataset.system().problem.longest_delays.max()
    system = dataset.system()
    gains = None if runs[0].kind == "current" else np.ones(n)
    fit = fit_by(ml_or_wls(gains), system, gains is None)
    falling = [parameter_of(each).kind in INERTIAL for each in dataset.base.standard]
    regressor, gravity = dataset.model.columns(dataset.base.standard), []
    for k, run in enumerate(runs):
        q = np.ascontiguousarray(run.position.T)
        motion = dataset.model.motion(q, 0 * q, 0 * q)
        values = np.where(falling, system.motion(k, fit.solution.theta), 0.0)
        torques = regressor.torques(regressor(dataset.model.layout, motion), values, n)
        gravity.append((torques / fit.gains[:n, None]).T)
    rated = 0.7 * np.max([np.abs(run.command).max(axis=0) for run in runs], axis=0)
    found = {}
    for what, alter in ALTERED.items():
        altered = [
            replace(
                run,
                command=np.ascontiguousarray(
                    alter(run.command, own, rated, round(max(LATE, 1.4 * slowest) * run.rate))
                ),
                log=replace(run.log, whole_share=None),  # which was of the command as it is
            )
            for run, own in zip(runs, gravity, strict=True)
        ]
        try:
            found[what] = meaning(reduce_runs(dataset.robot, altered, dataset.preparation))
        except GtauError as refusal:
            found[what] = f"refused: {refusal}"[:60]
        print(name, what, found[what], sep=" | ", flush=True)
    return found


def meaning(dataset: Dataset) -> str:
    """The likeliest description, and what the size says without a payload."""
    if doubtful := list(doubtful_commands(dataset.runs, dataset.robot)):
        return str(doubtful[0].kind)
    gains = None if dataset.runs[0].kind == "current" else np.ones(len(dataset.model.actuated))
    fit = fit_by(ml_or_wls(gains), dataset.system(), gains is None)
    middle = middle_rows(fit)
    if findings := columns_of_effort(middle):
        return findings[0].kind
    missing, _ = (False, False) if middle is None else shows_gravity(middle, lack_of_fit(fit.problem, fit.solution))
    return "torques without gravity" if missing else "as stated"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("robots", nargs="*")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--only", nargs="+", choices=list(MEANINGS))
    parser.add_argument("--measured", nargs="+", default=[], choices=LOGS, help="the measured logs too")
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument(
        "--out", type=Path, metavar="FOLDER", help="where effort.csv and effort-measured.csv are written"
    )
    options = parser.parse_args()
    tables = {"effort": [["effort holds", *options.robots]]} if options.robots else {}
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
            tables["effort"].append([name, *cells])
        if options.measured:
            answers = {name: measured(name, options.data) for name in options.measured}
            rows = [[what, *(each[what] for each in answers.values())] for what in ALTERED]
            tables["effort-measured"] = [["altered", *answers], *rows]
    for name, lines in tables.items():
        print("\n".join(map(" | ".join, lines)))
        if options.out:
            write_csv(options.out / f"{name}.csv", lines)


if __name__ == "__main__":
    main()
