"""Forecast of the standard deviations of identification, computed with identification's filters and rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gtau.estimation.estimators.newton import jacobian
from gtau.estimation.regression.assembly import plain_problem
from gtau.estimation.regression.factors import modelled, reduce_run, triangle
from gtau.estimation.regression.problem import Problem
from gtau.excitation.constraints import ConstraintUsage, whole_run
from gtau.excitation.design import Design, check
from gtau.excitation.information import from_voltages
from gtau.excitation.task import DesignProblem, Grid, close, evaluate
from gtau.model.program import single_threaded_blas
from gtau.robots.parameter import Parameter, parameter_of, torque_unit, unit_of
from gtau.robots.robot import Robot
from gtau.signals.preparation.bandwidth import choose_preparation
from gtau.signals.preparation.prepared_run import prepare
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run


@dataclass(frozen=True, eq=False)
class Expected:
    """An unknown with its prior value and expected standard deviation, SI units; nan if not identifiable."""

    name: str
    value: float
    std: float

    @property
    def relative(self) -> float:
        """Standard deviation, per cent of the value; infinite for a value of zero."""
        return 100 * self.std / abs(self.value) if self.value else float("inf")


@dataclass(frozen=True, eq=False)
class Forecast:
    """Expected gains and parameters, shares of rows ``kept`` (n,), and ``std`` of all unknowns (relative for gains)."""

    gains: tuple[Expected, ...]
    parameters: tuple[Expected, ...]
    kept: np.ndarray
    std: Mapping[str, float]


def sampled_run(task: DesignProblem, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sample a run at the controller's rate: instants (N,), s; q, qd, qdd and jerk (4, n, N)."""
    time = np.arange(round(task.series.period * task.rate)) / task.rate
    joints = whole_run(task, evaluate(task, x, Grid(1 / task.rate, task.series.basis(time))), task.rate)
    return np.arange(joints.shape[2]) / task.rate, joints


def expected_runs(task: DesignProblem, x: np.ndarray) -> tuple[Run, ...]:
    """Simulate noise-free logs of the runs at the prior values."""
    time, joints = sampled_run(task, x)
    regressor, motion, runs = task.model.columns(task.base.standard), task.model.motion(*joints[:3]), []
    for k, payload in enumerate(task.payloads):
        torques = regressor.torques_along(task.model.layout, motion, task.information.load[k])
        currents = (torques / task.prior.gains[:, None]).T
        runs.append(Run(f"run{k + 1}", task.model.actuated, time, joints[0].T, currents, payload=payload))
    return tuple(runs)


@single_threaded_blas()
def forecast(task: DesignProblem, x: np.ndarray) -> Forecast:
    """Predict the standard deviations of identification with the motion ``x``.

    Noise-free logs are filtered, decimated and reduced as in identification. The covariance is the covariance of
    maximum likelihood for white noise of the prior's ``sigma`` and uncertain masses of payloads; it includes neither
    model errors nor coloured noise.
    """
    runs = expected_runs(task, x)
    preparation = choose_preparation(runs)
    prepared = [prepare(run, preparation) for run in runs]
    factors = [reduce_run(task.model, task.base.standard, run, preparation.decimator) for run in prepared]
    slowest = 0.5 / (2 * np.pi * preparation.bandwidth)
    uncertain = dict.fromkeys(load.name for load in task.payloads if load is not None and load.mass_std)
    loads: list[Sequence[Payload | None]] = [task.payloads]
    # each heavier by its standard deviation
    loads += [[_heavier(load) if load and load.name == name else load for load in task.payloads] for name in uncertain]
    problem, *shifted = (plain_problem(task.model, task.base, factors, load, slowest) for load in loads)
    prior = dict(zip(task.base.names, task.prior.chi, strict=True))
    theta = task.prior.values(problem.parameters, task.model.robot, task.payloads, prior)
    # a row is a mean over the filter, which divides the variance of white noise by the factor
    sigma = task.prior.sigma / np.sqrt(preparation.decimator.factor)
    known = from_voltages(problem.unknowns, task.prior)
    covariance = ml_covariance(problem, theta, task.prior.gains, sigma, shifted, known)
    std = np.sqrt(np.diag(covariance)).tolist()
    joints, names = task.model.actuated, problem.parameters
    relative = std[problem.unknowns.gains]
    expected: dict[str, float] = dict(zip(names, std, strict=False))
    by_joint = zip(joints, task.prior.gains.tolist(), relative, strict=True)
    gains = tuple(Expected(joint, gain, gain * share) for joint, gain, share in by_joint)
    parameters = tuple(Expected(name, float(value), expected.get(name, np.nan)) for name, value in prior.items())
    expected |= {Parameter("gain", joint): share for joint, share in zip(joints, relative, strict=True)}
    rows = sum(len(preparation.decimator.instants(len(run.time))) for run in prepared)
    return Forecast(gains, parameters, np.full(len(joints), problem.total_rows / rows), expected)


def _heavier(load: Payload) -> Payload:
    return load.model_copy(update={"mass": (load.mass or 0.0) + load.mass_std})


def ml_covariance(
    problem: Problem, theta: np.ndarray, gains: np.ndarray, sigma: np.ndarray, shifted: Sequence[Problem],
    known: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Compute the maximum-likelihood covariance of (theta, log g, d) for the noise ``sigma`` (n,) of a row, A.

    A ``shifted`` problem has one stated constant increased by its standard deviation; ``known`` (m, k) factors further
    information.
    """
    values = np.concatenate([theta, gains, np.zeros(len(gains))])
    J = jacobian(problem.blocks, values, problem, free_gains=True) / sigma[:, None, None]
    J[..., problem.unknowns.gains] /= -gains  # from 1 / g to log g
    rows, torque = J.reshape(-1, J.shape[-1]), modelled(problem.blocks, theta)
    changes = [(modelled(p.blocks, theta) - torque) / (gains * sigma)[:, None] for p in shifted]
    every = np.concatenate([rows, known])
    size = np.linalg.norm(every, axis=0)
    half = np.linalg.pinv(triangle(every / size), rcond=1e-12) / size[:, None]
    moved = half @ (half.T @ (rows.T @ np.reshape(changes, (len(changes), len(rows))).T))
    return np.asarray(half @ half.T + moved @ moved.T)


WEAK = 30.0  # per cent: an unknown with a larger relative standard deviation counts as unidentified


@dataclass(frozen=True, eq=False)
class Outlook:
    """A design, its predictions, the assumptions of its file (``assumed``), and payload ``masses``, kg, to try."""

    design: Design
    assumed: Mapping[str, str]
    masses: tuple[float, ...] = ()

    @property
    def task(self) -> DesignProblem:
        """The design problem."""
        return self.design.task

    @property
    def robot(self) -> Robot:
        """The robot that moves."""
        return self.task.model.robot

    @cached_property
    def run(self) -> tuple[np.ndarray, np.ndarray]:
        """A run at the controller's rate, see :func:`sampled_run`."""
        return sampled_run(self.task, self.design.x)

    @cached_property
    def forecast(self) -> Forecast:
        """Expected standard deviations."""
        return forecast(self.task, self.design.x)

    @cached_property
    def shares(self) -> dict[Parameter, float]:
        """Standard deviations of the unknowns, per cent of the prior value, or of a typical one if it is zero."""
        scales = zip(self.task.information.names, self.task.information.scale.tolist(), strict=True)
        return {name: 100 * self.forecast.std.get(name, np.inf) / scale for name, scale in scales}

    @property
    def weak(self) -> dict[str, float]:
        """Shares of the unknowns that the design leaves unidentified."""
        lasting = {name: share for name, share in self.shares.items() if name.kind != "delay" and name.run is None}
        return {str(name): share for name, share in lasting.items() if share >= WEAK}

    @cached_property
    def tool(self) -> tuple[float, np.ndarray]:
        """Largest speed, m/s, and smallest and largest coordinates (2, 3), m, of the tool's frame in the base."""
        time, joints = self.run
        path = self.task.tool[0](close(self.task.model, joints).c)
        speed = np.linalg.norm(np.gradient(path, time, axis=1), axis=0).max()
        return float(speed), np.array([path.min(axis=1), path.max(axis=1)])

    @cached_property
    def variants(self) -> tuple[Outlook, ...]:
        """The same motion with the other payload masses."""
        x, tasks = self.design.x, map(self.task.with_payload_mass, self.masses)
        designs = [replace(self.design, task=task, constraint_usages=check(task, x)) for task in tasks]
        return tuple(Outlook(design, self.assumed) for design in designs)

    @property
    def duration(self) -> float:
        """Duration of a run, s."""
        return float(self.run[0][-1])

    @property
    def rms(self) -> float:
        """Root mean square of the relative standard deviations of the gains, per cent."""
        return float(np.sqrt(np.mean([gain.relative**2 for gain in self.forecast.gains])))

    @property
    def usages(self) -> list[ConstraintUsage]:
        """Usages of the limits in descending order."""
        return sorted(self.design.constraint_usages, key=lambda usage: -usage.excess)

    @property
    def exceeded(self) -> list[str]:
        """Limits that the motion exceeds."""
        return [usage.what for usage in self.usages if usage.excess > 1]

    def unit(self, unknown: Expected) -> str:
        """Return the unit of a gain or a parameter."""
        if unknown in self.forecast.gains:
            return f"{torque_unit(self.robot, unknown.name)}/A"
        parameter = parameter_of(unknown.name)
        return unit_of(parameter.kind, self.robot, parameter.body)
