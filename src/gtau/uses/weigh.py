"""Weighing payloads: unknown loads estimated with an identified robot (paper, section 5.2)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from gtau.documents.validation import FUNCTION, TEXT, takes
from gtau.errors import GtauError
from gtau.estimation.diagnostics.stated_constants import scale_uncertainty
from gtau.estimation.estimators.essential import select_friction
from gtau.estimation.estimators.least_squares import wls
from gtau.estimation.estimators.newton import degrees_of_freedom
from gtau.estimation.experiment_runs import options_of, read
from gtau.estimation.preconditions import given_gains
from gtau.estimation.regression.dataset import at_rate_of, reduce_runs
from gtau.estimation.regression.problem import Estimates
from gtau.estimation.results.build import payload_estimates
from gtau.estimation.results.groups import PayloadEstimate
from gtau.estimation.results.result import Result
from gtau.model.interpreter.program import single_threaded_blas
from gtau.progress import Progress, silent
from gtau.robots.parameter import Parameter
from gtau.robots.robot import Robot
from gtau.signals.reading.experiment import Experiment
from gtau.signals.run import Run
from gtau.uses.runs import require_same


@takes(model=("the result of gtau.identify or gtau.Result.load", (Result,)), gains=TEXT, progress=FUNCTION)
@single_threaded_blas()
def weigh(
    model: Result,
    source: str | Path | Experiment | Robot,
    runs: Sequence[Run] | None = None,
    gains: str = "identified",
    prior_gains: Mapping[str, float | Mapping[str, float]] | None = None,
    progress: Progress = silent,
) -> tuple[PayloadEstimate, ...]:
    """Weigh the unknown payloads of an experiment by WLS, the robot re-identified from its runs without payload.

    Runs with a known payload are left out, since a known mass would fix the scale whatever the gains; they are the
    reference for the unknown payloads only if no run is without payload.

    Parameters
    ----------
    model : Result
        Identified model: its gains, their uncertainty, and its preparation of the signals.
    source : path, Experiment or Robot
        An experiment file or the experiment read from it; or the robot, together with ``runs``. At least one run
        carries an unknown payload and one another load.
    runs : sequence of Run, optional
        From :func:`gtau.read_run`; only with a robot.
    gains : {"identified", "prior"}
        The model's gains, or the prior ones (the paper's cases 2 and 1).
    prior_gains : mapping, optional
        Joint to gain, N m/A or N/A, or to a mapping with its standard deviation such as ``{"value": 2.4, "std": 0.1}``;
        the experiment file's if left out.
    progress : callable, optional
        Called as the work goes on.

    Returns
    -------
    tuple of PayloadEstimate
        One for each run with an unknown payload. The standard deviations include the uncertainty of the gains, as far
        as it is known (see :func:`gtau.uses.weigh.exact_gains`). A mass whose interval lies below zero has a
        contradictory verdict.

    Raises
    ------
    GtauError
        Where a file is wrong or of another robot, or the runs cannot separate the payload from the robot.
    """
    if gains not in ("identified", "prior"):
        raise GtauError(f"gains is '{gains}'; write 'identified' or 'prior'.")
    of_file = isinstance(source, (str, Path))
    subject = read(source, runs, options_of(prior_gains), progress)
    where, robot = f"{source}: " if of_file else "", model.robot
    require_same(model, subject.robot, subject.runs[0].kind, str(source) if of_file else "this experiment")
    if not any(run.payload is not None and run.payload.mass is None for run in subject.runs):
        raise GtauError(f"{where}no run has an unknown payload; leave out 'mass' of the payload to be weighed.")
    if gains == "prior" and model.kind == "current" and not subject.options.gains:
        raise GtauError(f"{where}there are no 'prior_gains'; add them, or weigh with the identified gains.")
    bare = any(run.payload is None for run in subject.runs)
    chosen = [run for run in subject.runs if run.payload is None or run.payload.mass is None or not bare]
    if gains == "prior":
        g_tau = given_gains(robot, chosen, subject.options.gains, "wls")
        stated = subject.options.prior_gains or {}
        stds = [stated[joint].std if joint in stated else None for joint in robot.actuated]
        covariance = np.diag([(std or 0.0) ** 2 for std in stds])
    else:
        g_tau = model.gains
        rows = [model.covariance_names.index(Parameter("gain", joint)) for joint in robot.actuated]
        covariance = model.covariance[np.ix_(rows, rows)]
    weighed = tuple(run.ordered(run.joints, link_side=False) for run in chosen)  # the model's gains say as much
    dataset = reduce_runs(robot, weighed, at_rate_of(weighed, model.preparation), progress=progress)

    solve = partial(wls, gains=g_tau)
    system = select_friction(dataset, solve, progress)
    lost = [name for carried in system.payloads for name in carried.unknown if name in system.unexcited]
    if lost:
        raise GtauError(
            f"{where}the runs cannot separate the payload from the robot itself; add a run without payload, or "
            "with one of which all parameters are known."
        )
    solution = solve(system.problem)
    total = solution.jackknife + scale_uncertainty(system, solve)
    if covariance.any():
        # derivatives (k, n) of the estimates by the gains
        steps = 1e-4 * g_tau
        moved = np.stack([wls(system.problem, g_tau + step).values for step in np.diag(steps)], axis=1)
        slopes = (moved - solution.values[:, None]) / steps
        total = total + slopes @ covariance @ slopes.T
    none = np.zeros_like(total)
    freedom = degrees_of_freedom(system.problem, solution, False)
    vector = Estimates(system.problem.unknowns, solution.values, total, none, none, freedom)
    estimates = payload_estimates(system, vector, {})
    return tuple(payload for payload in estimates if "m" not in payload.known)


def exact_gains(model: Result, experiment: Experiment, gains: str) -> tuple[str, ...]:
    """List the joints whose gain is treated as exact, because its standard deviation is unknown.

    Of the model's gains they are those that were given: of logged torques, whose scale was not tested.
    """
    if gains != "prior":
        return tuple(joint for joint, gain in model.drive_gains.items() if gain.std is None)
    known = {joint for joint, gain in experiment.stated_gains.items() if gain.std is not None}
    return tuple(joint for joint in experiment.signals.joints if joint not in known)
