"""Check the requirements of an estimator on an experiment, for all commands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.estimators.estimator import Estimator, Gains
from gtau.estimation.estimators.registry import ESTIMATORS, estimator_of
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.scale_source import require_scale
from gtau.estimation.regression.system import System
from gtau.robots.robot import Robot
from gtau.signals.reading.statements import Prior
from gtau.signals.run import Run


def choose_estimator(method: str | None, runs: Sequence[Run], as_paper: bool = False) -> Estimator:
    """Return the estimator of this name, or the default: ML, or TLS ``as_paper``, or WLS of torques; GtauError."""
    of_paper = "wls" if runs[0].kind == "torque" else "tls"
    return estimator_of(method or (of_paper if as_paper else "ml"))


def require_inputs(
    estimator: Estimator,
    robot: Robot,
    runs: Sequence[Run],
    prior_gains: Mapping[str, float] | None,
    priors: Mapping[str, Prior],
    consistent: bool = False,
) -> np.ndarray | None:
    """Check that an estimator accepts the priors, and return its given gains (n,); None if it estimates them.

    Raises
    ------
    GtauError
        Where it takes neither torque sensors nor known parameters, and there are some (``consistent`` parameters are
        sought with the latter whatever the estimator); where it does not support a floating base; where it takes gains
        and some joint has none.
    """
    if not estimator.takes_priors:
        _refuse_priors(estimator, robot, runs, priors, consistent)
    return given_gains(robot, runs, prior_gains, estimator.name) if estimator.gains == Gains.GIVEN else None


def require_identifiable(
    estimator: Estimator,
    gains: np.ndarray | None,
    dataset: Dataset,
    system: System,
    chosen: bool = True,
    prior_gains: Mapping[str, float] | None = None,
) -> tuple[Estimator, np.ndarray | None]:
    """Check that the runs fix the scale of the gains, unless these are given; return the estimator and its gains.

    Parameters
    ----------
    estimator, gains : Estimator, ndarray
        From :func:`choose_estimator` and :func:`require_inputs`.
    dataset, system : Dataset, System
        The equations.
    chosen : bool
        Whether the user chose the estimator. Where nothing tests the scale of logged torques it is set to 1, except by
        a chosen estimator of gains; known parameters alone test it only for the latter, as they may be rough.

    prior_gains : mapping, optional
        Joint to the factor that makes a torque true, for torques of which nothing tests the scale.

    Returns
    -------
    estimator, gains : Estimator, ndarray
        Those given, or weighted least squares with the gains 1 (or prior ones).

    Raises
    ------
    GtauError
        If nothing fixes the scale of the currents, or the chosen estimator lacks an input.
    """
    if gains is not None:
        return estimator, gains
    demanded = dataset.runs[0].kind == "current" or (chosen and estimator.gains == Gains.ESTIMATED)
    try:
        require_scale(dataset.robot, system, [run.payload for run in dataset.runs], estimator.name)
    except GtauError:
        if demanded:
            raise
    else:
        if demanded or tests_torques(system):
            return estimator, None
    taken = estimator if chosen else estimator_of("wls")
    return taken, given_gains(dataset.robot, dataset.runs, prior_gains, taken.name)


def tests_torques(system: System) -> bool:
    """Decide whether a known payload, a torque sensor or a wrench tests the scale of logged torques."""
    problem, known = system.problem, (each for each in system.payloads if each.payload.mass is not None)
    return any(each.acts for each in known) or bool(problem.wrenches) or not problem.unknown_gains.all()


def _refuse_priors(
    estimator: Estimator, robot: Robot, runs: Sequence[Run], priors: Mapping[str, Prior], consistent: bool
) -> None:
    """Refuse torque sensors, known parameters and floating bases for an estimator that takes none; raises GtauError."""
    takers = ", ".join(each.name for each in ESTIMATORS.values() if each.takes_priors)
    stated, valued = dict(robot.inertias), {name: each.value for name, each in priors.items() if each.value is not None}
    of_file = all(name in stated and stated[name] == value for name, value in valued.items())
    known, kinds = bool(valued) and not consistent, [each.kind for each in runs[0].channels]
    for what, key, there in (
        *((each.group, each.calibration, True) for each in kinds if each.of_joint and each.calibration),
        ("known parameters", "prior_inertias" if of_file else "priors", known),
        ("wrenches on bodies", "wrenches", any(body not in runs[0].base for body, _ in runs[0].wrenches)),
    ):
        if there:
            raise GtauError(
                f"method '{estimator.name}' takes no {what}, and '{key}' gives some; remove '{key}', or choose from "
                f"{takers} with --method."
            )
    if robot.floating:
        raise GtauError(
            f"method '{estimator.name}' does not support floating bases, and that of robot '{robot.name}' floats; "
            f"choose from {takers} with --method."
        )


def usable(estimator: Estimator, priors: Mapping[str, Prior]) -> Mapping[str, Prior]:
    """Return the priors that an estimator uses as equations; others use them only for consistent parameters."""
    return priors if estimator.takes_priors else {}


def given_gains(robot: Robot, runs: Sequence[Run], prior_gains: Mapping[str, float] | None, method: str) -> np.ndarray:
    """Return gains for least squares: the prior ones, 1 for torques without, (n,).

    Raises
    ------
    GtauError
        Where currents are logged and some joint has no prior gain.
    """
    exact = robot.actuated if runs[0].kind == "torque" else robot.base
    known = {**dict.fromkeys(exact, 1.0), **(prior_gains or {})}
    missing = [joint for joint in robot.actuated if joint not in known]
    if missing:
        raise GtauError(
            f"method '{method}' needs a drive gain for every joint, and joint '{missing[0]}' has none; "
            "add 'prior_gains' to the experiment file, or use --method ml with a known payload."
        )
    return np.array([known[joint] for joint in robot.actuated])
