"""All estimators on the same data, beside each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from gtau.errors import GtauError
from gtau.estimation.diagnostics.payload_checks import mass_uncertainty
from gtau.estimation.diagnostics.position_ripple import position_ripple
from gtau.estimation.diagnostics.prior_checks import against_limits, against_priors
from gtau.estimation.diagnostics.verdict import Outcome, gain_verdicts, worst
from gtau.estimation.estimators.current_domain import ml
from gtau.estimation.estimators.didim import along_simulated_motion
from gtau.estimation.estimators.huber import reweighted
from gtau.estimation.estimators.instrumental_variables import instrumental
from gtau.estimation.estimators.ridge import ridge
from gtau.estimation.estimators.solution import Solution
from gtau.estimation.identify import FOR_GAINS, WITH_GAINS, with_friction
from gtau.estimation.regression.dataset import read_runs, reduce_runs
from gtau.estimation.regression.friction import Friction
from gtau.estimation.regression.problem import Problem
from gtau.estimation.regression.system import require_scale
from gtau.progress import Progress, silent
from gtau.robots.load import load_robot
from gtau.signals.experiment import check_robot, read_experiment


@dataclass(frozen=True, eq=False)
class Row:
    """What one estimator makes of the data.

    ``gains`` and ``std`` (n,), N m/A or N/A, the deviations None where the gains are given. ``residuals`` (n,)
    are those of the currents in per cent of them, ``seconds`` the time of the estimation alone. An estimator
    that refuses the data has nothing but its ``refusal``.
    """

    method: str
    gains: np.ndarray | None = None
    std: np.ndarray | None = None
    residuals: np.ndarray | None = None
    seconds: float = 0.0
    outcome: Outcome | None = None
    refusal: str = ""


@dataclass(frozen=True, eq=False)
class EstimatorComparison:
    """A row for each estimator, with the gains of the ``joints``."""

    joints: tuple[str, ...]
    rows: tuple[Row, ...]


@threadpool_limits.wrap(limits=1, user_api="blas")  # on matrices this small, threads only wait for each other
def compare(path: str | Path, progress: Progress = silent) -> EstimatorComparison:
    """Identify an experiment with every estimator, all on the friction terms chosen for maximum likelihood.

    Raises
    ------
    GtauError
        Where a file is wrong, the logs hold torques, or the runs cannot fix the scale of the gains.
    """
    experiment = read_experiment(path)
    robot = load_robot(experiment.robot)
    check_robot(experiment, robot)
    runs = read_runs(experiment, experiment.runs, progress)
    if runs[0].kind == "torque":
        raise GtauError(f"{path}: the logs hold torques, so there are no drive gains to compare; use 'gtau identify'.")
    dataset = reduce_runs(robot, runs, progress=progress)
    require_scale(dataset.robot, dataset.system(Friction()), [run.payload for run in dataset.runs], "ml")
    dataset, system = with_friction(dataset, ml, progress)
    names = [run.name for run in runs]

    def row(method: str) -> Row:
        along, mine, start = dataset, system, perf_counter()
        try:
            if method in WITH_GAINS:
                prior = np.array([experiment.prior_gains[joint] for joint in robot.actuated])
                solution = WITH_GAINS[method](mine.problem, prior)
            else:
                if method == "huber":
                    along, mine = reweighted(dataset, mine, ml, progress)
                elif method == "didim":
                    along, mine = along_simulated_motion(dataset, mine, ml, progress)
                solution = FOR_GAINS[method](mine.problem)
                of_masses = mass_uncertainty(along, mine, solution, FOR_GAINS[method])
                if method == "ridge":
                    solution = ridge(dataset, mine, solution, experiment.priors)
                elif method == "iv":
                    _, solution = instrumental(dataset, mine, solution, True, progress)
        except GtauError as refusal:
            return Row(method, refusal=str(refusal))
        seconds = perf_counter() - start
        residuals = _residuals(mine.problem, solution)
        if method in WITH_GAINS:
            return Row(method, solution.gains, None, residuals, seconds)
        of_gains = slice(mine.problem.n_theta, mine.problem.n_theta + len(robot.actuated))
        locked = position_ripple(along, mine, solution, free_gains=True)
        std = np.sqrt(np.diag(solution.jackknife + of_masses + locked.covariance))[of_gains]
        verdicts = gain_verdicts(mine.problem, solution, std, mine.block_positions, names, locked.found)
        verdicts = against_priors(verdicts, robot, solution.gains, experiment.prior_gains)
        verdicts = against_limits(verdicts, robot, np.abs(solution.gains) * mine.problem.signal)
        return Row(method, solution.gains, std, residuals, seconds, worst(verdicts))

    methods = [*FOR_GAINS, *(WITH_GAINS if experiment.prior_gains else ())]
    rows = []
    for k, method in enumerate(methods):
        progress("estimators", k, len(methods))
        rows.append(row(method))
    progress("estimators", len(methods), len(methods))
    return EstimatorComparison(robot.actuated, tuple(rows))


def _residuals(problem: Problem, solution: Solution) -> np.ndarray:
    """Current residuals, per cent of the currents' rms, (n,)."""
    return np.asarray(100 * solution.sigma / problem.signal)


def table(found: EstimatorComparison) -> str:
    """The comparison as text."""
    entries = {row.method: _gains(row) for row in found.rows}
    width = 2 + max(
        len(text) for text in (*found.joints, "gain +- std %", *(e for each in entries.values() for e in each))
    )
    joints = "".join(f"{joint:>{width}}" for joint in found.joints)
    head = f"{'gain +- std %':>{width}}" * len(found.joints)
    lines = [
        f"{'':<8}{joints}{'residual':>10}{'time':>8}   worst",
        f"{'method':<8}{head}{'%':>10}{'s':>8}   verdict",
    ]
    for row in found.rows:
        if row.gains is None or row.residuals is None:
            lines.append(f"{row.method:<8}  {row.refusal}")
            continue
        gains = "".join(f"{entry:>{width}}" for entry in entries[row.method])
        verdict = "" if row.outcome is None else row.outcome.value
        lines.append(f"{row.method:<8}{gains}{row.residuals.max():>10.3g}{row.seconds:>8.2f}   {verdict}")
    lines.append("residual: of the worst joint, in per cent of its current; time: of the estimation alone")
    return "\n".join(line.rstrip() for line in lines)


def _gains(row: Row) -> list[str]:
    """Gains of an estimator as text; none where it refused."""
    if row.gains is None:
        return []
    if row.std is None:
        return [f"{gain:.5g} given" for gain in row.gains]
    return [f"{g:.5g} +- {100 * s / abs(g):.2g} %" for g, s in zip(row.gains, row.std, strict=True)]


def to_document(found: EstimatorComparison) -> dict[str, Any]:
    """The comparison as a JSON document."""

    def numbers(values: Sequence[float] | np.ndarray | None) -> list[float] | None:
        return None if values is None else [float(value) for value in values]

    return {
        "joints": list(found.joints),
        "estimators": [
            {
                "method": row.method,
                "gains": numbers(row.gains),
                "std": numbers(row.std),
                "residuals": numbers(row.residuals),
                "seconds": row.seconds,
                "outcome": None if row.outcome is None else row.outcome.value,
                "refusal": row.refusal,
            }
            for row in found.rows
        ],
    }
