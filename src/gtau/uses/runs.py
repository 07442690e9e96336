"""Logs and experiments for an identified model: read, and checked to be of its robot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from gtau.errors import GtauError, NoFile
from gtau.estimation.experiment_runs import describe
from gtau.estimation.results.result import IdentifiedModel
from gtau.robots.robot import Limits, Robot, RobotFile
from gtau.signals.reading.experiment import Experiment, read_experiment
from gtau.signals.reading.samples import WHOLE, Part
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run, read_run


def read_log(
    model: IdentifiedModel,
    log: str | Path,
    experiment: str | Path | None = None,
    part: Part = WHOLE,
    payload: str | None = None,
) -> Run:
    """Read a log, or a ``part`` of it, for use with a model; the robot carries the model's ``payload``, if named.

    The ``signals`` and ``units`` of an experiment file name the columns; by default they are ``t``, and ``q`` and ``v``
    with each joint's name (``tau`` if the model was identified from torques), SI units. Raises GtauError.
    """
    if payload is not None:
        return carrying(model, read_log(model, log, experiment, part), payload)
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
    except NoFile:
        raise
    except GtauError as error:
        raise GtauError(f"{str(error).rstrip('.')}; or name its columns by --experiment EXPERIMENT.yaml.") from None


def carrying(model: IdentifiedModel, run: Run, payload: str) -> Run:
    """Return the run with one of the model's payloads; raises GtauError where the model does not know its mass."""
    known = [name for name in dict.fromkeys(payload.name for payload in model.payloads) if "m" in model.payload(name)]
    if payload not in known:
        raise GtauError(f"the model knows no payload '{payload}'; choose from {', '.join(known) or 'none'}.")
    return replace(run, payload=Payload(name=payload))


def experiment_of(model: IdentifiedModel, path: str | Path) -> Experiment:
    """Read an experiment file for use with a model; raises GtauError if robot or signals differ from the model's."""
    subject = describe(path)
    experiment = subject.experiment
    assert experiment is not None
    require_same(model, subject.robot, experiment.signals.kind, str(path))
    return experiment


def require_same(model: IdentifiedModel, robot: Robot, kind: str, where: str) -> None:
    """Check that an identified model has the same robot and kind of logs; raises GtauError."""
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
    """Return a robot without the parts that do not enter its equations of motion."""
    joints = tuple(replace(joint, limits=Limits()) for joint in robot.joints)
    return replace(robot, name="", joints=joints, file=RobotFile())
