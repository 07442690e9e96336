"""What identification will make of a designed motion: standard deviations to expect, by its own filters and rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gtau.estimation.regression.factors import reduce_run
from gtau.estimation.regression.friction import Friction
from gtau.estimation.regression.problem import Problem
from gtau.estimation.regression.system import assemble_system
from gtau.estimation.regression.triangle import triangle
from gtau.excitation.constraints import whole_run
from gtau.excitation.evaluation import Grid, evaluate
from gtau.excitation.task import DesignProblem
from gtau.model.interpreter.threads import single_threaded_blas
from gtau.signals.preparation import prepare
from gtau.signals.preparation_choice import choose_preparation
from gtau.signals.run import Run


@dataclass(frozen=True, eq=False)
class Expected:
    """An unknown, its prior value, and the standard deviation to expect, SI units; nan where it stays unknown."""

    name: str
    value: float
    std: float

    @property
    def relative(self) -> float:
        """Deviation over value, per cent; infinite for a value of zero."""
        return 100 * self.std / abs(self.value) if self.value else float("inf")


@dataclass(frozen=True, eq=False)
class Forecast:
    """Standard deviations to expect of gains and base parameters, and the rows kept of each joint, (n,), as a share.

    ``std`` has those of all unknowns by name, of ``gain_`` relative to the gain; what is absent stays unknown.
    """

    gains: tuple[Expected, ...]
    parameters: tuple[Expected, ...]
    kept: np.ndarray
    std: Mapping[str, float]


def sampled_motions(task: DesignProblem, x: np.ndarray) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """Sample a whole run of every motion at the controller's rate: instants (N,), s; q, qd, qdd and jerk, (4, n, N)."""
    samples = round(task.series.period * task.rate)
    time = np.arange(samples) / task.rate
    periods = evaluate(task, x, Grid(time, 1 / task.rate, task.series.basis(time)))
    wholes = [whole_run(task, period.joints, task.rate) for period in periods]
    return tuple((np.arange(joints.shape[2]) / task.rate, joints) for joints in wholes)


def expected_runs(task: DesignProblem, x: np.ndarray) -> tuple[Run, ...]:
    """Simulate the runs as they would be logged without noise, at the prior values."""
    regressor = task.model.columns(task.base.standard)
    runs = []
    for (time, joints), followed in zip(sampled_motions(task, x), task.motions, strict=True):
        entries = regressor(task.model.layout, task.model.motion(joints[0], joints[1], joints[2]))
        for k in followed:
            torques = regressor.torques(entries, task.unknowns.load[k], len(task.gains))
            currents = (torques / task.gains[:, None]).T
            name, payload = f"run{k + 1}", task.payloads[k]
            runs.append(Run(name, task.model.actuated, time, joints[0].T, currents, payload=payload))
    return tuple(runs)


@single_threaded_blas
def forecast(task: DesignProblem, x: np.ndarray) -> Forecast:
    """Predict the standard deviations that identification will reach with the motion ``x``.

    The noise-free logs are filtered, decimated and reduced as identification does it, and the covariance is that of
    maximum likelihood for white noise of ``task.sigma``. Errors of the model and coloured noise come on top.

    Raises
    ------
    GtauError
        Where identification would refuse such logs.
    """
    runs = expected_runs(task, x)
    preparation = choose_preparation(runs)
    prepared = [prepare(run, preparation) for run in runs]
    factors = [reduce_run(task.model, task.base.standard, each, preparation.decimator) for each in prepared]
    slowest = 0.5 / (2 * np.pi * preparation.bandwidth)
    problem = assemble_system(
        task.model, task.base, factors, task.payloads, slowest, Friction((), len(runs) > 1)
    ).problem
    theta = np.array([dict(zip(task.base.names, task.chi, strict=True)).get(name, 0.0) for name in problem.parameters])
    # a row is a mean over its filter, whose gain is one where the motion is: white noise is divided by the factor
    sigma = task.sigma / np.sqrt(preparation.decimator.factor)
    std = np.sqrt(np.diag(ml_covariance(problem, theta, task.gains, sigma)))
    found = dict(zip(problem.parameters, std, strict=False))
    n_theta, n = problem.n_theta, len(task.gains)
    gains = [f"gain_{joint}" for joint in task.model.actuated]
    return Forecast(
        tuple(
            Expected(joint, float(g), float(g * std[n_theta + j]))
            for j, (joint, g) in enumerate(zip(task.model.actuated, task.gains, strict=True))
        ),
        tuple(
            Expected(name, float(value), float(found.get(name, np.nan)))
            for name, value in zip(task.base.names, task.chi, strict=True)
        ),
        problem.total_rows / sum(len(preparation.decimator.instants(len(each.time))) for each in prepared) * np.ones(n),
        {name: float(each) for name, each in zip((*problem.parameters, *gains), std, strict=False)},
    )


def ml_covariance(problem: Problem, theta: np.ndarray, gains: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Compute the covariance of (theta, log g, d) by maximum likelihood; ``sigma`` (n,) A of a row."""
    n_theta, n = problem.n_theta, len(gains)
    blocks = []
    for j, R in enumerate(problem.triangles):
        block = np.zeros((len(R), n_theta + 2 * n))
        block[:, :n_theta] = -R[:, :n_theta] / gains[j]
        block[:, n_theta + j] = (R[:, :n_theta] @ theta + R[:, n_theta]) / gains[j]
        block[:, n_theta + n + j] = -R[:, n_theta + 2]
        blocks.append(block / sigma[j])
    stacked = np.concatenate(blocks)
    size = np.linalg.norm(stacked, axis=0)
    half = np.linalg.pinv(triangle(stacked / size), rcond=1e-12) / size[:, None]
    return np.asarray(half @ half.T)
