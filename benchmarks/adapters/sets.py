"""The board's sets: measured logs as the zoo has them, and simulated truths, identified by gtau with its defaults."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import process_time

import numpy as np
import zoo
from realism.departures import DEPARTURES
from realism.logs import make_logs
from realism.plants import PLANTS
from scipy.signal import butter, sosfiltfilt

from gtau.estimation.experiment_runs import read_runs
from gtau.result import Result, identify
from gtau.robots.robot import Robot
from gtau.signals.reading.experiment import read_experiment
from gtau.signals.run import Run

DATA_SHEET = 0.1  # largest relative error of the constants and masses that peers are told of simulated robots
SLOW = 0.05  # of a joint's rms speed: it rests


@dataclass(frozen=True)
class Case:
    """An experiment, identified by gtau, and what its peers are told and what is true of it.

    ``gains`` (n,) are true or another's; ``constants`` (n,) torques per command as a data sheet has them; ``masses`` a
    file with the robot's, or its parameters; ``chi`` is the truth.
    """

    result: Result
    seconds: float
    runs: Sequence[Run]
    checks: Sequence[Run]
    constants: np.ndarray
    gains: np.ndarray | None = None
    masses: Path | dict[str, float] | None = None
    chi: dict[str, float] = field(default_factory=dict)


def measured(write: Callable[[Path, Path], str], folder: Path, data: Path, **told: object) -> Case:
    """Logs as the zoo writes their experiment file."""
    path = folder / "experiment.yaml"
    path.write_text(write(data, folder), encoding="utf-8")
    begin = process_time()
    experiment = read_experiment(path)
    result = identify(experiment)
    seconds = process_time() - begin
    runs, checks = (
        [run.ordered(result.idm.actuated) for run in read_runs(experiment, listed)]
        for listed in (experiment.runs, experiment.validation)
    )
    return Case(result, seconds, runs, checks, **{"constants": np.ones(len(result.idm.actuated)), **told})


def simulated(name: str, seed: int, torque: bool) -> Case:
    """One of the realism's plants; a data sheet errs by up to DATA_SHEET in constants and masses."""
    plant = PLANTS[name]
    runs, gains = make_logs(plant, DEPARTURES["none"], seed)
    chi = plant.parameters(plant.model, np.random.default_rng([11, seed]))
    draw = np.random.default_rng([12, seed])
    constants = gains * draw.uniform(1 - DATA_SHEET, 1 + DATA_SHEET, len(gains))
    scale = {body: draw.uniform(1 - DATA_SHEET, 1 + DATA_SHEET) for body in plant.model.robot.bodies}
    masses = {key: value * scale.get(key.split("_", 1)[1], 1.0) for key, value in chi.items()}
    if torque:
        runs = [replace(run, kind="torque", command=run.command * gains) for run in runs[::2]]
        gains, constants = None, np.ones_like(gains)
    fitted, checks = (runs[:1], runs[1:]) if torque else (runs[:2], runs[2:3])
    begin = process_time()
    result = identify(plant.model.robot, fitted)
    return Case(result, process_time() - begin, fitted, checks, constants, gains, masses, chi)


def aliengo(data: Path, folder: Path) -> str:
    """Twelve motors of a quadruped hung up, of which the last third is not used."""
    log = data / "aliengo" / "aliengo.csv"
    text = zoo.aliengo(data, folder).replace(f"{{log: '{log}'}}", f"{{log: '{log}', to: 16}}")
    return f"{text}validation:\n  - {{log: '{log}', from: 16}}\n"


UR10E = np.array([11.98, 11.98, 9.84, 10.76, 10.76, np.nan])  # target moment over target current at rest
ORTHOGLIDE = np.array([2170.0, 2100.0, 2070.0])
NAMES = {
    "arms-torque": "simulated arms, torques",
    "arms": "simulated arms",
    "ur10e-sim": "simulated UR10e",
    "orthoglide": "simulated Orthoglide",
    "ur10e": "UR10e",
    "tx40": "TX40",
    "panda": "Panda",
    "aliengo": "Aliengo",
}


def cases_of(name: str, data: Path, folder: Path) -> list[Case]:
    """The experiments of a set."""
    several = {"arms-torque": ("arm", 4, True), "arms": ("arm", 4, False), "ur10e-sim": ("ur10e", 1, False)}
    if name in several:
        plant, count, torque = several[name]
        return [simulated(plant, seed, torque) for seed in range(count)]
    told: dict[str, dict[str, object]] = {
        "orthoglide": {"gains": ORTHOGLIDE, "constants": np.full(3, 2001.0)},  # the maker's
        "ur10e": {
            "gains": UR10E,
            "constants": np.nan_to_num(UR10E, nan=10.76),
            "masses": data / "ur10e" / "ur10e.urdf",
        },
        "tx40": {"masses": data / "tx40" / "tx40_mdh_modified.urdf"},
        "panda": {},
        "aliengo": {"masses": data / "aliengo" / "aliengo.xml"},
    }
    write = {each.name: each.write for each in zoo.ENTRIES} | {"aliengo": aliengo}
    return [measured(write[name], folder, data, **told[name])]


def arm_of(result: Result) -> tuple[Robot, np.ndarray]:
    """The arm without motors of their own, and joint speeds per motor speed (n, n)."""
    n = len(result.idm.actuated)
    joints = tuple(replace(joint, actuated=True) for joint in result.robot.joints[:n])
    robot = result.robot if len(result.robot.joints) == n else replace(result.robot, joints=joints, couplings=())
    return robot, result.friction_law.ratios[:n]


def states(result: Result, run: Run) -> np.ndarray:
    """Positions (N, n) of the arm's joints."""
    q = np.asarray(run.position)
    return result.idm.motion(*result.idm.samples(q, 0 * q, 0 * q)).c[: q.shape[1]].T


def cutoff(case: Case, run: Run, times: float = 5) -> float:
    """Hz of a low-pass of so many bandwidths of the motion: of 5, measured and predicted commands are compared."""
    return min(times * case.result.preparation.bandwidth, 0.45 * run.rate)


def moving(case: Case, run: Run) -> slice:
    """The rows from the first to the last motion of any joint: no tool can predict what stiction holds."""
    low_pass = butter(4, cutoff(case, run), fs=run.rate, output="sos")
    speed = np.abs(np.gradient(sosfiltfilt(low_pass, np.asarray(run.position), axis=0), axis=0))
    rows = np.flatnonzero((speed > SLOW * np.sqrt(np.mean(speed**2, axis=0))).any(axis=1))
    return slice(rows[0], rows[-1] + 1)
