"""The runs of experiment files, read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from gtau.errors import GtauError
from gtau.estimation.diagnostics.geometry_findings import GeometryTest
from gtau.estimation.results.identified_model import IdentifiedModel
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.progress import Progress, silent
from gtau.signals.experiment import Experiment, check_robot, read_experiment
from gtau.signals.logged_run import LoggedRun
from gtau.signals.run import Run, read_run
from gtau.signals.side_signals import read_poses


def read_runs(experiment: Experiment, runs: Sequence[LoggedRun], progress: Progress = silent) -> tuple[Run, ...]:
    """Read logged runs of an experiment file; raises GtauError."""
    whole = 1000  # of a run

    def read(k: int, run: LoggedRun) -> Run:
        def advance(done: float) -> None:
            progress("reading logs", round(whole * (k + done)), whole * len(runs))

        return read_run(
            run.log, experiment.signals, run.payload, experiment.units, advance, experiment.preparation, run.part
        )

    return tuple(read(k, run) for k, run in enumerate(runs))


def geometry_of(
    experiment: Experiment, runs: Sequence[LoggedRun], model: InverseDynamics, progress: Progress = silent
) -> GeometryTest | None:
    """Test the robot's geometry by the poses logged in runs; None where the experiment has none. Raises GtauError."""
    signals = experiment.signals
    if signals.pose is None:
        return None
    from gtau.estimation.diagnostics.geometry import geometry_test

    logged = [read_poses(run.log, signals, experiment.units, run.part) for run in runs]
    return geometry_test(model, signals.pose, signals.joints, logged, progress)


def experiment_of(model: IdentifiedModel, path: str | Path) -> Experiment:
    """Read an experiment file that is to be used with an identified model.

    Raises
    ------
    GtauError
        Where the file is wrong, or its robot or signals are not those of the model.
    """
    experiment = read_experiment(path)
    robot = load_robot(experiment.robot)
    check_robot(experiment, robot)
    if replace(robot, name="", source="") != replace(model.robot, name="", source=""):
        raise GtauError(
            f"{path} describes the robot '{robot.name}', but the model is of '{model.robot.name}' or of "
            "another geometry; give the model of this robot."
        )
    if experiment.signals.kind != model.kind:
        raise GtauError(
            f"the logs of {path} hold {experiment.signals.kind}s, but the model was identified from {model.kind}s; "
            "give logs of the same kind."
        )
    return experiment
