"""From an experiment to a result: what is to be identified, from which runs, and how."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.log_checks import command_lag, require_felt_payload
from gtau.estimation.diagnostics.sentences import note
from gtau.estimation.diagnostics.verdict import Outcome
from gtau.estimation.estimators.estimator import Estimator, Gains, Given
from gtau.estimation.estimators.registry import ESTIMATORS, estimator_of
from gtau.estimation.experiment_runs import geometry_of, read_runs
from gtau.estimation.pipeline import AS_PAPER, DEFAULT, estimate
from gtau.estimation.regression.dataset import reduce_runs
from gtau.estimation.regression.friction import Friction
from gtau.estimation.regression.scale_source import require_scale
from gtau.estimation.results.result import Result
from gtau.estimation.thresholds.estimates import ACCURACY
from gtau.model.home import load_robot
from gtau.model.interpreter.threads import single_threaded_blas
from gtau.progress import Progress, silent
from gtau.robots.parameter import Parameter
from gtau.robots.robot import Robot
from gtau.signals.data_sheets import Drive, data_sheet_notes
from gtau.signals.experiment import Experiment, Prior, check_robot, read_experiment
from gtau.signals.notes import Note
from gtau.signals.run import Run


def identify(
    source: str | Path | Experiment | Robot,
    runs: Sequence[Run] | None = None,
    method: str | None = None,
    prior_gains: Mapping[str, float] | None = None,
    ratio: float | None = None,
    as_paper: bool = False,
    consistent: bool = False,
    priors: Mapping[str, Prior] | None = None,
    accuracy: float = ACCURACY,
    progress: Progress = silent,
) -> Result:
    """Identify drive gains and dynamic parameters.

    Parameters
    ----------
    source : path, Experiment or Robot
        An experiment file, or what was read of it; or a robot, together with ``runs``.
    runs : sequence of Run, optional
        From :func:`gtau.read_run`; only with a robot.
    method : {"ml", "huber", "ridge", "iv", "didim", "2sls", "tls", "wls", "ols"}
        Maximum likelihood (as it is, with Huber's weights against outliers, or with natural sizes of what is left
        open), instrumental variables and DIDIM (against noise of the encoders), 2SLS and the paper's TLS
        find the drive gains from a known payload, all but IV and TLS also from torque sensors and ``priors``;
        weighted and ordinary least squares take ``prior_gains``, or torques. If left out, "wls" where logs hold
        torques, else "ml", or "tls" with ``as_paper``.
    prior_gains : mapping, optional
        Joint to gain, N m/A or N/A; the experiment file's if left out.
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
        What is known of standard and base parameters, by name; the experiment file's if left out.
    accuracy : float
        Half the relative width of the 95 % interval up to which a gain is good, 0.03 for 3 %.
    progress : callable, optional
        Called as the work goes on.

    Returns
    -------
    Result
        Drive gains, parameters, payloads and verdicts; ``print(result.summary())`` shows them.

    Raises
    ------
    GtauError
        Where a file is wrong, the data cannot be used, or they cannot give what the method asks for.
    """
    options = AS_PAPER if as_paper else DEFAULT
    options = replace(options, accuracy=accuracy, ratio=options.ratio if ratio is None else ratio)
    chosen = None if method is None else estimator_of(method)
    if isinstance(source, Robot):
        robot, runs, drives, stated, experiment = source, _given_runs(runs), {}, priors, None
    else:
        experiment = _experiment_alone(source, runs)
        robot = load_robot(experiment.robot)
        check_robot(experiment, robot)
        runs = read_runs(experiment, experiment.runs, progress)
        drives, stated = experiment.drives, experiment.priors if priors is None else priors
        prior_gains = experiment.expected_gains if prior_gains is None else prior_gains
        priors = experiment.expected_parameters if priors is None else priors
    estimator = chosen or _default_estimator(runs, as_paper)
    _check_combination(estimator, as_paper, consistent)
    priors = priors or {}
    require_priors_taken(estimator, runs, stated or {}, consistent)
    gains = gains_for(estimator, robot, runs, prior_gains)
    with single_threaded_blas():
        dataset = reduce_runs(
            robot, runs, decimator=options.decimator, progress=progress, priors=usable(estimator, priors)
        )
        system = dataset.system(Friction())
        if gains is None:
            require_scale(robot, system, [run.payload for run in dataset.runs], estimator.name)
        try:
            result = estimate(dataset, estimator, Given(gains, priors, progress), options, prior_gains, consistent)
        except GtauError:
            require_felt_payload(system)
            raise
        outcomes = {gain.verdict.outcome for gain in result.drive_gains.values()}
        if outcomes <= {Outcome.CONTRADICTORY, Outcome.NOT_IDENTIFIABLE}:
            require_felt_payload(system)
        geometry = geometry_of(experiment, experiment.runs, dataset.model, progress) if experiment else None
        found = [*([geometry.note] if geometry else []), *map(note, command_lag(dataset, system))]
        notes = (*found, *_data_sheet_notes(drives, result), *result.notes)
        return replace(result, geometry=geometry, notes=notes)


def _data_sheet_notes(drives: Mapping[str, Drive], result: Result) -> tuple[Note, ...]:
    gains = {Parameter("gain", joint).name: gain for joint, gain in result.drive_gains.items() if gain.std is not None}
    found = {name: (each.value, each.std) for name, each in (gains | dict(result.parameters)).items()}
    return data_sheet_notes(drives, result.robot, found)


def _given_runs(runs: Sequence[Run] | None) -> Sequence[Run]:
    if not runs:
        raise GtauError("a robot alone cannot be identified; give its runs too.")
    return runs


def _experiment_alone(source: str | Path | Experiment, runs: Sequence[Run] | None) -> Experiment:
    if runs is not None:
        raise GtauError(
            "runs are given beside an experiment file, which lists its own; give a robot with runs, or the file alone."
        )
    return source if isinstance(source, Experiment) else read_experiment(source)


def _default_estimator(runs: Sequence[Run], as_paper: bool) -> Estimator:
    return estimator_of("wls" if runs[0].kind == "torque" else "tls" if as_paper else "ml")


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


def require_priors_taken(
    estimator: Estimator, runs: Sequence[Run], priors: Mapping[str, Prior], consistent: bool = False
) -> None:
    """Check that an estimator can take what is known beside currents and payloads.

    Raises
    ------
    GtauError
        Where it takes neither torque sensors nor known parameters, and there are some; ``consistent`` parameters are
        sought with the latter whatever the estimator.
    """
    if estimator.takes_priors:
        return
    takers = ", ".join(each.name for each in ESTIMATORS.values() if each.takes_priors)
    known = any(prior.value is not None for prior in priors.values()) and not consistent
    for what, key, there in (
        ("torque sensors", "joint_torque", runs[0].sensors),
        ("known parameters", "priors", known),
        ("wrenches on bodies", "wrenches", any(body not in runs[0].base for body, _ in runs[0].wrenches)),
    ):
        if there:
            raise GtauError(
                f"method '{estimator.name}' takes no {what}, and '{key}' gives some; remove '{key}', or choose from "
                f"{takers} with --method."
            )


def usable(estimator: Estimator, priors: Mapping[str, Prior]) -> Mapping[str, Prior]:
    """Return the priors that join the currents in an estimator; others use them only for consistent parameters."""
    return priors if estimator.takes_priors else {}


def gains_for(
    estimator: Estimator, robot: Robot, runs: Sequence[Run], prior_gains: Mapping[str, float] | None
) -> np.ndarray | None:
    """Return the gains (n,) that an estimator takes: 1 for torques, else the prior ones; None if it estimates them.

    Raises
    ------
    GtauError
        Where it estimates gains of logs that hold torques, or takes them and some joint has no prior gain.
    """
    torques = runs[0].kind == "torque"
    if robot.floating and not estimator.takes_priors:
        takers = ", ".join(each.name for each in ESTIMATORS.values() if each.takes_priors)
        raise GtauError(
            f"method '{estimator.name}' does not support floating bases, and that of robot '{robot.name}' floats; "
            f"choose from {takers} with --method."
        )
    if estimator.gains == Gains.GIVEN or (estimator.gains == Gains.EITHER and torques):
        return given_gains(robot, runs, prior_gains, estimator.name)
    if torques:
        raise GtauError(
            f"the logs hold torques, whose gain is 1, so there is nothing for method '{estimator.name}' to find; leave "
            "out --method, or use --method wls."
        )
    return None


def given_gains(robot: Robot, runs: Sequence[Run], prior_gains: Mapping[str, float] | None, method: str) -> np.ndarray:
    """Return gains for least squares: 1 for torques, otherwise the prior ones, (n,).

    Raises
    ------
    GtauError
        Where currents are logged and some joint has no prior gain.
    """
    if runs[0].kind == "torque":
        return np.ones(len(robot.actuated))
    known = {**dict.fromkeys(robot.base, 1.0), **(prior_gains or {})}
    missing = [joint for joint in robot.actuated if joint not in known]
    if missing:
        raise GtauError(
            f"method '{method}' needs a drive gain for every joint, and joint '{missing[0]}' has none; "
            "add 'prior_gains' to the experiment file, or use --method ml with a known payload."
        )
    return np.array([known[joint] for joint in robot.actuated])
