"""Physically consistent standard parameters behind the identified base parameters.

The data determine sums of standard parameters only. Simulation and control need every one of
them, and a positive definite mass matrix: so the fit is repeated over the standard parameters, with
a positive definite pseudo-inertia for every link, platform and payload, the mass of every body within reach
of its joints, friction and rotor inertia not negative, and the bounds and priors that are given. With the
gains free it is a sequence of convex programmes, each one Gauss-Newton step of the maximum likelihood in
the current domain.

Unidentifiable directions are taken close to a plausible robot: solid links of equal masses, no friction.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.estimators.estimator import Iterate, Solution, jackknife
from gtau.estimation.estimators.newton import jacobian, residuals, stacked
from gtau.estimation.estimators.standard_parameters import (
    StandardUnknowns,
    constrained_least_squares,
    pseudo_inertia,
    standard_unknowns,
)
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.equations import leave_one_out, triangle
from gtau.estimation.regression.priors import of_theta
from gtau.estimation.regression.problem import Problem
from gtau.estimation.regression.system import System
from gtau.robots.parameter import Parameter
from gtau.robots.robot import INERTIAL
from gtau.signals.reading.statements import Prior

STEPS = 40
CONVERGED = 1e-3  # of a standard deviation


@dataclass(frozen=True)
class Move:
    """Shift of a number by consistency: its value without and with it, and the shift in standard deviations."""

    name: str
    free: float
    consistent: float
    deviations: float


@dataclass(frozen=True)
class Consistency:
    """Physically consistent standard parameters.

    Attributes
    ----------
    standard : dict
        Every standard parameter by name, SI units.
    payloads : dict
        Label (``L3``) of each carried payload to its ten inertial parameters by kind.
    gains : dict
        Joint to (drive gain, standard deviation) found together with them; the latter is 0 where given.
    moves : tuple of Move
        Every base parameter and gain, the most moved first.
    eigenvalues : dict
        Smallest eigenvalue of the pseudo-inertia of each body, SI units.
    loss : dict
        Joint to the growth of its residual, per cent.
    open : tuple of str
        Standard parameters without effect on actuated joints, chosen and not identified.
    """

    standard: Mapping[str, float]
    payloads: Mapping[str, Mapping[str, float]]
    gains: Mapping[str, tuple[float, float]]
    moves: tuple[Move, ...]
    eigenvalues: Mapping[str, float]
    loss: Mapping[str, float]
    open: tuple[str, ...]


def consistent(
    dataset: Dataset, system: System, solution: Solution, priors: Mapping[str, Prior], free_gains: bool
) -> Consistency:
    """Find physically consistent standard parameters, alone (gains given) or together with the gains.

    Parameters
    ----------
    dataset, system, solution : Dataset, System, Solution
        The identification without constraints.
    priors : mapping
        Standard parameter to its prior.
    free_gains : bool
        Estimate the gains again, under the constraints.

    Raises
    ------
    GtauError
        Where no rigid bodies agree with the priors and payloads, the programme does not converge, or
        its solver is not installed.
    """
    problem, n = system.whole, len(system.whole.joints)
    of_base = of_theta(dataset.base, dataset.model.parameter_names, problem.parameters, priors)
    unknowns = standard_unknowns(dataset, system, solution, priors)
    triangles = stacked(problem)
    values = dict(zip(system.problem.parameters, solution.theta, strict=True))
    theta = np.array([values.get(name, 0.0) for name in problem.parameters])
    state = Iterate(theta, 1 / solution.gains, solution.delays)

    def errors(at: Iterate) -> np.ndarray:
        return np.sum(residuals(triangles, at) ** 2, axis=-1)

    before = errors(state)
    for _ in range(STEPS):
        weights = 1 / np.maximum(np.sqrt(errors(state) / problem.total_rows), problem.smallest_sigma)
        linear = _linear(triangles, state, problem, weights, free_gains)
        stated = np.insert(of_base, [len(theta)] * (linear.shape[1] - of_base.shape[1]), 0.0, axis=1)
        x, rest = _programme(triangle(linear, stated), unknowns)
        step = np.concatenate([unknowns.S @ x - state.theta, rest])
        state = state.moved(step)
        J = jacobian(triangles, state, problem, free_gains) * weights[:, None, None]
        if np.linalg.norm(J.reshape(-1, step.size) @ step) < CONVERGED * np.sqrt(step.size):
            break
    else:
        raise GtauError(
            "the search for physically consistent parameters did not converge; give 'priors' for the parameters that "
            "the data leave open, or identify without --consistent."
        )
    gain_std = _gain_std(problem, state, weights, unknowns, stated) if free_gains else np.zeros(n)
    if free_gains and np.ndim(solution.of_prior):  # leaving out data does not show the uncertainty of priors
        gain_std = np.sqrt(gain_std**2 + np.diag(np.asarray(solution.of_prior))[system.problem.gain_rows])
    std = dict(zip(system.problem.parameters, np.sqrt(np.diag(solution.jackknife)), strict=False))
    gains, free_std = 1 / state.b[:n], np.sqrt(np.diag(solution.jackknife))[len(values) : len(values) + n]
    moves = [
        Move(name, values[name], float(value), abs(float(value) - values[name]) / std[name])
        for name, value in zip(problem.parameters, state.theta, strict=True)
        if name.run is None and std.get(name)
    ]
    moves += [
        Move(Parameter("gain", joint), float(a), float(b), float(abs(b - a) / s))
        for joint, a, b, s in zip(problem.joints, solution.gains[:n], gains, free_std, strict=True)
        if free_gains
    ]
    count = len(dataset.model.parameter_names)
    return Consistency(
        standard={name: float(value) for name, value in zip(unknowns.names[:count], x[:count], strict=True)},
        payloads={
            body.name: dict(zip(INERTIAL, map(float, body.values(x)), strict=True))
            for body in unknowns.bodies[len(unknowns.bodies) - len(system.payloads) :]
        },
        gains={joint: (float(g), float(s)) for joint, g, s in zip(problem.joints, gains, gain_std, strict=True)},
        moves=tuple(sorted(moves, key=lambda move: -move.deviations)),
        eigenvalues={
            body.name: float(np.linalg.eigvalsh(pseudo_inertia(body.values(x)))[0]) for body in unknowns.bodies
        },
        loss={
            joint: 100 * float(np.sqrt(after / first) - 1)
            for joint, first, after in zip(problem.joints, before[:n], errors(state)[:n], strict=True)
        },
        open=dataset.base.without_effect,
    )


def _linear(blocks: np.ndarray, state: Iterate, problem: Problem, weights: np.ndarray, free_gains: bool) -> np.ndarray:
    """Build rows ``[J_theta J_rest | y]`` (., size + 1), linear in theta and in steps of 1/g and the delays."""
    J = jacobian(blocks, state, problem, free_gains) * weights[:, None, None]
    J = J.reshape(-1, J.shape[-1])
    e = (residuals(blocks, state) * weights[:, None]).reshape(-1)
    return np.column_stack([J, J[:, : len(state.theta)] @ state.theta - e])


def _programme(R: np.ndarray, unknowns: StandardUnknowns) -> tuple[np.ndarray, np.ndarray]:
    """Solve one convex programme for unknowns x, and steps of 1/g and of the delays."""
    parameters, c = unknowns.S.shape
    R, y = R[:-1, :-1], R[:-1, -1]  # the last row is the residual of the unconstrained fit
    rest = R.shape[1] - parameters
    A = np.zeros((len(R) + c, c + rest))
    A[: len(R), :c], A[: len(R), c:] = R[:, :parameters] @ unknowns.S, R[:, parameters:]
    A[len(R) :, :c] = np.diag(1 / unknowns.spread)
    sizes = np.linalg.norm(R[:, parameters:], axis=0)
    free = np.full(rest, np.inf)
    solved = constrained_least_squares(
        A,
        np.concatenate([y, unknowns.centre / unknowns.spread]),
        unknowns.bodies,
        np.concatenate([unknowns.lower, -free]),
        np.concatenate([unknowns.upper, free]),
        np.concatenate([unknowns.unit, 1 / np.where(sizes > 0, sizes, 1.0)]),
        unknowns.mass,
        unknowns.length,
        np.pad(unknowns.within, ((0, 0), (0, rest))),
    )
    return solved[:c], solved[c:]


def _gain_std(
    problem: Problem, state: Iterate, weights: np.ndarray, unknowns: StandardUnknowns, stated: np.ndarray
) -> np.ndarray:
    """Compute standard deviations of the gains (n,) under the constraints, by the delete-one jackknife."""
    n = len(problem.joints)
    factors = [triangle(_linear(unit, state, problem, weights, True)) for unit in problem.units]
    left = (triangle(R, stated) for R in leave_one_out(factors))
    gains = np.array([1 / (state.b[:n] + _programme(R, unknowns)[1][:n]) for R in left])
    return np.sqrt(np.diag(jackknife(gains)))
