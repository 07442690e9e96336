"""Weighing payloads: unknown loads estimated with an identified robot (paper, section 5.2)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from gtau.documents.validation import FUNCTION, TEXT, takes
from gtau.errors import GtauError
from gtau.estimation.diagnostics.descriptions import other_loads
from gtau.estimation.diagnostics.scale import scale_uncertainty
from gtau.estimation.estimators.essential import select_friction
from gtau.estimation.estimators.estimator import Solution
from gtau.estimation.estimators.least_squares import fit_by, wls
from gtau.estimation.estimators.newton import degrees_of_freedom, solve as newton
from gtau.estimation.experiment_runs import Subject, options_of, read
from gtau.estimation.preconditions import given_gains, refuse_repeated
from gtau.estimation.regression.assembly import FEWEST_ROWS
from gtau.estimation.regression.dataset import Dataset, System, reduce_runs
from gtau.estimation.regression.priors import ReferenceModel
from gtau.estimation.regression.problem import Estimates, Problem
from gtau.estimation.results.build import payload_estimates
from gtau.estimation.results.estimate import TorqueError
from gtau.estimation.results.payload_body import PayloadEstimate
from gtau.estimation.results.result import IdentifiedModel
from gtau.findings import Finding, Grade, Progress, silent
from gtau.model.program import single_threaded_blas
from gtau.robots.parameter import TERMS, Parameter
from gtau.robots.robot import PLAIN_FRICTION, Robot
from gtau.signals.reading.experiment import Experiment
from gtau.signals.run import Run
from gtau.uses.identify import require_same
from gtau.uses.prediction import other_unit, predict

FRICTION_CHANGE = 0.2  # relative standard deviation of a model's friction on another day
GAIN_CHANGE = 0.03  # relative standard deviation of a gain on another day, where only one load is logged
MODEL_APART = 5.0  # mean square move of the model's parameters or gains, in their standard deviations: contradicted
WORSE = 3.0  # residual ratio above which an undeclared load is searched for


@takes(model=("the result of gtau.identify or gtau.load", (IdentifiedModel,)), gains=TEXT, progress=FUNCTION)
@single_threaded_blas()
def weigh(
    model: IdentifiedModel,
    source: str | Path | Experiment | Robot,
    runs: Sequence[Run] | None = None,
    gains: str = "identified",
    prior_gains: Mapping[str, float | Mapping[str, float]] | None = None,
    progress: Progress | None = None,
) -> tuple[PayloadEstimate, ...]:
    """Weigh the unknown payloads of an experiment by WLS, the robot re-identified from its runs without payload.

    Runs with a known payload are used only if no run is without payload, since a known mass would fix the scale
    whatever the gains. If the runs do not separate payload and robot, the parameters of the model do, with their
    covariance, and with gains and friction that may have changed.

    Parameters
    ----------
    model : IdentifiedModel
        Identified model: its gains, their uncertainty, and its preparation of the signals.
    source : path, Experiment or Robot
        An experiment file or the experiment read from it; or the robot, together with ``runs``. At least one run
        carries an unknown payload. A run with another load makes the intervals narrower.
    runs : sequence of Run, optional
        From :func:`gtau.read_run`; only with a robot.
    gains : {"identified", "prior"}
        The model's gains, or the prior ones (the paper's cases 2 and 1).
    prior_gains : mapping, optional
        Joint to gain, N m/A or N per A, or to a mapping with its standard deviation such as
        ``{"value": 2.4, "std": 0.1}``; the experiment file's if left out.
    progress : callable, optional
        Called as the work goes on.

    Returns
    -------
    tuple of PayloadEstimate
        One for each run with an unknown payload. The standard deviations include the uncertainty of the gains where it
        is known (see :func:`gtau.uses.weigh.exact_gains`). The verdict is contradictory if the interval of the mass
        lies below zero, or if the log contradicts the model.

    Raises
    ------
    GtauError
        If a file is wrong or describes another robot, or the runs cannot separate the payload from the robot.

    Examples
    --------
    >>> result = gtau.load("result/model.json")
    >>> empty = gtau.read_run("empty_2.csv", result.recording.signals)
    >>> unknown = gtau.read_run("unknown.csv", result.recording.signals, payload={"name": "load"})
    >>> (load,) = gtau.weigh(result, result.robot, [empty, unknown])
    >>> print(f"{load.parameters['m']:.1f} kg")
    0.7 kg
    """
    if gains not in ("identified", "prior"):
        raise GtauError(f"gains is '{gains}'; write 'identified' or 'prior'.")
    progress, is_path = progress or silent, isinstance(source, (str, Path))
    subject = read(source, runs, options_of(prior_gains), progress)
    where = f"{source}: " if is_path else ""
    require_same(model, subject.robot, subject.runs[0].kind, str(source) if is_path else "this experiment")
    if not any(run.payload is not None and run.payload.mass is None for run in subject.runs):
        raise GtauError(f"{where}no run has an unknown payload; leave out 'mass' of the payload to be weighed.")
    refuse_repeated(subject.runs)
    bare = any(run.payload is None for run in subject.runs)
    chosen = [run for run in subject.runs if run.payload is None or run.payload.mass is None or not bare]
    rows = _gain_rows(model)
    g_tau, covariance = model.gains, model.covariance[np.ix_(rows, rows)]
    if gains == "prior":
        g_tau, covariance = _prior_gains(model, subject, where)
    dataset = _reduced(model, chosen, progress)
    moving = sum(factor.rows.sum(axis=0) for factor in dataset.factors) >= FEWEST_ROWS
    if not np.any(moving):
        raise GtauError(
            f"{where}the robot stands still in all runs, where friction may hold any part of the load; log the moves "
            "between the poses too, in one log."
        )
    if not np.all(moving) and gains == "identified":
        dataset = replace(dataset, reference=reference_of(model))
    system = _separating(model, dataset, g_tau, gains == "identified", where, progress)
    by_model = system.dataset.reference is not None
    solver = _with_gains_of_today if by_model else wls
    solution = solver(system.problem, g_tau)
    total = solution.jackknife + scale_uncertainty(system, partial(solver, gains=g_tau))
    if covariance.any():
        slopes = _slopes(model, system, solver, solution, g_tau)
        total = total + slopes @ covariance @ slopes.T
    none = np.zeros_like(total)
    freedom = degrees_of_freedom(system.problem, solution, by_model)
    vector = Estimates(system.problem.unknowns, solution.values, total, none, none, freedom)
    wrong = _unlike_predictions(model, chosen[0]) or (_contradiction(system, solution, g_tau) if by_model else None)
    judged = {} if wrong is None else {run.payload.name: wrong for run in chosen if run.payload}
    return tuple(
        replace(payload, weighed=payload.weighed and replace(payload.weighed, by_model=by_model))
        for payload in payload_estimates(system, vector, judged)
        if "m" not in payload.known
    )


def _unlike_predictions(model: IdentifiedModel, run: Run) -> Finding | None:
    """Find columns of another sign or unit in a run, where it is long enough for predictions."""
    try:
        return other_unit(predict(model, replace(run, payload=None)), run.kind)
    except GtauError:
        return None


def _contradiction(system: System, solution: Solution, gains: np.ndarray) -> Finding | None:
    """Judge by how much the log moves the parameters and ``gains`` (n,) of the model; None if it fits."""
    rows = system.problem.known
    changes = solution.gains[: len(gains)] / gains - 1  # rows of the model alone
    moves = (rows[:, :-1] @ solution.theta - rows[:, -1], changes / GAIN_CHANGE)
    apart = max(float(np.mean(move**2)) for move in moves)
    if apart <= MODEL_APART:
        return None
    return Finding(
        "log apart from the model",
        text="the log contradicts the model, whose parameters it would move by "
        f"{np.sqrt(apart):.2g} standard deviations (rms)",
        advice="add a log without payload of the same day; check signs, units and zeros of its columns, and that the "
        "robot is mounted as before; otherwise identify the robot again, as torque constants fall while motors warm up",
        grade=Grade.CONTRADICTORY,
    )


def _gain_rows(model: IdentifiedModel) -> list[int]:
    return [model.covariance_names.index(Parameter("gain", joint)) for joint in model.robot.actuated]


def _prior_gains(model: IdentifiedModel, subject: Subject, where: str) -> tuple[np.ndarray, np.ndarray]:
    """Return prior gains (n,) and their covariance (n, n), zero where none is stated; raises GtauError without any."""
    if model.kind == "current" and not subject.options.gains:
        raise GtauError(f"{where}there are no 'prior_gains'; add them, or weigh with the identified gains.")
    stated = subject.options.prior_gains or {}
    stds = [stated[joint].std if joint in stated else None for joint in model.robot.actuated]
    gains = given_gains(model.robot, subject.runs, subject.options.gains, "wls")
    return gains, np.diag([(std or 0.0) ** 2 for std in stds])


def _reduced(model: IdentifiedModel, runs: Sequence[Run], progress: Progress) -> Dataset:
    ordered = tuple(run.ordered(run.joints, link_side=False) for run in runs)  # the model's gains say as much
    preparation = model.preparation.at(min(run.rate for run in runs))
    return reduce_runs(model.robot, ordered, preparation, progress=progress, model=model.idm)


def _slopes(
    model: IdentifiedModel,
    system: System,
    solver: Callable[[Problem, np.ndarray], Solution],
    solution: Solution,
    gains: np.ndarray,
) -> np.ndarray:
    """Compute the derivatives (k, n) of the estimates by the ``gains`` (n,), which move a reference too."""
    steps, moved, dataset = 1e-4 * gains, [], system.dataset
    for step in np.diag(steps):
        known = None if dataset.reference is None else reference_of(model, step)
        problem = system.problem if known is None else system.again(replace(dataset, reference=known)).problem
        moved.append(solver(problem, gains + step).values)
    return np.asarray((np.stack(moved, axis=1) - solution.values[:, None]) / steps)


def _with_gains_of_today(problem: Problem, gains: np.ndarray) -> Solution:
    """Estimate the gains too, and combine them with the model's (n,), which are known to ``GAIN_CHANGE``."""
    solution = newton(problem, wls(problem, gains).values, problem.weights, True)
    at = np.arange(len(solution.values))[solution.unknowns.gains][: len(gains)]
    prior = GAIN_CHANGE**2 * np.outer(gains, gains) * (1 + np.eye(len(gains)))
    covariance = solution.jackknife
    K = covariance[:, at] @ np.linalg.inv(covariance[np.ix_(at, at)] + prior)
    kept = np.eye(len(solution.values))
    kept[:, at] -= K
    return replace(
        solution,
        values=solution.values + K @ (gains - solution.values[at]),
        replicates=lambda: solution.replicates() @ kept.T,
        prior_covariance=kept @ np.asarray(solution.prior_covariance) @ kept.T + K @ prior @ K.T,
    )


def _separating(
    model: IdentifiedModel, dataset: Dataset, gains: np.ndarray, may_refer: bool, where: str, progress: Progress
) -> System:
    """Select friction; refer to the model if the runs do not separate the payload; raises GtauError."""
    solve = partial(wls, gains=gains)
    system = select_friction(dataset, solve, progress)
    if _lost(system) and may_refer:
        system = select_friction(replace(dataset, reference=reference_of(model)), solve, progress)
    if _lost(system):
        raise GtauError(
            f"{where}the runs cannot separate the payload from the robot itself; add a run without payload, or "
            "with a payload whose parameters are all known."
        )
    return system


def _lost(system: System) -> bool:
    return any(name in system.unexcited for carried in system.payloads for name in carried.unknown)


def reference_of(model: IdentifiedModel, step: np.ndarray | float = 0.0) -> ReferenceModel:
    """Take a model's parameters as known at its gains, moved by a ``step`` (n,); friction may have changed."""
    known = {**model.parameters, **model.friction}
    names = tuple(name for name in model.covariance_names if name in known and known[name].value is not None)
    rows = list(map(model.covariance_names.index, names))
    gains = _gain_rows(model)
    between = model.covariance[np.ix_(rows, gains)]
    slopes = between @ np.linalg.pinv(model.covariance[np.ix_(gains, gains)], rcond=1e-9, hermitian=True)
    theta = np.array([known[name].value for name in names])
    is_friction = np.array([name.kind in (*PLAIN_FRICTION, *TERMS) for name in names])
    more = (FRICTION_CHANGE * theta * is_friction) ** 2 + (1e-6 * np.abs(theta) + 1e-12) ** 2
    covariance = model.covariance[np.ix_(rows, rows)] - slopes @ between.T + np.diag(more)
    return ReferenceModel(names, theta + slopes @ np.broadcast_to(step, len(gains)), covariance)


def undeclared_load(
    model: IdentifiedModel, run: Run, errors: Sequence[TorqueError], progress: Progress
) -> Finding | None:
    """Find an undeclared body at the tool if the ``errors`` of a run are ``WORSE`` than in identification."""
    usual = {residual.joint: residual.rms for residual in model.residuals if residual.rms}
    ratios = [error.rms / usual[error.joint] for error in errors if error.joint in usual and error.rms]
    if not ratios or np.mean(np.log(ratios)) < np.log(WORSE):
        return None
    solve = partial(wls, gains=model.gains)
    dataset = replace(_reduced(model, [run], progress), reference=reference_of(model))
    try:
        load = other_loads(fit_by(solve, select_friction(dataset, solve, progress), free_gains=False))
    except GtauError:  # too few usable samples; the prediction holds without
        return None
    if load is None:
        return None
    return Finding(
        "description refuted",
        load.cause.joints,
        text=f"{load.subject} would explain {100 * load.share:.0f} % of the residual variance",
        advice=load.cause.advice,
        causes=(load.cause.kind,),
        grade=Grade.CONTRADICTORY,
    )


def exact_gains(model: IdentifiedModel, experiment: Experiment, gains: str) -> tuple[str, ...]:
    """List the joints whose gain counts as exact, as its standard deviation is unknown."""
    if gains != "prior":
        return tuple(joint for joint, gain in model.drive_gains.items() if gain.std is None)
    known = {joint for joint, gain in experiment.stated_gains.items() if gain.std is not None}
    return tuple(joint for joint in experiment.signals.joints if joint not in known)
