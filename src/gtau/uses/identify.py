"""Identify a robot from an experiment file or from logs alone, up to the requirements of the file."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gtau.documents.markup import Document
from gtau.documents.validation import MAPPING, MASSES, NAMES, NUMBER, PATH, TEXT, expect, takes, validate
from gtau.errors import GtauError
from gtau.estimation import identify as estimation
from gtau.estimation.experiment_runs import Options, Source, Subject, describe, read, read_validation
from gtau.estimation.regression.rows import instants
from gtau.estimation.results.estimate import Requirement, TorqueError
from gtau.estimation.results.result import IdentifiedModel
from gtau.findings import Finding, Progress, silent
from gtau.model.program import single_threaded_blas
from gtau.robots.robot import Limits, Robot, RobotFile
from gtau.signals.preparation.bandwidth import position_noise
from gtau.signals.preparation.filters import HIGHEST_CUTOFF
from gtau.signals.preparation.prepared_run import PreparedRun
from gtau.signals.reading.discovery import Draft
from gtau.signals.reading.drafting import (
    Stated,
    alternatives,
    draft_as,
    draft_logs,
    draft_text,
    guesses,
    to_weigh,
    with_sensors,
)
from gtau.signals.reading.experiment import Experiment, read_experiment
from gtau.signals.reading.formats import listed
from gtau.signals.reading.logs import find_columns
from gtau.signals.reading.samples import WHOLE, Part
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run, read_run
from gtau.uses import prediction


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
    known = [name for name, values in model.payload_values.items() if "m" in values]
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
    source: Source, runs: Sequence[Run] | None = None, options: Options | None = None, progress: Progress = silent
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


SAMPLES = 1 << 14  # of all runs together, from the middle of each
STEP = np.sqrt(2.0)  # between the cut-offs tried
RAISED = 0.01  # share by which noise may raise the error: the highest such cut-off, as other motions may be faster
NOISY = 2.0  # times the least error: noise then dominates, and higher cut-offs are not tried


def with_prediction_cutoffs(result: IdentifiedModel, runs: Sequence[Run]) -> IdentifiedModel:
    """Choose the position filter of each joint for predictions, from ``runs`` that a model was identified from.

    A lower cut-off loses the torque of fast motion; a higher one passes position noise. Each joint gets the highest
    whose error against the raw torque exceeds the least by at most 1 %. A position filter set by hand is kept.
    """
    preparation, blocks = result.preparation, []
    if "position_filter" in preparation.given:
        return result
    for run in runs:
        prepared, moving = prediction.prepared_for(result, run)
        middle = (moving.start + moving.stop) // 2
        half = SAMPLES // len(runs) // 2
        kept = range(max(moving.start, middle - half), min(moving.stop, middle + half))
        with suppress(GtauError):  # of a payload whose mass is unknown
            chi = prediction.loaded_parameters(result, run.payload, f"run '{run.name}'")
            blocks.append((replace(prepared, kept=kept), chi))
    if not blocks:
        return result
    highest = HIGHEST_CUTOFF * min(run.rate for run in runs)
    tried = [preparation.bandwidth]
    while tried[-1] * STEP < highest:
        tried.append(tried[-1] * STEP)
    errors: list[np.ndarray] = []
    for cutoff in tried:
        errors.append(np.sqrt(np.sum([_squares(result, cutoff, *block) for block in blocks], axis=0)))
        if (errors[-1] > NOISY * np.min(errors, axis=0)).all():
            break
    allowed = np.array(errors) <= (1 + RAISED) * np.min(errors, axis=0)
    last = len(errors) - 1 - np.argmax(allowed[::-1], axis=0)
    cutoffs = tuple(float(tried[k]) if tried[k] < highest else None for k in last)
    noise = np.max([position_noise(prepared.run, cutoffs) for prepared, _ in blocks], axis=0)
    preparation = replace(preparation, prediction_cutoffs=cutoffs, position_noise=tuple(noise.tolist()))
    return result.replaced(preparation=preparation)


def _squares(result: IdentifiedModel, cutoff: float, prepared: PreparedRun, chi: np.ndarray) -> np.ndarray:
    """Sum squares (n,) of the errors against the raw torques, with positions behind a ``cutoff`` (Hz)."""
    idm = result.idm
    wide = replace(prepared, cutoffs=(cutoff,) * len(prepared.run.joints))
    if idm in prepared.paths:  # along positions behind the previous cut-off
        labels = instants(prepared.run.name, wide.time)
        wide.paths[idm] = idm.near(prepared.paths[idm], wide.all_samples.q.T.copy(), labels)
    predicted, _, measured = prediction.joint_torques(result, wide, chi)
    prepared.paths.update(wide.paths)
    return np.asarray(np.sum((measured - predicted) ** 2, axis=1, where=prepared.valid()[:, : len(measured)].T))


def with_requirements(result: IdentifiedModel, experiment: Experiment, validation: Validation) -> IdentifiedModel:
    """Compare a result with the requirements of its experiment, torque errors also on the validation runs."""
    require, (runs, unread), compared = experiment.require, validation, list[Requirement]()
    if require.torque_error is not None:
        compared.append(_torque_requirement(require.torque_error, result.residuals))
        for note in unread:
            compared.append(_torque_requirement(require.torque_error, (), note.source or "validation"))
        for run in runs:
            try:
                predicted = prediction.predict(result, run)
                errors = prediction.torque_errors(predicted, result.robot, result.preparation.bandwidth)
            except GtauError:
                errors = ()
            compared.append(_torque_requirement(require.torque_error, errors, run.name))
    if require.gain_interval is not None:
        widths = {joint: gain.half_width for joint, gain in result.drive_gains.items()}
        unknown = [joint for joint, width in widths.items() if width is None]
        joint = unknown[0] if unknown else max(widths, key=lambda name: widths[name] or 0.0)
        compared.append(Requirement("gain_interval", require.gain_interval, widths[joint], joint))
    return result.replaced(requirements=tuple(compared))


def _torque_requirement(limit: float, errors: Iterable[TorqueError], run: str = "") -> Requirement:
    found, joint = max(((error.relative, error.joint) for error in errors), default=(None, ""))
    return Requirement("torque_error", limit, found, joint, run)


KINDS = ("position", "current", "torque", "time")
HERE = Path()
DRAFTED = Path("the draft")
ARGUMENTS: dict[str, str | Callable[[re.Match[str]], str]] = {
    r"--[\w-]+ \(in Python ([^)]*)\)": r"\1",
    r"--(position|current|torque|time)\b(?: COLUMNS?)?": r"gtau.draft(..., columns={'\1': ...})",
    r"--kind (\w+)": r"gtau.draft(..., kind='\1')",
    r"--payload (\S.*?)=([\d.]+|KG)": r"payload={'\1': \2}",
    r"--(method \w+|\w+ [A-Z]+(?:\.yaml)?)\b": lambda option: "{}='{}'".format(*option[1].split()),
    r"--(as-paper|consistent)\b": lambda option: f"{option[1].replace('-', '_')}=True",
    r"--([a-z][\w-]*)(?: (?=\d))?": lambda option: f"{option[1].replace('-', '_')}=",
}  # by the options that sentences name


def drafted(
    logs: Sequence[Path], robot: str | None, stated: Stated, weigh: bool = False, model: IdentifiedModel | None = None
) -> Draft:
    """Draft an experiment from logs, those without a stated payload without one, or with ``weigh`` an unknown one.

    Logs for a ``model`` have the columns of its logs, unless others are stated or named as its joints, and its payloads
    where these have the masses. Raises GtauError where an answer is needed.
    """
    known = model.recording if model and not (stated.columns or stated.preset) else None
    recording = known if known and stated.kind in (None, known.signals.kind) else None
    lacking: list[str] = []
    if recording:
        signals, columns = recording.signals, find_columns(logs[0]).columns
        needed = (*signals.time_columns, *signals.position.values(), *signals.measured)
        lacking = [name for name in needed if name not in columns]
    read = draft_as(recording, logs, robot, stated.masses) if recording and not lacking else None
    draft = read or draft_logs(logs, robot, stated=stated)
    if lacking and "joints" in draft.open:
        raise GtauError(
            f"the log lacks the columns {listed(lacking)} of the model's logs; give a log of that robot, or name its "
            "columns (--position COLUMNS, --current COLUMNS, --time COLUMN).",
            source=logs[0],
        )
    draft = to_weigh(draft) if weigh else with_sensors(draft)
    if model is not None:
        draft = replace(draft, names=prediction.known_names(model))
    if "file" not in draft.robot:
        raise GtauError(
            f"{logs[0]} does not name its robot; give it by --robot ROBOT, a catalog name (gtau robot) or the path "
            "of a URDF, MJCF or robot file."
        )
    if "rate" in draft.open:
        raise GtauError(
            f"{logs[0]} has neither times that grow nor velocities to find its sampling rate from; name the time "
            "column (--time COLUMN), or draft a file by 'gtau init', write the rate there (time: {rate: HZ}), and give "
            "that file."
        )
    for log, readings in draft.payloads.items():
        if len(readings) > 1:
            raise GtauError(
                f"the name of {log} may mean a payload of {alternatives(readings)} kg, which sets the scale of all "
                f"drive gains; state it by --payload {log.name}={readings[0]:g} (0 for none)."
            )
    return draft


@takes(logs=NAMES, robot=PATH, payload=MASSES, preset=TEXT, columns=MAPPING, kind=TEXT)
def draft(
    logs: Sequence[str | Path],
    robot: str | Path | None = None,
    payload: Mapping[str, float] | None = None,
    preset: str | None = None,
    columns: Mapping[str, str] | None = None,
    kind: str | None = None,
) -> Experiment:
    """Draft an experiment from logs, as ``gtau init`` does: find the columns of time, positions and currents.

    Parameters
    ----------
    logs : sequence of path
        One log per run, all of one layout.
    robot : path, optional
        A name of the catalog or the path of a robot's file.
    payload : mapping, optional
        Log to mass of the payload, kg, 0 for none: ``{"loaded.csv": 0.48}``; by default from names of the files such as
        ``loaded_0.48kg.csv``.
    preset : str, optional
        Recorder of the logs, such as ``"ur_rtde"``.
    columns : mapping, optional
        Columns or patterns by kind: ``{"position": "enc_J*", "current": "iq_J*", "time": "t"}``, for the joints in
        their order.
    kind : str, optional
        What command columns such as ``effort`` hold, ``"current"`` or ``"torque"``; by default judged by their names.

    Returns
    -------
    Experiment
        For :func:`gtau.identify`, :func:`gtau.check` and :func:`gtau.compare`; its ``guesses`` say what is assumed.

    Raises
    ------
    GtauError
        No columns are recognised, the robot is not known, or a guess would set the scale.

    Examples
    --------
    >>> gtau.draft(["empty_1.csv", "loaded_1200g.csv"], robot="five-bar")
    Experiment('five-bar', joints left, right, runs: 2, validation: 0)
    """
    if isinstance(logs, (str, Path)) or not logs or not all(isinstance(log, (str, Path)) for log in logs):
        raise GtauError("logs are a list of paths; give ['empty.csv', 'loaded.csv'].")
    if kind not in (None, "current", "torque"):
        raise GtauError(f"the kind of the commands is '{kind}'; write 'current' or 'torque'.")
    for log, mass in (payload or {}).items():
        expect(f"the payload of '{log}'", mass, NUMBER)
    for signal, pattern in (columns or {}).items():
        expect(f"the columns of '{signal}'", pattern, TEXT)
        if signal not in KINDS:
            raise GtauError(f"'columns' has the key '{signal}'; choose from {', '.join(KINDS)}.")
    paths = [Path(log) for log in logs]
    name = None if robot is None else str(robot)
    with python_words():
        made = drafted(paths, name, Stated(payload or {}, kind, preset, columns))  # type: ignore[arg-type]
    if made.urdf is not None:
        raise GtauError(f"{paths[0]} holds its robot, which is written beside a draft; run 'gtau init {paths[0]} ...'.")
    experiment = validate(Experiment, Document(DRAFTED, draft_text(made, HERE)), context=(HERE, HERE))
    assumed = guesses(made, DRAFTED)
    experiment._guesses = tuple(replace(guess, advice=in_python(guess.advice)) for guess in assumed)
    return experiment


def described(
    source: Any, runs: Sequence[Run] | None, robot: str | Path | None, payload: Mapping[str, float] | None, call: str
) -> Any:
    """Draft an experiment from logs; hand on anything else, which is refused where it is read."""
    if not isinstance(source, (list, tuple)):
        if robot or payload:
            raise GtauError("'robot' and 'payload' go with logs; give their paths, ['empty.csv', 'loaded.csv'].")
        if isinstance(source, str) and isinstance(runs, (list, tuple)) and isinstance(next(iter(runs), None), str):
            raise GtauError(f"logs are runs themselves; did you mean gtau.{call}(logs, robot={source!r})?")
        return source
    if any(isinstance(run, Run) for run in source):
        raise GtauError(f"runs go with their robot; did you mean gtau.{call}(gtau.load_robot(...), runs)?")
    if runs is not None:
        raise GtauError(f"logs are runs themselves; did you mean gtau.{call}(logs, robot=...)?")
    return draft(source, robot, payload)


def in_python(sentence: str) -> str:
    """Write the options of the command line that a sentence names as arguments in Python, except in its commands."""
    parts = re.split(r"('gtau [^']*'|gtau \w+ --\w+)", sentence)
    for option, argument in ARGUMENTS.items():
        parts[::2] = [re.sub(option, argument, part) for part in parts[::2]]
    return "".join(parts)


@contextmanager
def python_words() -> Iterator[None]:
    """Let a public function that no command calls name arguments in its refusals, not options."""
    try:
        yield
    except GtauError as error:
        raise type(error)(in_python(error.sentence), error.source) from None
