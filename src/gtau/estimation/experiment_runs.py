"""Subject of an identification: a robot, its runs and priors, from an experiment file or given in Python."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite
from pathlib import Path
from typing import Any

from gtau.documents.validation import MAPPING, NUMBER, expect, read_group
from gtau.errors import GtauError
from gtau.estimation.diagnostics.geometry_findings import GeometryTest
from gtau.estimation.regression.priors import inertia_priors
from gtau.estimation.results.result import Result
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.progress import Progress, silent
from gtau.robots.file import RobotFile
from gtau.robots.robot import Limits, Robot
from gtau.signals.reading.experiment import Experiment, check_robot, read_experiment
from gtau.signals.reading.logged_run import LoggedRun
from gtau.signals.reading.samples import WHOLE, Part
from gtau.signals.reading.side_signals import read_poses
from gtau.signals.reading.statements import Payload, Prior, StatedGain, as_priors
from gtau.signals.run import Run, read_run

OF_RUNS = "the runs of a robot are a list of runs; read each log with gtau.read_run."


@dataclass(frozen=True, eq=False)
class Subject:
    """A robot with its runs and prior knowledge: ``priors`` with those of data sheets, and ``stated`` without.

    ``gain_stds`` are the standard deviations of the prior gains, where stated; ``experiment`` is None where
    robot and runs were given in Python. ``prior_inertias`` is the relative standard deviation of the inertias of the
    robot's file where these are among the priors, else 0.
    """

    robot: Robot
    runs: Sequence[Run]
    prior_gains: Mapping[str, float]
    priors: Mapping[str, Prior]
    stated: Mapping[str, Prior]
    experiment: Experiment | None = None
    gain_stds: Mapping[str, float] = field(default_factory=dict)
    prior_inertias: float = 0.0

    def with_inertias(self, std: float | None) -> Subject:
        """Take the inertias of the robot's file as priors, where none are stated; raises GtauError."""
        if std is None:
            return self
        of_file = inertia_priors(self.robot, std)
        return replace(self, priors={**of_file, **self.priors}, stated={**of_file, **self.stated}, prior_inertias=std)


def subject_of(
    source: str | Path | Experiment | Robot,
    runs: Sequence[Run] | None = None,
    prior_gains: Mapping[str, float | Mapping[str, float]] | None = None,
    priors: Mapping[str, Prior | Mapping[str, Any]] | None = None,
    progress: Progress = silent,
    prior_inertias: float | None = None,
) -> Subject:
    """Read an experiment, or take a robot with its runs; arguments replace the experiment's own entries.

    Raises
    ------
    GtauError
        If a file is wrong, a robot comes without runs, an experiment with runs, or an argument has a wrong type.
    """
    found = describe(source, runs, prior_gains, priors, prior_inertias)
    if found.experiment is None:
        return found
    return replace(found, runs=read_runs(found.experiment, found.experiment.runs, progress))


def describe(
    source: str | Path | Experiment | Robot,
    runs: Sequence[Run] | None = None,
    prior_gains: Mapping[str, float | Mapping[str, float]] | None = None,
    priors: Mapping[str, Prior | Mapping[str, Any]] | None = None,
    prior_inertias: float | None = None,
) -> Subject:
    """Do as :func:`subject_of`, but leave the logs of an experiment unread."""
    given = None if priors is None else as_priors(priors)
    gains, stds = (None, {}) if prior_gains is None else _as_gains(prior_gains)
    if isinstance(source, Robot):
        if runs is not None and (isinstance(runs, Run) or not isinstance(runs, Iterable)):
            raise GtauError(OF_RUNS)
        runs = () if runs is None else tuple(runs)
        if not runs:
            raise GtauError("a robot alone cannot be identified; give its runs too.")
        if not all(isinstance(run, Run) for run in runs):
            raise GtauError(OF_RUNS)
        found = Subject(source, runs, gains or {}, given or {}, given or {}, gain_stds=stds)
        return found.with_inertias(prior_inertias)
    if runs is not None:
        raise GtauError(
            "runs are given beside an experiment file, which lists its own; give a robot with runs, or the file alone."
        )
    if not isinstance(source, (str, Path, Experiment)):
        raise GtauError(
            f"a {type(source).__name__} cannot be identified; give the path of an experiment file, or a robot "
            "(gtau.load_robot) with its runs."
        )
    experiment = source if isinstance(source, Experiment) else read_experiment(source)
    robot = load_robot(experiment.robot)
    check_robot(experiment, robot)
    found = Subject(
        robot,
        (),
        experiment.expected_gains if gains is None else gains,
        experiment.expected_parameters if given is None else given,
        experiment.priors if given is None else given,
        experiment,
        experiment.gain_stds if gains is None else stds,
    )
    return found.with_inertias(experiment.prior_inertias if prior_inertias is None else prior_inertias)


def _as_gains(gains: Mapping[str, float | Mapping[str, float]]) -> tuple[dict[str, float], dict[str, float]]:
    """Read gains by joint, and the standard deviations of those that have one."""
    expect("'prior_gains'", gains, MAPPING)
    values, stds = {}, {}
    for joint, gain in gains.items():
        name = f"prior gain of joint '{joint}'"
        if isinstance(gain, Mapping):
            stated = read_group(StatedGain, name, gain)
            gain, stds[str(joint)] = stated.value, stated.std
        expect(f"the {name}", gain, NUMBER)
        if not isfinite(gain) or gain == 0:
            raise GtauError(f"the {name} is {gain:g}; give its N m/A (or N/A).")
        values[str(joint)] = float(gain)
    return values, {joint: std for joint, std in stds.items() if std is not None}


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
    """Test the robot's geometry against the logged poses; None if no pose is logged. Raises GtauError."""
    signals = experiment.signals
    if signals.pose is None:
        return None
    from gtau.estimation.diagnostics.geometry import geometry_test

    logged = [read_poses(run.log, signals, experiment.units, run.part) for run in runs]
    return geometry_test(model, signals.pose, signals.joints, logged, progress)


def read_log(model: Result, log: str | Path, experiment: str | Path | None = None, part: Part = WHOLE) -> Run:
    """Read a log to be used with a model.

    Parameters
    ----------
    model : Result
        Of the robot.
    log : path
        The log.
    experiment : path, optional
        Experiment file whose ``signals`` and ``units`` name the columns; left out, they are ``t``, and for each joint
        ``q`` and ``v`` with the joint's name (``tau`` where the model was identified from torques), SI units.
    part : Part
        Which part of the log is used.

    Raises
    ------
    GtauError
        Where the log or the experiment file cannot be read, or the columns are not there.
    """
    if experiment is not None:
        described = read_experiment(experiment)
        return read_run(log, described.signals, None, described.units, settings=described.preparation, part=part)
    command, letter = ("current", "v") if model.kind == "current" else ("torque", "tau")
    joints = model.robot.actuated
    signals: Mapping[str, Any] = {
        "time": "t",
        "position": {joint: f"q{joint}" for joint in joints},
        command: {joint: f"{letter}{joint}" for joint in joints},
    }
    try:
        return read_run(log, signals, part=part)
    except GtauError as error:
        raise GtauError(f"{str(error).rstrip('.')}; or name its columns by --experiment EXPERIMENT.yaml.") from None


def carrying(model: Result, run: Run, payload: str) -> Run:
    """Return the run with one of the model's payloads; raises GtauError where the model does not know its mass."""
    known = [name for name in dict.fromkeys(each.name for each in model.payloads) if "m" in model.payload(name)]
    if payload not in known:
        raise GtauError(f"the model knows no payload '{payload}'; choose from {', '.join(known) or 'none'}.")
    return replace(run, payload=Payload(name=payload))


def experiment_of(model: Result, path: str | Path) -> Experiment:
    """Read an experiment file that is to be used with an identified model.

    Raises
    ------
    GtauError
        Where the file is wrong, or its robot or signals are not those of the model.
    """
    found = describe(path)
    assert found.experiment is not None
    require_same(model, found.robot, found.experiment.signals.kind, str(path))
    return found.experiment


def require_same(model: Result, robot: Robot, kind: str, where: str) -> None:
    """Check that a robot and the kind of its logs are those of an identified model; raises GtauError."""
    if _mechanism(robot) != _mechanism(model.robot):
        raise GtauError(
            f"{where} describes the robot '{robot.name}', but the model is of '{model.robot.name}' or of "
            "another geometry; give the model of this robot."
        )
    if kind != model.kind:
        raise GtauError(
            f"the logs of {where} hold {kind}s, but the model was identified from {model.kind}s; "
            "give logs of the same kind."
        )


def _mechanism(robot: Robot) -> Robot:
    """Reduce a robot to its mechanism: drop the parts that do not enter its equations of motion."""
    joints = tuple(replace(joint, limits=Limits()) for joint in robot.joints)
    return replace(robot, name="", joints=joints, file=RobotFile())
