"""Identify a robot, up to the cut-offs of its predictions and the requirements of its experiment file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from gtau.errors import GtauError
from gtau.estimation import identify as estimation
from gtau.estimation.experiment_runs import Options, Subject, describe, read, read_validation
from gtau.estimation.results.estimate import Requirement, TorqueError
from gtau.estimation.results.result import IdentifiedModel
from gtau.findings import Finding
from gtau.model.program import single_threaded_blas
from gtau.progress import Progress, silent
from gtau.robots.robot import Limits, Robot, RobotFile
from gtau.signals.reading.experiment import Experiment, read_experiment
from gtau.signals.reading.samples import WHOLE, Part
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run, read_run
from gtau.uses.prediction import validate, with_prediction_cutoffs


def read_log(
    model: IdentifiedModel,
    log: str | Path,
    experiment: str | Path | None = None,
    part: Part = WHOLE,
    payload: str | None = None,
) -> Run:
    """Read a log, or a ``part`` of it, for use with a model; the robot carries the model's ``payload``, if named.

    The ``signals`` and ``units`` of an experiment file name the columns; by default they are as in the model's logs. A
    model that does not know these expects ``t``, and ``q`` and ``v`` with each joint's name (``tau`` if it was
    identified from torques), SI units. Raises GtauError.
    """
    if payload is not None:
        return carrying(model, read_log(model, log, experiment, part), payload)
    if experiment is not None:
        described = read_experiment(experiment)
        return read_run(log, described.signals, None, described.units, settings=described.preparation, part=part)
    letter, joints = "v" if model.kind == "current" else "tau", model.robot.actuated
    signals: Any = {"time": "t", "position": {joint: f"q{joint}" for joint in joints}}
    signals |= {model.kind: {joint: f"{letter}{joint}" for joint in joints}}
    units = None
    if model.recording is not None:
        signals, units = model.recording.signals, model.recording.units
    try:
        return read_run(log, signals, None, units, part=part)
    except GtauError as error:
        if "column" not in error.sentence:
            raise
        raise GtauError(f"{str(error).rstrip('.')}; or name its columns by --experiment EXPERIMENT.yaml.") from None


def carrying(model: IdentifiedModel, run: Run, payload: str) -> Run:
    """Return the run with one of the model's payloads; raises GtauError where the model does not know its mass."""
    require_payload(model, payload)
    return replace(run, payload=Payload(name=payload))


def require_payload(model: IdentifiedModel, payload: str) -> None:
    """Refuse a name of no payload whose mass the model knows; raises GtauError."""
    known = [name for name in dict.fromkeys(payload.name for payload in model.payloads) if "m" in model.payload(name)]
    if payload not in known:
        raise GtauError(f"the model knows no payload '{payload}'; choose from {', '.join(known) or 'none'}.")


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


Validation = tuple[Sequence[Run], Sequence[Finding]]
"""Runs kept for validation, and a note on each log that cannot be used."""


def identify(
    source: str | Path | Experiment | Robot,
    runs: Sequence[Run] | None = None,
    options: Options | None = None,
    progress: Progress = silent,
) -> IdentifiedModel:
    """Identify a robot from an experiment file or from runs; see :func:`gtau.identify`. Raises GtauError."""
    subject = read(source, runs, options or Options(), progress)
    result = identify_subject(subject, progress)
    if subject.experiment is None:
        return result
    result = result.replaced(notes=(*subject.experiment.guesses, *result.notes))
    demanded = subject.experiment.require.torque_error is not None
    validation = read_validation(subject.experiment, progress) if demanded else ((), ())
    return with_requirements(result, subject.experiment, validation)


def identify_subject(subject: Subject, progress: Progress = silent) -> IdentifiedModel:
    """Identify a robot from the runs of a subject, without the requirements of its experiment; raises GtauError."""
    with single_threaded_blas():
        result = estimation.identify_subject(subject, progress)
        return with_prediction_cutoffs(result, result.data)


def with_requirements(result: IdentifiedModel, experiment: Experiment, validation: Validation) -> IdentifiedModel:
    """Compare a result with the requirements of its experiment, torque errors also on the validation runs."""
    return result.replaced(requirements=tuple(_requirements(result, experiment, validation)))


def _requirements(result: IdentifiedModel, experiment: Experiment, validation: Validation) -> Iterator[Requirement]:
    require, (runs, unread) = experiment.require, validation
    if require.torque_error is not None:
        yield _torque_requirement(require.torque_error, result.residuals)
        for note in unread:
            yield Requirement("torque_error", require.torque_error, None, run=note.source or "validation")
        for run in runs:
            try:
                errors = validate(result, run)
            except GtauError:
                errors = ()
            yield _torque_requirement(require.torque_error, errors, run.name)
    if require.gain_interval is not None:
        widths = {joint: gain.half_width for joint, gain in result.drive_gains.items()}
        unknown = [joint for joint, width in widths.items() if width is None]
        joint = unknown[0] if unknown else max(widths, key=lambda name: widths[name] or 0.0)
        yield Requirement("gain_interval", require.gain_interval, widths[joint], joint)


def _torque_requirement(limit: float, errors: Iterable[TorqueError], run: str = "") -> Requirement:
    worst = max(errors, key=lambda error: error.relative, default=None)
    if worst is None:
        return Requirement("torque_error", limit, None, run=run)
    return Requirement("torque_error", limit, worst.relative, worst.joint, run)
