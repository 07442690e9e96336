"""Check the logs of an experiment before identification: list their contents and all faults."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cache
from typing import Literal

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.diagnose import Examination, estimates_of
from gtau.estimation.diagnostics.effort import MISFIT_TRIED, columns_of_effort, middle_rows
from gtau.estimation.diagnostics.geometry import GeometryTest
from gtau.estimation.diagnostics.log_checks import (
    command_lag,
    doubtful_commands,
    require_payload_excitation,
    smoothed_commands,
)
from gtau.estimation.diagnostics.units import doubtful_currents, doubtful_gravity, doubtful_payloads, units_and_signs
from gtau.estimation.diagnostics.verdict import unexplained_shares
from gtau.estimation.estimators.least_squares import fit_by
from gtau.estimation.estimators.maximum_likelihood import ml_or_wls
from gtau.estimation.experiment_runs import Options, Source, Subject, describe, geometry_of, read_runs, refusal_note
from gtau.estimation.preconditions import estimator_for, plan, reduced, require_inputs
from gtau.estimation.regression.assembly import FEWEST_ROWS, MORE_ROWS
from gtau.estimation.regression.dataset import preparation_of, robot_notes
from gtau.estimation.regression.plausibility import prepare_runs, sensors_of
from gtau.estimation.regression.rows import instants
from gtau.estimation.results.conclusions import near_singularities, not_separated
from gtau.estimation.results.estimate import NearestPose, distances_along, nearest_poses
from gtau.findings import Finding, Grade, Progress, by_severity, silent
from gtau.model.base_parameters import Equations
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.program import single_threaded_blas
from gtau.model.singularities import Distances, singular_distances
from gtau.robots.robot import Robot
from gtau.signals.preparation.bandwidth import JointSpectrum, moving_spectra, spectra
from gtau.signals.preparation.filters import Preparation
from gtau.signals.preparation.prepared_run import PreparedRun
from gtau.signals.reading.experiment import Experiment, LoggedRun
from gtau.signals.run import Run
from gtau.signals.storage import Store, block_size

WEIGHING = "weighing"  # kind of the note on logs without a payload of known mass


@dataclass(frozen=True, eq=False)
class JointCheck:
    """One joint of a log in motion, SI units; ``usable`` is the share of rows that identification uses."""

    joint: str
    position: tuple[float, float]
    speed_rms: float
    speed_max: float
    spectrum: JointSpectrum
    command_rms: float
    command_max: float
    usable: float

    @property
    def bandwidth(self) -> float:
        """Bandwidth of the motion, Hz, NaN at rest."""
        return self.spectrum.bandwidth


@dataclass(frozen=True, eq=False)
class WrenchCheck:
    """Wrench on a body of a log in motion: rms force (N), and rms moment (N m) about the origin of the axes."""

    body: str
    axes: Literal["world", "body"]
    force_rms: float
    moment_rms: float


@dataclass(frozen=True, eq=False)
class LogCheck:
    """One log: its joints, and positions (K, n), usable samples and distances (K,) at the decimated instants."""

    run: Run
    validation: bool
    joints: tuple[JointCheck, ...]
    wrenches: tuple[WrenchCheck, ...]
    position: np.ndarray
    used: np.ndarray
    distances: np.ndarray
    nearest: tuple[NearestPose, ...]
    preparation: Preparation

    def __repr__(self) -> str:
        return f"LogCheck({self.run.name!r}, {self.rows} rows a joint)"

    @property
    def rows(self) -> int:
        """Number of decimated samples."""
        return len(self.position)


@dataclass(frozen=True, eq=False)
class CheckedExperiment:
    """The readable logs of an experiment, their preparation, and ``notes`` on all findings.

    ``preparation`` is None where none of the logs for the identification can be read, ``geometry`` where no pose is
    logged.
    """

    robot: Robot
    preparation: Preparation | None
    logs: tuple[LogCheck, ...]
    notes: tuple[Finding, ...]
    geometry: GeometryTest | None = None

    def __repr__(self) -> str:
        counts = f"logs: {len(self.logs)}, notes: {len(self.notes)}, worst: {self.worst.value}"
        return f"ExperimentCheck({self.robot.name!r}, {counts})"

    @property
    def worst(self) -> Grade:
        """The grade of the worst finding."""
        return next(iter(by_severity(self.notes)), Grade.INFORMATION)


@single_threaded_blas()
def check(
    source: Source, runs: Sequence[Run] | None = None, options: Options | None = None, progress: Progress = silent
) -> CheckedExperiment:
    """Check the logs of an experiment; see :func:`gtau.check`. Raises GtauError."""
    subject = describe(source, runs, options)
    robot = subject.robot
    experiment = subject.experiment
    model = InverseDynamics(subject.robot)
    listed: tuple[LoggedRun | Run, ...] = tuple(subject.runs) if experiment is None else experiment.runs
    notes = robot_notes(robot, loaded=any(run.payload for run in listed))
    count = len(listed)
    listed = (*listed, *(experiment.validation if experiment else ()))
    kinds = ["refused"] * count + ["validation log"] * (len(listed) - count)
    read = list(_read(experiment, listed, kinds, model, notes, progress))
    used = [run for runs in read[:count] for run in runs]
    if not used:
        return CheckedExperiment(robot, None, (), tuple(notes))
    subject = replace(subject, runs=used)
    with _noted(notes):
        require_inputs(subject)
    notes += [*doubtful_commands(used, robot), *smoothed_commands(used), *doubtful_currents(used, robot.base)]
    notes += [*doubtful_gravity(robot), *doubtful_payloads(robot, (run.payload for run in used))]
    preparation = preparation_of(Equations(model, sensors_of(robot, used)), used)
    checked = []
    distances = cache(lambda: singular_distances(model))  # made once, where a run is so far without a fault
    for k, run in ((k, run) for k, runs in enumerate(read) for run in runs):
        progress("checking logs", k, len(read))
        with _noted(notes, kinds[k], run.name):
            (prepared,) = prepare_runs(model, [run], preparation)
            checked.append(_check(model, distances, prepared, validation=k >= count))
            notes += [note.from_source(run.name) for note in (*run.notes, *prepared.notes)]
            notes += near_singularities(checked[-1].nearest)
    progress("checking logs", len(read), len(read))
    geometry = None
    with _noted(notes):
        if experiment is not None:
            readable = [entry for entry, runs in zip(experiment.runs, read, strict=False) if runs]
            geometry = geometry_of(experiment, readable, model, progress)
            notes += [geometry.note] if geometry else []
    for_use = [log for log in checked if not log.validation]
    notes += few_rows(for_use)
    if not any(note.severity == Grade.ERROR for note in notes):
        known = {note.kind for note in notes}
        together = _together(replace(subject, runs=[log.run for log in for_use]), preparation, progress)
        notes += [note for note in together if not note.decisive or note.kind not in known]
    return CheckedExperiment(robot, preparation, tuple(checked), tuple(notes), geometry)


def _read(
    experiment: Experiment | None,
    listed: Sequence[LoggedRun | Run],
    kinds: Sequence[str],
    model: InverseDynamics,
    notes: list[Finding],
    progress: Progress,
) -> Iterator[tuple[Run, ...]]:
    """Read the runs of each entry that are not there yet; where they cannot be used there are none, with a note why."""
    for k, (entry, kind) in enumerate(zip(listed, kinds, strict=True)):

        def advance(what: str, done: int, total: int, k: int = k) -> None:
            progress(what, k * total + done, len(listed) * total)

        usable = list[Run]()
        with _noted(notes, kind):
            runs = (entry,) if isinstance(entry, Run) else read_runs(experiment, [entry], advance)  # type: ignore[arg-type]
            for run in runs:
                ordered = run.ordered(model.actuated)
                moving_spectra(ordered)
                usable.append(ordered)
        yield tuple(usable)


@contextmanager
def _noted(notes: list[Finding], kind: str = "refused", source: str = "") -> Generator[None]:
    """Note a refusal instead of raising it; what several logs have in common is listed once, with all their names."""
    try:
        yield
    except GtauError as error:
        notes.append(refusal_note(error, kind, source))


def few_rows(logs: Sequence[LogCheck]) -> Iterator[Finding]:
    """Find every joint that has fewer rows in all logs together than an identification needs."""
    for checks in zip(*(log.joints for log in logs), strict=True):
        rows = sum(round(joint.usable * log.rows) for joint, log in zip(checks, logs, strict=True))
        if rows < FEWEST_ROWS:
            joint = checks[0].joint
            text = f"joint '{joint}' has {rows} usable rows in all runs together, away from its reversals and gaps"
            yield Finding("usable rows", (joint,), text=text, advice=MORE_ROWS, grade=Grade.ERROR)


def _together(subject: Subject, preparation: Preparation, progress: Progress) -> list[Finding]:
    """List findings that need all runs together."""
    estimator = estimator_for(subject)
    dataset = reduced(subject, estimator, progress, preparation)
    system = dataset.system()
    notes = [*command_lag(dataset, system), *not_separated(system.unexcited)]
    payloads = [run.payload for run in dataset.runs if run.payload is not None]
    try:
        (_, gains), *_ = plan(subject, estimator, dataset, system)
    except GtauError as refusal:
        if not payloads or system.problem.scaled or any(payload.mass is not None for payload in payloads):
            return [*notes, refusal_note(refusal, "scale of the gains")]
        text = "no payload has a known mass, so these logs cannot give the drive gains"
        advice = f"weigh '{payloads[0].name}' with them (gtau payload MODEL.json)"
        return [*notes, Finding(WEIGHING, text=text, advice=advice, grade=Grade.INFORMATION)]
    if gains is None:  # they are estimated
        with _noted(notes, "model"):
            require_payload_excitation(system)
    with suppress(GtauError):  # of equations that only the friction selected for them can solve
        fit = fit_by(ml_or_wls(gains), system, gains is None)
        misfit = float(unexplained_shares(fit).max()) > MISFIT_TRIED
        if misfit and (misread := columns_of_effort(middle_rows(fit))):
            return [*notes, *misread]  # of such gains units and signs mean nothing
        estimates = estimates_of(fit, Examination(), correlated=False)
        notes += units_and_signs(fit, estimates, subject.options.gains, None)
    return notes


def _check(
    model: InverseDynamics, to_singular: Callable[[], Distances], prepared: PreparedRun, validation: bool
) -> LogCheck:
    run = prepared.run
    n = len(prepared.run.joints)
    decimator = prepared.preparation.decimator
    rows = decimator.outputs(len(prepared))
    if not rows:
        raise GtauError(f"run '{run.name}' is too short to be decimated by {decimator.factor}; give a longer log.")
    positions = Store((n,))
    distances = Store((2,), np.float32)
    masks = Store((n,), bool)
    power, path, ends = np.zeros(run.command.shape[1]), None, []
    for outputs in decimator.blocks(len(prepared), max(block_size() // decimator.factor, 1)):
        part = decimator.samples(outputs, len(prepared))
        at = decimator.at(outputs)
        samples = prepared.samples(part.start, part.stop)
        masks.append(decimator.keep(samples.usable[:, :n], outputs))
        q = samples.q[at].T.copy()
        labels = instants(run.name, samples.time[at])
        path = model.path(q, labels, None if path is None else path[:, -1])
        still = np.zeros_like(q)
        distances.append(to_singular()(model.rates(path, still, still, labels)).T)
        positions.append(samples.q[at])
        power += (samples.command[at] ** 2).sum(axis=0)
        largest = [np.abs(values).max(axis=0) for values in (samples.qd, samples.command[:, :n])]
        ends.append([samples.q.min(axis=0), samples.q.max(axis=0), *largest])
    values = distances.array()
    used = masks.array()
    rms = np.sqrt(power / rows)
    lowest = np.min(ends, axis=0)[0]
    highest, fastest, strongest = np.max(ends, axis=0)[1:]
    speeds = np.sqrt(np.diag(prepared.speeds))
    figures = np.stack([lowest, highest, speeds, fastest, rms[:n], strongest, used.mean(axis=0)], axis=1).tolist()
    joints = tuple(
        JointCheck(joint, (low, high), speed, speed_max, spectrum, *rest)
        for joint, spectrum, (low, high, speed, speed_max, *rest) in zip(run.joints, spectra(run), figures, strict=True)
    )
    return LogCheck(
        run=run,
        validation=validation,
        joints=joints,
        wrenches=tuple(_wrench_checks(run, (power / rows)[run.given])),
        position=positions.array(),
        used=used,
        distances=distances_along(prepared, decimator, values),
        nearest=tuple(nearest_poses(prepared, decimator, values)),
        preparation=prepared.preparation,
    )


def _wrench_checks(run: Run, squares: np.ndarray) -> Iterator[WrenchCheck]:
    """Describe the wrenches of a run by the mean ``squares`` (6 k,) of their components, moments first."""
    rms = np.sqrt(squares.reshape(-1, 2, 3).sum(axis=2)).tolist()
    for frame, (moment, force) in zip(run.wrenches, rms, strict=True):
        yield WrenchCheck(frame.body, "world" if frame.in_world else "body", force, moment)
