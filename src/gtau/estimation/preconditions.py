"""Preconditions of an identification, and its plan: which estimator runs, with which given gains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.util import find_spec
from itertools import combinations

import numpy as np

from gtau.errors import GtauError, missing_extra
from gtau.estimation.electrical import with_voltages
from gtau.estimation.estimators import estimator_of, estimators
from gtau.estimation.estimators.estimator import Estimator, Gains
from gtau.estimation.experiment_runs import Subject
from gtau.estimation.regression.dataset import Dataset, System, reduce_runs
from gtau.estimation.regression.priors import require_scale
from gtau.findings import Progress
from gtau.robots.parameter import parameter_of
from gtau.robots.robot import INERTIAL, Robot
from gtau.signals.preparation.filters import Preparation
from gtau.signals.reading.statements import Prior
from gtau.signals.run import Run

ALIKE = 1000  # samples that are compared before all are
LEVEL = 10_000  # samples that show the size of a signal
UNITS_APART = 100.0  # ratio of the rms commands of two runs, from which one is in mA; up to 1.4 in shared logs
OVERLAP = 0.25  # s; regular clocks of two parts that a dropout cuts may be as late as time stamps


def estimator_for(subject: Subject) -> Estimator:
    """Return the estimator asked for, or the default: ML, or as in the paper TLS, or WLS of torques; GtauError."""
    method = "wls" if subject.runs[0].kind == "torque" else "tls"
    return estimator_of(subject.options.method or (method if subject.options.as_paper else "ml"))


def require_inputs(subject: Subject) -> Estimator:
    """Check that the estimator takes what is given and has what it needs, before the logs are reduced; GtauError."""
    options, estimator = subject.options, estimator_for(subject)
    refuse_repeated(subject.runs)
    refuse_other_unit(subject.runs)
    if options.as_paper and not estimator.in_paper:
        methods = ", ".join(other.name for other in estimators().values() if other.in_paper)
        raise GtauError(
            f"the paper has no method '{estimator.name}'; leave out --as-paper, or choose from {methods} with it."
        )
    if options.consistent and not estimator.least_squares:
        raise GtauError(
            f"consistent parameters are found by least squares, which method '{estimator.name}' is not; use --method "
            "didim or ml with --consistent."
        )
    if options.consistent and not find_spec("clarabel"):
        raise missing_extra("a search for physically consistent parameters", "clarabel", "consistency")
    if not estimator.takes_priors:
        _refuse_priors(estimator, subject)
    if estimator.gains == Gains.GIVEN:
        given_gains(subject.robot, subject.runs, options.gains, estimator.name)
    return estimator


def refuse_repeated(runs: Sequence[Run]) -> None:
    """Refuse runs that hold the same samples, or overlapping parts of a log; raises GtauError."""
    for one, other in combinations(runs, 2):
        overlap = min(one.time[-1], other.time[-1]) - max(one.time[0], other.time[0])
        same_log = bool(one.log.paths) and one.log.paths == other.log.paths and overlap > max(OVERLAP, 2 / one.rate)
        alike = one.command.shape == other.command.shape and np.ptp(one.command[:ALIKE], axis=0).any()
        same = (alike and one.kind == other.kind) and all(
            np.array_equal(a[:ALIKE], b[:ALIKE]) and np.array_equal(a, b)
            for a, b in ((one.command, other.command), (one.position, other.position))
        )
        if same_log or same:
            declared = "it is declared with two loads" if one.payload != other.payload else "it would count twice"
            raise GtauError(
                f"runs '{one.name}' and '{other.name}' hold the same samples, so {declared}; remove one of them, or "
                "give the log that was meant."
            )


def refuse_other_unit(runs: Sequence[Run]) -> None:
    """Refuse runs whose currents, or torques, are far larger at all joints than in another run; raises GtauError."""
    commands = (run.command[:: len(run.time) // LEVEL + 1, : len(run.joints)] for run in runs)
    sizes = np.array([np.sqrt(np.mean(part**2, axis=0)) for part in commands])
    apart = np.min(sizes[:, None] / np.where(sizes > 0, sizes, np.inf), axis=2)
    high, low = map(int, np.unravel_index(np.argmax(apart), apart.shape))
    if apart[high, low] > UNITS_APART:
        large, small = (repr(runs[k].name) for k in (high, low))
        raise GtauError(
            f"the {runs[0].kind}s of run {large} are {apart[high, low]:.0f} times as large as in run {small} (rms), "
            "which looks like another unit; convert the columns of one log."
        )


Attempt = tuple[Estimator, np.ndarray | None]
"""An estimator, and the gains (n,) that it is given, N m/A or N per A; None where it finds them."""


def plan(subject: Subject, estimator: Estimator, dataset: Dataset, system: System) -> tuple[Attempt, ...]:
    """Plan an identification: what is tried in turn, each where the one before it found no gains.

    Where nothing tests the scale of logged torques it is set to 1, except by an estimator of gains that was asked for;
    data sheets, friction and the file's inertias test it only for the latter, as they may be rough. Raises GtauError if
    nothing fixes the scale of the currents, or the ``estimator`` lacks an input.
    """
    runs, named, tested = dataset.runs, subject.options.method is not None, False
    if estimator.gains != Gains.GIVEN:
        demanded = runs[0].kind == "current" or (named and estimator.gains == Gains.ESTIMATED)
        try:
            payloads = [run.payload for run in runs]
            require_scale(dataset.robot, system.problem, system.stated, payloads, estimator.name)
        except GtauError as refusal:
            if demanded:
                raise GtauError("; ".join([*map(str, dataset.remarks), str(refusal)])) from None
        else:
            tested = tests_torques(system, subject.stated)
            if demanded or (tested and named):
                return ((estimator, None),)
    given = estimator if named else estimator_of("wls")
    gains = given_gains(dataset.robot, runs, subject.options.gains, given.name)
    return ((estimator, None), (given, gains)) if tested else ((given, gains),)


def hidden_payloads(system: System) -> list[str]:
    """List the payloads of known mass that no torque shows, so that the scale of the torques is assumed."""
    known = [carried for carried in system.payloads if carried.payload.mass is not None]
    return list(dict.fromkeys(carried.payload.name for carried in known if not carried.shown))


def tests_torques(system: System, stated: Mapping[str, Prior]) -> bool:
    """Decide whether a known payload, a torque sensor, a wrench or a ``stated`` inertia tests the scale of torques."""
    problem = system.problem
    known = (carried for carried in system.payloads if carried.payload.mass is not None)
    by_file = set(system.dataset.priors) - set(system.dataset.stated_priors)
    inertias = [name for name in stated.keys() - by_file if parameter_of(name).kind in (*INERTIAL, "ia")]
    weighed = any(stated[name].value for name in inertias)  # a value of zero has no scale
    return weighed or any(load.acts for load in known) or bool(problem.wrenches) or not problem.unknown_gains.all()


def _refuse_priors(estimator: Estimator, subject: Subject) -> None:
    """Refuse torque sensors, known parameters and floating bases for an estimator that takes none; raises GtauError."""
    robot, runs = subject.robot, subject.runs
    takers = ", ".join(other.name for other in estimators().values() if other.takes_priors)
    inertias = dict(robot.inertias)
    valued = {name: prior.value for name, prior in subject.stated.items() if prior.value is not None}
    from_file = all(name in inertias and inertias[name] == value for name, value in valued.items())
    known = bool(valued) and not subject.options.consistent
    kinds = [channel.kind for channel in runs[0].channels]
    for what, key, there in (
        *((kind.group, kind.calibration, True) for kind in kinds if kind.measures_joint and kind.calibration),
        ("known parameters", "prior_inertias" if from_file else "priors", known),
        ("wrenches on bodies", "wrenches", any(body not in runs[0].base for body, _ in runs[0].wrenches)),
    ):
        if there:
            raise GtauError(
                f"method '{estimator.name}' takes no {what}, and '{key}' gives some; remove '{key}', or choose from "
                f"{takers} with --method."
            )
    if robot.floating:
        raise GtauError(
            f"method '{estimator.name}' does not support floating bases, and the base of robot '{robot.name}' floats; "
            f"choose from {takers} with --method."
        )


def reduced(
    subject: Subject, estimator: Estimator, progress: Progress, preparation: Preparation | None = None
) -> Dataset:
    """Reduce the runs, with the priors that the estimator uses as equations.

    Others use them only for consistent parameters. The inertias of the robot's file, where nothing else gives the scale
    of the gains, give the scale alone. Raises GtauError.
    """
    options = subject.options
    dataset = reduce_runs(
        subject.robot, subject.runs, preparation, "chebyshev" if options.as_paper else "fir", progress
    )
    priors = options.priors or {} if estimator.takes_priors else {}
    dataset = replace(dataset, priors=priors, prior_inertias=options.prior_inertias or 0.0)
    if estimator.takes_priors and not options.as_paper and dataset.runs[0].kind == "current":
        dataset = with_voltages(dataset, options.drives)
    demanded = estimator.gains != Gains.GIVEN and (options.method is not None or dataset.runs[0].kind == "current")
    payloads = any(run.payload is not None and run.payload.mass is not None for run in dataset.runs)
    tested = payloads or any(not channel.kind.unknown_gain for run in dataset.runs for channel in run.channels)
    if demanded and not (dataset.stated_priors or dataset.motors or tested):
        return replace(dataset, priors={})
    return dataset


def given_gains(robot: Robot, runs: Sequence[Run], prior_gains: Mapping[str, float], method: str) -> np.ndarray:
    """Return gains (n,): the prior ones, 1 for torques without; raises GtauError where currents have none."""
    exact = robot.actuated if runs[0].kind == "torque" else robot.base
    known = dict.fromkeys(exact, 1.0) | dict(prior_gains)
    missing = [joint for joint in robot.actuated if joint not in known]
    if missing:
        raise GtauError(
            f"method '{method}' needs a drive gain for every joint, and joint '{missing[0]}' has none; "
            "add 'prior_gains' to the experiment file, or use --method ml with a known payload."
        )
    return np.array([known[joint] for joint in robot.actuated])
