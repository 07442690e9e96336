"""Identify a robot, up to the cut-offs of its predictions and the requirements of its experiment file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from gtau.errors import GtauError
from gtau.estimation import identify as estimation
from gtau.estimation.experiment_runs import Options, Subject, read, read_validation
from gtau.estimation.results.estimate import Requirement, TorqueError
from gtau.estimation.results.result import IdentifiedModel
from gtau.findings import Finding
from gtau.model.program import single_threaded_blas
from gtau.progress import Progress, silent
from gtau.robots.robot import Robot
from gtau.signals.reading.experiment import Experiment
from gtau.signals.run import Run
from gtau.uses.prediction import validate, with_prediction_cutoffs

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
