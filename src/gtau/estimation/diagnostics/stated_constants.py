"""Stated constants: known payloads, torque sensors, measured wrenches and priors, and how the estimates depend on them.

Currents alone leave the scale open: gains and parameters may all be twice as large. It comes from constants stated in N
m or kg. The derivative of the estimates with respect to each constant, at the solution, gives the sources of the scale
and the uncertainty that the constants add to the estimates. With all constants larger by one per cent, every gain and
parameter is larger by one per cent too; so the shares by which a gain grows with each source alone add up to one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gtau.estimation.effects.linearisation import slopes_of, weighted, weights_of
from gtau.estimation.estimators.estimator import Fit, Solve
from gtau.estimation.estimators.newton import curvature_of_delays, jacobian, jacobian_of_known, stacked, whitening
from gtau.estimation.regression.assembly import known_values
from gtau.estimation.regression.dataset import System
from gtau.estimation.regression.factors import FIXED, KNOWN, SIGNALS, delayed_signal
from gtau.estimation.regression.problem import Problem
from gtau.robots.parameter import Parameter
from gtau.signals.reading.statements import Payload

SCALED_BY_FILE = "the inertias of the robot's file"


@dataclass(frozen=True, eq=False)
class StatedConstant:
    """A constant that sets the scale: its ``source``, ``value`` and standard deviation, 0 if taken as exact.

    The derivatives by it: of the ``columns`` (U, c, p, 4) behind the model, known torques and signals, and of the
    residuals of the ``known`` parameters (k,).
    """

    source: str
    value: float
    std: float
    columns: np.ndarray
    known: np.ndarray

    def changed(self, problem: Problem, by: float) -> Problem:
        """Return a problem with the constant, no known parameter, increased ``by`` an amount."""
        blocks = problem.blocks.copy()
        blocks[..., KNOWN:] += by * self.columns
        return replace(problem, blocks=blocks)


def stated_constants(system: System) -> list[StatedConstant]:
    """List all constants that give the scale: payloads' parameters, torque sensors, wrenches, known parameters.

    The last three are scales, of value 1, of each sensor, of all wrenches, and of all known parameters together.
    """
    problem, constants = system.problem, list[StatedConstant]()
    known = problem.known[:, -1]
    by_channel = np.eye(len(problem.channels))[:, :, None, None]

    def add(
        source: str, value: float, std: float, torques: np.ndarray | float, readings: np.ndarray | float, share: float
    ) -> None:
        columns = np.zeros((*problem.blocks.shape[:3], FIXED))
        columns[..., KNOWN] = torques
        columns[..., SIGNALS] = readings * problem.blocks[..., SIGNALS]
        constants.append(StatedConstant(source, value, std, columns, -share * known))

    payloads: dict[str, Payload] = {}
    for load in system.payloads:
        if load.acts:
            payloads.setdefault(load.payload.name, load.payload)
    for name, payload in payloads.items():
        for kind, value in known_values(payload).items():
            std = payload.mass_std if kind == "m" else 0.0
            add(f"payload '{name}'", value, std, _torques_of_unit(system, name, kind), 0.0, 0.0)
    for k in problem.sensor_channels:
        channel = problem.channels[k]
        add(f"{channel.kind.name} of '{channel.joint}'", 1.0, channel.std, 0.0, by_channel[k], 0.0)
    if problem.base or system.wrench_columns is not None:
        torques = 0.0 if system.wrench_columns is None else system.wrench_columns
        channels = system.dataset.runs[0].channels
        std = max((channel.std for channel in channels if not channel.kind.measures_joint), default=0.0)
        add(_wrenches(problem), 1.0, std, torques, by_channel[problem.base].sum(axis=0), 0.0)
    if len(known):
        source = SCALED_BY_FILE if system.dataset.scaled_by_file else "known parameters"
        add(source, 1.0, 0.0, 0.0, 0.0, 1.0)
    return constants


def _torques_of_unit(system: System, name: str, kind: str) -> np.ndarray:
    """Compute the torques (U, c, p) of a unit of a payload's parameter, in the rows of the problem."""
    dataset = system.dataset
    parts, channels = [np.zeros(factor.R.shape[:3]) for factor in dataset.factors], system.problem.channels
    for run, label in ((item.run, item.label) for item in system.payloads if item.payload.name == name):
        block = next(item for item in system.effects if Parameter(kind, label) in item.stated)
        k, R = block.names.index(Parameter(kind, label)), dataset.factors[run].R
        columns = [block.columns(run, channel, np.zeros(()))[:, k] for channel in channels]
        parts[run] = np.stack([R[:, j] @ column for j, column in enumerate(columns)], axis=1)
    filled = np.concatenate([factor.rows for factor in dataset.factors]).sum(axis=1) > 0
    return np.concatenate(parts)[filled]


def _wrenches(problem: Problem) -> str:
    """Name the measured wrenches; with a base that floats they are those on the base too."""
    base = [problem.channels[k].joint for k in problem.base]
    if base and problem.wrenches:
        return "measured wrenches"
    bodies = problem.wrenches or base[-1:]
    return f"wrench{'es' * (len(bodies) > 1)} on {', '.join(repr(body) for body in bodies)}"


def estimate_slopes(fit: Fit, constants: Sequence[StatedConstant]) -> np.ndarray:
    """Differentiate (theta, gains, delays) with respect to stated constants, (k, m), at the solution."""
    problem, solution, weights = fit.system.problem, fit.solution, weights_of(fit)
    triangles, known = stacked(problem), jacobian_of_known(problem, fit.free_gains)
    J = weighted(fit, triangles)[1].reshape(-1, known.shape[1])
    back = whitening(np.concatenate([J, known]), curvature_of_delays(triangles, solution.values, problem, weights))
    block_jacobian = jacobian(problem.blocks, solution.values, problem, fit.free_gains)
    sides = []
    for constant in constants:
        read, torques = delayed_signal(constant.columns, solution.delays), constant.columns[..., KNOWN]
        change = read - torques / solution.gains[:, None]
        side = np.einsum("ujpk,ujp,j->k", block_jacobian, change, weights**2)
        sides.append(side + known.T @ constant.known)
    T = slopes_of(fit)
    return np.asarray(-(T @ back) @ (back.T @ np.reshape(sides, (-1, len(back))).T))


def scale_shares(fit: Fit) -> dict[str, np.ndarray]:
    """Find the share of each source in the scale of the joints' estimated gains, source to (n,); they add up to one."""
    constants, shares = stated_constants(fit.system), dict[str, np.ndarray]()
    slopes = estimate_slopes(fit, constants)[fit.system.problem.gain_rows]
    for constant, slope in zip(constants, slopes.T, strict=True):
        shares[constant.source] = shares.get(constant.source, 0.0) + constant.value * slope / fit.gains
    total = np.sum(list(shares.values()), axis=0)  # one, up to the curvature that the linear equations lack
    total = np.where(total == 0.0, 1.0, total)  # of a base, whose gain is known
    return {source: share / total for source, share in shares.items()}


def scale_uncertainty(system: System, solve: Solve) -> np.ndarray:
    """Compute the covariance of (theta, gains, delays) that the uncertainty of stated constants adds, (k, k).

    Each constant is larger and smaller by its standard deviation, and ``solve`` says how far the estimates move: those
    of an estimator that minimises no squares do not have the derivatives of :func:`estimate_slopes`. The uncertainty of
    known parameters is in the solution's own covariance.
    """
    problem = system.problem
    extra = np.zeros((len(problem.unknowns),) * 2)
    for constant in stated_constants(system):
        if std := constant.std:
            above, below = (solve(constant.changed(problem, by)).values for by in (std, -std))
            extra += np.outer(above - below, above - below) / 4
    return extra
