"""Subject of an identification: what is asked, and a robot with its runs, from a file or given in Python."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite
from pathlib import Path
from typing import Any

from gtau.documents.validation import MAPPING, NUMBER, expect, read_group
from gtau.errors import GtauError, UnknownName, meant
from gtau.estimation.diagnostics.geometry import GeometryTest
from gtau.estimation.estimators import estimator_of
from gtau.estimation.regression.priors import inertia_priors
from gtau.findings import Finding, Grade, Progress, silent
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.robot import Robot
from gtau.signals.reading.experiment import Experiment, LoggedRun, check_robot, read_experiment
from gtau.signals.reading.statements import Drive, Prior, StatedGain, as_priors
from gtau.signals.run import Run, read_parts

ACCURACY = 0.03  # half the relative width of a gain's 95 % interval

OF_RUNS = "the runs of a robot are a list of runs; read each log with gtau.read_run."


@dataclass(frozen=True, eq=False)
class Options:
    """What is asked of an identification; None stands for the experiment file's own gains and priors."""

    method: str | None = None
    as_paper: bool = False
    consistent: bool = False
    accuracy: float = ACCURACY
    ratio: float | None = None
    prior_gains: Mapping[str, StatedGain] | None = None
    priors: Mapping[str, Prior] | None = None
    prior_inertias: float | None = None
    drives: Mapping[str, Drive] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.method is not None:
            estimator_of(self.method)  # before logs are read
        if not 0 < self.accuracy <= 0.5:
            raise GtauError(f"an accuracy of {self.accuracy:g} cannot be asked for; write 0.03 for 3 %.")
        if self.ratio is not None and not self.ratio >= 1:
            raise GtauError(f"a ratio of {self.ratio:g} cannot be asked for; write one of the paper's, 10 to 30.")

    @property
    def gains(self) -> dict[str, float]:
        """Values of the prior gains, N m/A or N per A, by joint."""
        return {joint: stated.value for joint, stated in (self.prior_gains or {}).items()}


def options_of(
    prior_gains: Mapping[str, float | Mapping[str, float]] | None = None,
    priors: Mapping[str, Prior | Mapping[str, Any]] | None = None,
    **asked: Any,
) -> Options:
    """Read prior knowledge given in Python, beside what else is asked, by name; raises GtauError."""
    options = Options(**asked)
    return replace(
        options,
        prior_gains=None if prior_gains is None else _as_gains(prior_gains),
        priors=None if priors is None else as_priors(priors),
    )


@dataclass(frozen=True, eq=False)
class Subject:
    """A robot with its runs, what is asked, and its ``experiment`` if it comes from a file."""

    robot: Robot
    runs: Sequence[Run]
    options: Options
    experiment: Experiment | None = None

    @property
    def stated(self) -> Mapping[str, Prior]:
        """Priors on parameters, without the priors from data sheets."""
        known = self.options.priors or {}
        if self.experiment is None:
            return known
        written = self.experiment.priors
        sheets = self.experiment.expected_parameters
        return {name: prior for name, prior in known.items() if name in written or sheets.get(name) != prior}


Source = str | Path | Experiment | Robot  # an experiment file, what it holds, or a robot, which comes with its runs


def read(source: Source, runs: Sequence[Run] | None, options: Options, progress: Progress = silent) -> Subject:
    """Read an experiment, or take a robot with its runs; options replace its own entries; raises GtauError."""
    subject = describe(source, runs, options)
    if subject.experiment is None:
        return subject
    return replace(subject, runs=read_runs(subject.experiment, subject.experiment.runs, progress))


def describe(source: Source, runs: Sequence[Run] | None = None, options: Options | None = None) -> Subject:
    """Do as :func:`read`, but leave the logs of an experiment unread."""
    options = options or Options()
    if isinstance(source, Robot):
        if runs is not None and (isinstance(runs, Run) or not isinstance(runs, Iterable)):
            raise GtauError(OF_RUNS)
        if not (runs := tuple(() if runs is None else runs)):
            raise GtauError("a robot alone cannot be identified; give its runs too.")
        if not all(isinstance(run, Run) for run in runs):
            raise GtauError(OF_RUNS)
        return Subject(source, runs, _for_robot(options, source))
    if runs is not None:
        given = "an experiment" if isinstance(source, Experiment) else f"'{source}'"
        named = "gtau.load_robot(...)" if isinstance(source, Experiment) else f"gtau.load_robot({str(source)!r})"
        raise GtauError(f"runs are given beside {given}; give their robot, {named}, or an experiment file alone.")
    if not isinstance(source, (str, Path, Experiment)):
        raise GtauError(
            f"an object of type {type(source).__name__} cannot be identified; give the path of an experiment file, or "
            "a robot (gtau.load_robot) with its runs."
        )
    experiment = source if isinstance(source, Experiment) else read_experiment(source)
    robot = load_robot(experiment.robot)
    check_robot(experiment, robot)
    priors, inertias = options.priors, options.prior_inertias
    options = replace(
        options,
        prior_gains=experiment.stated_gains if options.prior_gains is None else options.prior_gains,
        priors=experiment.expected_parameters if priors is None else priors,
        prior_inertias=experiment.prior_inertias if inertias is None else inertias,
        drives=experiment.drives,
    )
    return Subject(robot, (), _for_robot(options, robot), experiment)


def _for_robot(options: Options, robot: Robot) -> Options:
    """Check the names of prior gains, and add priors of the file's inertias."""
    if unknown := next((joint for joint in options.prior_gains or {} if joint not in robot.actuated), None):
        hint = meant(unknown, robot.actuated, f"its joints with a motor are {', '.join(robot.actuated)}.")
        raise UnknownName(f"'prior_gains' names '{unknown}', which robot '{robot.name}' does not have; {hint}")
    if options.prior_inertias is None:
        return options
    return replace(options, priors={**inertia_priors(robot, options.prior_inertias), **(options.priors or {})})


def _as_gains(gains: Mapping[str, float | Mapping[str, float]]) -> dict[str, StatedGain]:
    expect("'prior_gains'", gains, MAPPING)
    stated = {}
    for joint, gain in gains.items():
        name = f"prior gain of joint '{joint}'"
        std = None
        if isinstance(gain, Mapping):
            group = read_group(StatedGain, name, gain)
            gain, std = group.value, group.std
        expect(f"the {name}", gain, NUMBER)
        if not isfinite(gain) or gain == 0:
            raise GtauError(f"the {name} is {gain:g}; give its N m/A (or N per A).")
        stated[str(joint)] = StatedGain(value=float(gain), std=std)
    return stated


def read_runs(experiment: Experiment, runs: Sequence[LoggedRun], progress: Progress = silent) -> tuple[Run, ...]:
    """Read logged runs of an experiment file, each part between long gaps as a run of its own; raises GtauError."""
    settings = experiment.preparation
    parts, read = 1000, list[Run]()  # parts of a run
    for k, run in enumerate(runs):

        def advance(done: float, k: int = k) -> None:
            progress("reading logs", round(parts * (k + done)), parts * len(runs))

        read += read_parts(run.log, experiment.signals, run.payload, experiment.units, advance, settings, run)
    return tuple(read)


def read_validation(experiment: Experiment, progress: Progress = silent) -> tuple[list[Run], list[Finding]]:
    """Read the runs kept for validation, with a note on each log that cannot be used."""
    runs, notes = list[Run](), list[Finding]()
    for entry in experiment.validation:
        try:
            runs += read_runs(experiment, [entry], progress)
        except GtauError as error:
            notes.append(refusal_note(error, "validation log"))
    return runs, notes


MILD = ("validation log", "model")  # kinds of refusals that do not keep the logs from being used


def refusal_note(error: GtauError, kind: str, source: str = "") -> Finding:
    """Note a refusal instead of raising it, of a run or robot named ``source`` where its sentence names none."""
    text, _, advice = error.sentence.rstrip(".").rpartition("; ")
    text, advice = (text, advice) if text else (advice, "")
    grade = Grade.WARNING if kind in MILD else Grade.ERROR
    source = error.source or ("" if source in text else source)
    return Finding(kind, text=text, advice=advice, grade=grade, source=source)


def geometry_of(
    experiment: Experiment, runs: Sequence[LoggedRun], model: InverseDynamics, progress: Progress = silent
) -> GeometryTest | None:
    """Test the robot's geometry against the logged poses; None if no pose is logged. Raises GtauError."""
    signals = experiment.signals
    if signals.pose is None:
        return None
    from gtau.estimation.diagnostics.pose_fit import geometry_test
    from gtau.signals.reading.logs import read_poses

    logged = [read_poses(run.log, signals, experiment.units, run) for run in runs]
    return geometry_test(model, signals.pose, signals.joints, logged, progress)
