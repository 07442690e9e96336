"""From an experiment to a result: the whole identification."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from gtau.errors import GtauError
from gtau.estimation.diagnostics.payload_checks import mass_uncertainty, weigh_known
from gtau.estimation.diagnostics.position_ripple import position_ripple
from gtau.estimation.estimators.current_domain import ml, ols, wls
from gtau.estimation.estimators.degrees_of_freedom import freedom
from gtau.estimation.estimators.didim import along_simulated_motion
from gtau.estimation.estimators.essential_parameters import essential
from gtau.estimation.estimators.huber import reweighted
from gtau.estimation.estimators.instrumental_variables import instrumental, with_instruments
from gtau.estimation.estimators.physical_consistency import consistent as find_consistent
from gtau.estimation.estimators.ridge import ridge
from gtau.estimation.estimators.solution import Solution
from gtau.estimation.estimators.total_least_squares import mixed, tls
from gtau.estimation.estimators.two_stage import two_stage
from gtau.estimation.regression.dataset import Dataset, Mapper, read_runs, reduce_runs
from gtau.estimation.regression.friction import Friction, all_terms, prune_friction_terms, select_friction_terms
from gtau.estimation.regression.problem import Problem
from gtau.estimation.regression.system import System, require_scale
from gtau.estimation.results.build import make_result
from gtau.estimation.results.result import Result
from gtau.progress import Progress, silent
from gtau.robots.load import load_robot
from gtau.robots.robot import Robot
from gtau.signals.experiment import Experiment, Prior, check_robot, read_experiment
from gtau.signals.run import Run

WITH_GAINS: dict[str, Callable[[Problem, np.ndarray], Solution]] = {"ols": ols, "wls": wls}
FOR_GAINS: dict[str, Callable[[Problem], Solution]] = {
    "ml": ml,
    "huber": ml,  # of reweighted rows
    "ridge": ml,  # with priors
    "iv": ml,  # weighed along simulated motion
    "didim": ml,  # of simulated motion
    "2sls": two_stage,
    "mixed": mixed,
    "tls": tls,
}
METHODS = (*FOR_GAINS, *WITH_GAINS)
PAPER = ("tls", *WITH_GAINS)
SIMULATED = ("iv", "didim")  # by WLS where logs hold torques
LOAD_PASSES = 6  # of the logs, at most, for friction that depends on the torques transmitted
LOAD_SETTLED = 1e-4  # relative change of the gains that ends them


@threadpool_limits.wrap(limits=1, user_api="blas")  # on matrices this small, threads only wait for each other
def identify(
    source: str | Path | Experiment | Robot,
    runs: Sequence[Run] | None = None,
    method: str | None = None,
    prior_gains: Mapping[str, float] | None = None,
    ratio: float | None = None,
    as_paper: bool = False,
    consistent: bool = False,
    priors: Mapping[str, Prior] | None = None,
    progress: Progress = silent,
    mapper: Mapper = map,
) -> Result:
    """Identify drive gains and dynamic parameters.

    Parameters
    ----------
    source : path, Experiment or Robot
        An experiment file, or what was read of it; or a robot, together with ``runs``.
    runs : sequence of Run, optional
        From :func:`gtau.read_run`; only with a robot.
    method : {"ml", "huber", "ridge", "iv", "didim", "2sls", "mixed", "tls", "wls", "ols"}
        Maximum likelihood (as it is, with Huber's weights against outliers, or with ``priors``), instrumental
        variables and DIDIM (against noise of the encoders), 2SLS, mixed LS-TLS and the paper's TLS find the drive
        gains from a known payload; weighted and ordinary least squares take ``prior_gains``, or torques. If left
        out, "wls" where logs hold torques, else "ml", or "tls" with ``as_paper``.
    prior_gains : mapping, optional
        Joint to gain, N m/A or N/A; the experiment file's if left out.
    ratio : float, optional
        The paper's r_sigma for the essential parameters; if left out, those that the Bayesian
        information criterion does not keep are cancelled.
    as_paper : bool
        Follow the paper step by step: its TLS (or WLS or OLS), its decimation filter, its friction, no delays, formula
        deviations, and the essential parameters re-estimated together with the gains at ratio 10.
        (Samples near reversals are left out all the same: with them TLS fails.)
    consistent : bool
        Also find standard parameters that rigid bodies can have (see
        :mod:`gtau.estimation.estimators.physical_consistency`).
    priors : mapping, optional
        What is known of standard parameters, by name, for these and ``ridge``; the experiment file's if left out.
    progress : callable, optional
        Called as the work goes on.
    mapper : callable, optional
        Where parts of the runs are reduced; see :data:`gtau.estimation.regression.dataset.Mapper` and
        :mod:`gtau.parallel`.

    Returns
    -------
    Result
        Drive gains, parameters, payloads and verdicts; ``print(result.summary())`` shows them.

    Raises
    ------
    GtauError
        Where a file is wrong, the data cannot be used, or they cannot give what the method asks for.
    """
    if method is not None and method not in METHODS:
        raise GtauError(f"there is no method '{method}'; choose from {', '.join(METHODS)}.")
    if isinstance(source, Robot):
        if not runs:
            raise GtauError("a robot alone cannot be identified; give its runs too.")
        robot = source
    else:
        if runs is not None:
            raise GtauError(
                "runs are given beside an experiment file, which names its own; give a robot with runs, or the "
                "file alone."
            )
        experiment = source if isinstance(source, Experiment) else read_experiment(source)
        robot = load_robot(experiment.robot)
        check_robot(experiment, robot)
        runs = read_runs(experiment, experiment.runs, progress)
        prior_gains, priors = prior_gains or experiment.prior_gains, priors or experiment.priors
    if method is None:
        method = "wls" if runs[0].kind == "torque" else "tls" if as_paper else "ml"
    if as_paper and method not in PAPER:
        raise GtauError(
            f"the paper has no method '{method}'; leave out --as-paper, or choose from {', '.join(PAPER)} with it."
        )
    if method == "iv" and consistent:
        raise GtauError(
            "consistent parameters are found by least squares, which instrumental variables are not; use --method "
            "didim or ml with --consistent."
        )
    gains = None
    if method in WITH_GAINS or (method in SIMULATED and runs[0].kind == "torque"):
        gains = given_gains(robot, runs, prior_gains, method)
    elif runs[0].kind == "torque":
        raise GtauError(
            f"the logs hold torques, whose gain is 1, so there is nothing for method '{method}' to find; leave "
            "out --method, or use --method wls."
        )

    def solve(problem: Problem) -> Solution:
        return FOR_GAINS[method](problem) if gains is None else WITH_GAINS.get(method, wls)(problem, gains)

    dataset = reduce_runs(robot, runs, decimator="chebyshev" if as_paper else "fir", progress=progress, mapper=mapper)
    if gains is None:
        require_scale(dataset.robot, dataset.system(Friction()), [run.payload for run in dataset.runs], method)
    if as_paper:
        system = dataset.system(Friction(), delays=False)
    else:
        dataset, system = with_friction(dataset, solve, progress)
    if method == "huber":
        dataset, system = reweighted(dataset, system, solve, progress)
    elif method == "didim":
        dataset, system = along_simulated_motion(dataset, system, solve, progress)
    progress("estimation", 0, 1)
    solution = solve(system.problem)
    of_masses = mass_uncertainty(dataset, system, solution, solve)
    if method == "ridge":
        solution = ridge(dataset, system, solution, priors or {})
    elif method == "iv":
        pair, solution = instrumental(dataset, system, solution, gains is None, progress)
    if as_paper:
        locked, covariance = None, solution.covariance + of_masses
    else:
        locked = position_ripple(dataset, system, solution, gains is None)
        covariance = solution.jackknife + of_masses + locked.covariance

    def final(problem: Problem) -> Solution:
        if as_paper:
            return solve(problem)
        if method == "iv":
            return with_instruments(pair.of(problem.parameters), solution, free_gains=False)
        return wls(problem, solution.gains)

    candidates = tuple(name for name in dataset.base.names if name in system.problem.parameters)
    ratio = 10.0 if as_paper and ratio is None else ratio
    kept, reduced, std = essential(system.problem, candidates, final, ratio, correlated=not as_paper)
    if ratio is None:
        # a kept parameter absorbs what the cancelled ones did: only the deviation with all of them there holds
        std = np.sqrt(np.diag(covariance))[[system.problem.parameters.index(name) for name in kept.parameters]]
    loss = {"reduction_loss": 100 * float(np.max(reduced.sigma / solution.sigma) - 1)}
    solution, reduced = (replace(each, statistics={**each.statistics, **loss}) for each in (solution, reduced))
    known = weigh_known(dataset, system, solution, method, solve) if gains is None else {}
    bodies = None
    if consistent:
        bodies = find_consistent(dataset, system, solution, priors or {}, free_gains=gains is None)
    progress("estimation", 1, 1)
    if as_paper:  # the gains that go with the essential parameters
        system, solution, covariance = replace(system, problem=kept), reduced, reduced.covariance
    blocks = None if as_paper else freedom(system.problem, solution, gains is None)
    chosen = {name: (float(reduced.theta[k]), float(std[k])) for k, name in enumerate(kept.parameters)}
    return make_result(
        dataset,
        system,
        method,
        solution,
        covariance,
        chosen,
        known,
        prior_gains or {},
        blocks,
        locked,
        bodies,
        progress,
    )


def with_friction(dataset: Dataset, solve: Callable[[Problem], Solution], progress: Progress) -> tuple[Dataset, System]:
    """Choose the friction terms from the data; load-dependent ones need the torques, and so a fit, first.

    Terms that the joints' own equations ask for, but that all equations together do not tell, are left out again.
    Returns the data, streamed again where a joint has load-dependent friction, and its problem.
    """
    joints, per_run = dataset.model.actuated, len(dataset.runs) > 1
    friction = Friction(select_friction_terms(dataset.system(Friction(all_terms(joints), per_run)).problem), per_run)
    if not any(term.startswith("fl_") for term in friction.terms):
        system = dataset.system(friction)
        return dataset, dataset.system(Friction(prune_friction_terms(system.problem, friction, solve), per_run))
    system = dataset.system(Friction(tuple(t for t in friction.terms if not t.startswith("fl_")), per_run))
    gains = None
    for _ in range(LOAD_PASSES):
        solution = solve(system.problem)
        settled = gains is not None and np.allclose(solution.gains, gains, rtol=LOAD_SETTLED, atol=0)
        gains = solution.gains
        if settled:
            break
        dataset = dataset.reduced([system.load(k, solution.theta) for k in range(len(dataset.runs))], progress)
        system = dataset.system(friction)
    return dataset, dataset.system(Friction(prune_friction_terms(system.problem, friction, solve), per_run))


def given_gains(robot: Robot, runs: Sequence[Run], prior_gains: Mapping[str, float] | None, method: str) -> np.ndarray:
    """Gains for least squares: 1 for torques, otherwise the prior ones, (n,).

    Raises
    ------
    GtauError
        Where currents are logged and some joint has no prior gain.
    """
    if runs[0].kind == "torque":
        return np.ones(len(robot.actuated))
    missing = [joint for joint in robot.actuated if joint not in (prior_gains or {})]
    if missing:
        raise GtauError(
            f"method '{method}' needs a drive gain for every joint, and joint '{missing[0]}' has none; "
            "add 'prior_gains' to the experiment file, or use --method ml with a known payload."
        )
    return np.array([prior_gains[joint] for joint in robot.actuated])  # type: ignore[index]
