"""What the logs of an experiment hold, before anything is identified from them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gtau import display
from gtau.errors import GtauError
from gtau.estimation.experiment_runs import read_runs
from gtau.estimation.regression.dataset import prepare_runs
from gtau.estimation.regression.rows import Labels
from gtau.estimation.regression.system import FEWEST_ROWS
from gtau.estimation.results.singularity_distances import Distances, NearestPose, distances_of, nearest_poses
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.singularities import singularities
from gtau.progress import Progress, silent
from gtau.robots.robot import Robot
from gtau.signals.bandwidth import JointSpectrum, spectra
from gtau.signals.decimation import Decimator
from gtau.signals.experiment import check_robot, read_experiment
from gtau.signals.preparation import Preparation, PreparedRun, choose_preparation
from gtau.signals.run import Run, arrange
from gtau.signals.storage import BLOCK, Store


@dataclass(frozen=True, eq=False)
class JointCheck:
    """One joint in a log, while the robot moves: positions in rad or m, commands in A or N m (N).

    ``bandwidth`` is in Hz, NaN at rest; ``usable`` is the share of the decimated rows that an identification uses.
    """

    joint: str
    position: tuple[float, float]
    speed_rms: float
    speed_max: float
    bandwidth: float
    command_rms: float
    command_max: float
    usable: float


@dataclass(frozen=True, eq=False)
class LogCheck:
    """One log: what was repaired (``notes``), its joints, and at its decimated samples positions (K, n) and distances.

    ``rows`` is the number of decimated samples, ``validation`` whether the file lists the run under that key.
    """

    run: Run
    validation: bool
    notes: tuple[str, ...]
    rows: int
    joints: tuple[JointCheck, ...]
    position: np.ndarray
    used: np.ndarray
    distances: Distances
    nearest: tuple[NearestPose, ...]
    preparation: Preparation
    spectra: tuple[JointSpectrum, ...]


@dataclass(frozen=True, eq=False)
class ExperimentCheck:
    """All logs of an experiment, and how they are prepared."""

    robot: Robot
    preparation: Preparation
    logs: tuple[LogCheck, ...]

    @property
    def notes(self) -> tuple[str, ...]:
        """What an identification would refuse, of all its runs together."""
        used = [log for log in self.logs if not log.validation]
        rows = {
            each[0].joint: sum(round(joint.usable * log.rows) for joint, log in zip(each, used, strict=True))
            for each in zip(*(log.joints for log in used), strict=True)
        }
        return tuple(
            f"joint '{joint}' has {count} usable rows in all runs together, too few for an identification (at least "
            f"{FEWEST_ROWS}): add runs in which it moves, or longer ones"
            for joint, count in rows.items()
            if count < FEWEST_ROWS
        )

    def _repr_html_(self) -> str:
        html: str = display.views().html(self)
        return html


def check_logs(path: str | Path, progress: Progress = silent) -> ExperimentCheck:
    """Read and prepare all logs of an experiment file, without identifying.

    Raises
    ------
    GtauError
        Where a file is wrong, a log cannot be used, or the robot's loops cannot be closed along it.
    """
    experiment = read_experiment(path)
    robot = load_robot(experiment.robot)
    check_robot(experiment, robot)
    model = InverseDynamics(robot)
    listed = (*experiment.runs, *experiment.validation)
    runs = [arrange(run, model.actuated) for run in read_runs(experiment, listed, progress)]
    count = len(experiment.runs)
    preparation = choose_preparation(runs[:count])
    checked = []
    for k, run in enumerate(runs):
        progress("checking logs", k, len(runs))
        own = preparation.at(run.rate)
        (prepared,) = prepare_runs(model, [run], own)
        checked.append(_check(model, prepared, own.decimator, validation=k >= count))
    progress("checking logs", len(runs), len(runs))
    return ExperimentCheck(robot, preparation, tuple(checked))


def _check(model: InverseDynamics, prepared: PreparedRun, decimator: Decimator, validation: bool) -> LogCheck:
    run, n = prepared.run, len(prepared.run.joints)
    rows = decimator.outputs(len(prepared))
    if not rows:
        raise GtauError(f"run '{run.name}' is too short to be decimated by {decimator.factor}; give a longer log.")
    lowest, highest, fastest, strongest = ([] for _ in range(4))
    positions, distances, masks = Store((n,)), Store((2,), np.float32), Store((n,), bool)
    power, c = np.zeros(n), None
    for block in decimator.blocks(len(prepared), max(BLOCK // decimator.factor, 1)):
        of = prepared.samples(block.samples.start, block.samples.stop)
        last = block.first + (block.outputs.stop - block.outputs.start - 1) * decimator.factor
        at = slice(block.first, last + 1, decimator.factor)
        masks.append(decimator.keep(of.usable[block.first - decimator.support : last + decimator.support + 1]))
        q, labels = of.q[at].T.copy(), Labels(run.name, of.time[at])
        c = model.path(q, labels, None if c is None else c[:, -1])
        still = np.zeros_like(q)
        distances.append(singularities(model).distances(model.rates(c, still, still, labels)).T)
        positions.append(of.q[at])
        power += (of.command[at] ** 2).sum(axis=0)
        lowest.append(of.q.min(axis=0))
        highest.append(of.q.max(axis=0))
        fastest.append(np.abs(of.qd).max(axis=0))
        strongest.append(np.abs(of.command).max(axis=0))
    values, used, found = distances.array(), masks.array(), spectra(run)
    columns = zip(
        run.joints,
        np.min(lowest, axis=0).tolist(),
        np.max(highest, axis=0).tolist(),
        np.sqrt(np.diag(prepared.speeds)).tolist(),
        np.max(fastest, axis=0).tolist(),
        [each.bandwidth for each in found],
        np.sqrt(power / rows).tolist(),
        np.max(strongest, axis=0).tolist(),
        used.mean(axis=0).tolist(),
        strict=True,
    )
    return LogCheck(
        run=run,
        validation=validation,
        notes=(*run.notes, *prepared.notes),
        rows=rows,
        joints=tuple(JointCheck(joint, (low, high), *rest) for joint, low, high, *rest in columns),
        position=positions.array(),
        used=used,
        distances=distances_of(prepared, decimator, values),
        nearest=tuple(nearest_poses(prepared, decimator, values)),
        preparation=prepared.preparation,
        spectra=found,
    )
