"""Runs for an identified model: logs and experiments that suit it, prepared as for its identification."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from gtau.errors import GtauError
from gtau.estimation.experiment_runs import describe
from gtau.estimation.regression.dataset import at_rate_of
from gtau.estimation.regression.plausibility import check_wrenches, motor_to_joint_speed
from gtau.estimation.results.result import Result
from gtau.robots.robot import Limits, Robot, RobotFile
from gtau.signals.preparation.prepared_run import PreparedRun, prepare
from gtau.signals.reading.experiment import Experiment, read_experiment
from gtau.signals.reading.samples import WHOLE, Part
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run, read_run


def suited(result: Result, run: Run) -> Run:
    """Order the columns of a run as the model's joints; raises GtauError where it is of another kind."""
    if not isinstance(run, Run):
        raise GtauError(
            f"this takes a run, not a {type(run).__name__}; read the log with gtau.read_run(log, signals), which knows "
            "its columns."
        )
    run = run.ordered(result.idm.actuated)
    if run.kind != result.kind:
        raise GtauError(
            f"run '{run.name}' holds {run.kind}s, but the model was identified from {result.kind}s; give a run of the "
            "same kind."
        )
    return run


def prepared_for(result: Result, run: Run) -> tuple[PreparedRun, range]:
    """Prepare all samples of a run as for identification, and mark those in which the robot moves."""
    run = suited(result, run)
    check_wrenches(result.robot, run)
    prepared = prepare(run, at_rate_of([run], result.preparation), motor_to_joint_speed(result.idm))
    return replace(prepared, kept=range(len(run.time))), prepared.kept


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
    known = [name for name in dict.fromkeys(payload.name for payload in model.payloads) if "m" in model.payload(name)]
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
    subject = describe(path)
    experiment = subject.experiment
    assert experiment is not None
    require_same(model, subject.robot, experiment.signals.kind, str(path))
    return experiment


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
