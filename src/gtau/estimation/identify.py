"""Identify a robot: from an experiment to a result."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gtau.display import late
from gtau.documents.validation import FUNCTION, NUMBER, TEXT, TRUTH, takes
from gtau.errors import GtauError
from gtau.estimation.diagnostics.finding import Finding
from gtau.estimation.diagnostics.finding import FindingKind as F
from gtau.estimation.diagnostics.log_checks import command_lag, require_felt_payload
from gtau.estimation.diagnostics.sentences import note
from gtau.estimation.diagnostics.verdict import Outcome
from gtau.estimation.estimators.estimator import Estimator, Given
from gtau.estimation.estimators.registry import ESTIMATORS, estimator_of
from gtau.estimation.experiment_runs import geometry_of, read_runs, subject_of
from gtau.estimation.gate import (
    choose_estimator,
    given_gains,
    require_identifiable,
    require_inputs,
    usable,
)
from gtau.estimation.pipeline import estimate
from gtau.estimation.regression.dataset import reduce_runs
from gtau.estimation.regression.friction import Friction
from gtau.estimation.results.estimate import Requirement, TorqueError
from gtau.estimation.results.result import Result
from gtau.estimation.thresholds.estimates import ACCURACY
from gtau.model.interpreter.program import single_threaded_blas
from gtau.progress import Progress, silent
from gtau.robots.parameter import Parameter
from gtau.robots.robot import Robot
from gtau.signals.notes import Note
from gtau.signals.reading.experiment import Experiment
from gtau.signals.reading.statements import Drive, Prior, Requirements, data_sheet_notes
from gtau.signals.run import Run


@takes(
    method=TEXT,
    ratio=NUMBER,
    prior_inertias=NUMBER,
    as_paper=TRUTH,
    consistent=TRUTH,
    accuracy=NUMBER,
    progress=FUNCTION,
)
def identify(
    source: str | Path | Experiment | Robot,
    runs: Sequence[Run] | None = None,
    method: str | None = None,
    prior_gains: Mapping[str, float] | None = None,
    ratio: float | None = None,
    as_paper: bool = False,
    consistent: bool = False,
    priors: Mapping[str, Prior | Mapping[str, Any]] | None = None,
    accuracy: float = ACCURACY,
    progress: Progress = silent,
    prior_inertias: float | None = None,
) -> Result:
    """Identify drive gains and dynamic parameters.

    Parameters
    ----------
    source : path, Experiment or Robot
        An experiment file or the experiment read from it; or a robot, together with ``runs``.
    runs : sequence of Run, optional
        From :func:`gtau.read_run`; only with a robot.
    method : str, optional
        A name of :data:`gtau.estimation.estimators.registry.NAMES`; docs/lookup/verdicts.md describes each, and when
        to choose it. If left out, maximum likelihood ("ml"), or least squares with given gains ("wls") where logs hold
        torques and nothing tests their scale; with ``as_paper`` the paper's total least squares ("tls"), "wls" of
        torques.
    prior_gains : mapping, optional
        Joint to gain, N m/A or N/A, of torques the factor that makes them true; the experiment file's if left out.
    ratio : float, optional
        The paper's r_sigma for the essential parameters; if left out, the Bayesian information criterion decides
        which base parameters are cancelled.
    as_paper : bool
        Follow the paper step by step: its TLS (or WLS or OLS), its decimation filter, its friction, no delays,
        standard errors by formula, and the essential parameters re-estimated together with the gains at ratio 10.
        (Samples near reversals are left out all the same: with them TLS fails.)
    consistent : bool
        Also find standard parameters that rigid bodies can have (see
        :mod:`gtau.estimation.estimators.physical_consistency`).
    priors : mapping, optional
        Priors on standard and base parameters, by name, as :class:`gtau.Prior` or as a mapping like those of
        the experiment file (``{"value": 1.2, "std": 0.4}``); the experiment file's if left out.
    accuracy : float
        Half the relative width of the 95 % interval up to which a gain is good, 0.03 for 3 %.
    progress : callable, optional
        Called as the work goes on.
    prior_inertias : float, optional
        Take the inertias of the robot's file (URDF or MJCF) as priors with this relative standard deviation, 0.3 for
        30 %; the experiment file's if left out.

    Returns
    -------
    Result
        Drive gains, parameters, payloads and verdicts; ``print(result.summary())`` shows them.

    Raises
    ------
    GtauError
        If a file is wrong, the data cannot be used, or they lack an input of the method.
    """
    if method is not None:
        estimator_of(method)  # before logs are read
    if not 0 < accuracy <= 0.5:
        raise GtauError(f"an accuracy of {accuracy:g} cannot be asked for; write 0.03 for 3 %.")
    if ratio is not None and not ratio >= 1:
        raise GtauError(f"a ratio of {ratio:g} cannot be asked for; write one of the paper's, 10 to 30.")
    subject = subject_of(source, runs, prior_gains, priors, progress, prior_inertias)
    robot, experiment, known = subject.robot, subject.experiment, subject.priors
    estimator = choose_estimator(method, subject.runs, as_paper)
    _check_combination(estimator, as_paper, consistent)
    gains = require_inputs(estimator, robot, subject.runs, subject.prior_gains, subject.stated, consistent)
    with single_threaded_blas():
        dataset = reduce_runs(
            robot,
            subject.runs,
            decimator="chebyshev" if as_paper else "fir",
            progress=progress,
            priors=usable(estimator, known),
            prior_inertias=subject.prior_inertias,
        )
        system = dataset.system(Friction())
        estimator, gains = require_identifiable(
            estimator, gains, dataset, system, method is not None, subject.prior_gains
        )

        def run(by: Estimator, given: np.ndarray | None) -> Result:
            try:
                result = estimate(
                    dataset,
                    by,
                    Given(given, known, progress),
                    subject.prior_gains,
                    consistent,
                    as_paper,
                    ratio,
                    accuracy,
                )
            except GtauError:
                require_felt_payload(system)
                raise
            outcomes = {gain.verdict.outcome for gain in result.drive_gains.values()}
            if outcomes <= {Outcome.CONTRADICTORY, Outcome.NOT_IDENTIFIABLE}:
                require_felt_payload(system)
            return result

        if method is None and gains is None and dataset.runs[0].kind == "torque":
            result = _tested(run, estimator, given_gains(robot, subject.runs, subject.prior_gains, "wls"))
        else:
            result = run(estimator, gains)
        geometry = geometry_of(experiment, experiment.runs, dataset.model, progress) if experiment else None
        found = [*([geometry.note] if geometry else []), *map(note, command_lag(dataset, system))]
        notes = (*found, *_data_sheet_notes(experiment.drives if experiment else {}, result), *result.notes)
        result = result.replaced(geometry=geometry, notes=notes)
        result = late("uses.prediction").with_prediction_cutoffs(result, dataset.runs)
        return _judged(result, experiment, progress)


def _tested(
    run: Callable[[Estimator, np.ndarray | None], Result], estimator: Estimator, otherwise: np.ndarray
) -> Result:
    """Identify with the scale of the torques, or with the gains (n,) that are given where the runs do not show it."""
    try:
        result = run(estimator, None)
        if {gain.verdict.outcome for gain in result.drive_gains.values()} != {Outcome.NOT_IDENTIFIABLE}:
            return result
        joint, gain = next(iter(result.drive_gains.items()))
        why = f"that of no joint is identifiable ('{joint}': {gain.verdict.why})"
    except GtauError as error:
        why = str(error).rstrip(".")
    result = run(estimator_of("wls"), otherwise)
    return result.replaced(notes=(note(Finding(F.SCALE_UNTESTED, values={"why": why})), *result.notes))


def _judged(result: Result, experiment: Experiment | None, progress: Progress) -> Result:
    """Compare a result with what its experiment requires."""
    if experiment is None:
        return result
    tested = experiment.validation if experiment.require.torque_error is not None else ()
    validation = read_runs(experiment, tested, progress)
    return result.replaced(requirements=tuple(_requirements(result, experiment.require, validation)))


def _requirements(result: Result, require: Requirements, validation: Sequence[Run]) -> Iterator[Requirement]:
    """Compare with the limits, those of torque errors also on the runs kept for ``validation``."""
    if require.torque_error is not None:
        yield _of_torques(require.torque_error, result.residuals)
        for run in validation:
            try:
                errors = result.validate(run)
            except GtauError:
                errors = ()
            yield _of_torques(require.torque_error, errors, run.name)
    if require.gain_interval is not None:
        widths = {joint: gain.half_width for joint, gain in result.drive_gains.items()}
        unknown = [joint for joint, width in widths.items() if width is None]
        joint = unknown[0] if unknown else max(widths, key=lambda name: widths[name] or 0.0)
        yield Requirement("gain_interval", require.gain_interval, widths[joint], joint)


def _of_torques(limit: float, errors: Iterable[TorqueError], run: str = "") -> Requirement:
    worst = max(errors, key=lambda each: each.relative, default=None)
    if worst is None:
        return Requirement("torque_error", limit, None, run=run)
    return Requirement("torque_error", limit, worst.relative, worst.joint, run)


def _data_sheet_notes(drives: Mapping[str, Drive], result: Result) -> tuple[Note, ...]:
    gains = {Parameter("gain", joint): gain for joint, gain in result.drive_gains.items() if gain.std is not None}
    estimates = gains | dict(result.parameters)
    values = {str(name): (estimate.value, estimate.std) for name, estimate in estimates.items()}
    return data_sheet_notes(drives, result.robot, values)


def _check_combination(estimator: Estimator, as_paper: bool, consistent: bool) -> None:
    if as_paper and not estimator.in_paper:
        of_paper = ", ".join(each.name for each in ESTIMATORS.values() if each.in_paper)
        raise GtauError(
            f"the paper has no method '{estimator.name}'; leave out --as-paper, or choose from {of_paper} with it."
        )
    if consistent and not estimator.least_squares:
        raise GtauError(
            f"consistent parameters are found by least squares, which method '{estimator.name}' is not; use --method "
            "didim or ml with --consistent."
        )
