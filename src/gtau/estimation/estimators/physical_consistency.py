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

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.estimators.estimator import Solution, jackknife
from gtau.estimation.estimators.newton import jacobian, moved, residuals, stacked
from gtau.estimation.estimators.standard_parameters import (
    StandardUnknowns,
    constrained_least_squares,
    pseudo_inertia,
    standard_unknowns,
)
from gtau.estimation.regression.assembly import theta_equations
from gtau.estimation.regression.dataset import System
from gtau.estimation.regression.factors import leave_one_out, triangle
from gtau.estimation.regression.problem import Problem
from gtau.robots.robot import INERTIAL
from gtau.signals.reading.statements import Prior

Errors = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Gives the residuals (c, p) of blocks at estimates."""
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
    system: System, solution: Solution, plain: Solution, priors: Mapping[str, Prior], free_gains: bool
) -> Consistency:
    """Find physically consistent standard parameters, alone (gains given) or together with the gains.

    ``solution`` is without constraints; ``priors`` constrain standard parameters. Where effects beside the model moved
    it away from the ``plain`` one, what they add stays in the residuals, which the plain ones have there instead.
    Raises GtauError where no rigid bodies agree with the priors and payloads, or the programme does not converge.
    """
    problem, n, base = system.unreduced, len(system.unreduced.joints), system.dataset.base
    base_priors = theta_equations(base, system.dataset.model.parameter_names, problem.parameters, priors)
    unknowns, triangles = standard_unknowns(system, solution, priors), stacked(problem)
    free, unmoved = (
        np.concatenate([system.full(each.theta)[:-1], each.gains, each.delays]) for each in (solution, plain)
    )
    channels = len(triangles)

    def errors(blocks: np.ndarray, values: np.ndarray) -> np.ndarray:
        return residuals(blocks, values) - residuals(blocks, free) + residuals(blocks, unmoved)

    def squares(values: np.ndarray) -> np.ndarray:
        return np.asarray(np.sum(errors(triangles, values) ** 2, axis=-1))

    stated = np.insert(base_priors, [problem.n_theta] * ((2 if free_gains else 1) * channels), 0.0, axis=1)
    values = free
    for _ in range(STEPS):
        weights = problem.weights(squares(values))
        linear = _linear(errors, triangles, values, problem, weights, free_gains)
        x, rest = _programme(triangle(linear, stated), unknowns)
        step = np.concatenate([unknowns.S @ x - values[: problem.n_theta], rest])
        values = moved(values, step, channels)
        J = jacobian(triangles, values, problem, free_gains) * weights[:, None, None]
        if np.linalg.norm(J.reshape(-1, step.size) @ step) < CONVERGED * np.sqrt(step.size):
            break
    else:
        raise GtauError(
            "the search did not converge; resolve contradictions first, or give 'priors' for the parameters that the "
            "data leave open."
        )
    gain_std = _gain_std(errors, problem, values, weights, unknowns, stated) if free_gains else np.zeros(n)
    if free_gains and np.ndim(solution.prior_covariance):  # leaving out data does not show the uncertainty of priors
        gain_std = np.sqrt(gain_std**2 + np.diag(np.asarray(solution.prior_covariance))[system.problem.gain_rows])
    bodies = {body.name: body.values(x) for body in unknowns.rigid.bodies}
    shares = 100 * (np.sqrt(squares(values) / squares(free))[:n] - 1)
    gains = zip(problem.joints, values[problem.gain_rows], gain_std, strict=True)
    return Consistency(
        standard=dict(zip(system.dataset.model.parameter_names, map(float, x), strict=False)),
        payloads={
            load.label: dict(zip(INERTIAL, map(float, bodies[load.label]), strict=True)) for load in system.payloads
        },
        gains={joint: (float(gain), float(std)) for joint, gain, std in gains},
        moves=_moves(system, solution, values, free_gains),
        eigenvalues={body: float(np.linalg.eigvalsh(pseudo_inertia(values))[0]) for body, values in bodies.items()},
        loss=dict(zip(problem.joints, map(float, shares), strict=True)),
        open=base.without_effect,
    )


def _moves(system: System, solution: Solution, values: np.ndarray, free_gains: bool) -> tuple[Move, ...]:
    """List how far each parameter, and each gain that is free, is moved from its ``solution``, the most moved first."""
    consistent = dict(zip(system.unreduced.unknowns, values, strict=True))
    names = [name for name in system.problem.parameters if name.run is None]
    names += system.problem.unknowns[system.problem.gain_rows] if free_gains else ()
    std = np.sqrt(np.diag(solution.jackknife))
    moves = []
    for name in names:
        k = solution.unknowns.places[name]
        if std[k]:
            free, value = float(solution.values[k]), float(consistent[name])
            moves.append(Move(name, free, value, abs(value - free) / float(std[k])))
    return tuple(sorted(moves, key=lambda move: -move.deviations))


def _linear(
    errors: Errors, blocks: np.ndarray, values: np.ndarray, problem: Problem, weights: np.ndarray, free_gains: bool
) -> np.ndarray:
    """Build rows ``[J_theta J_rest | y]`` (., size + 1), linear in theta and in steps of 1/g and the delays."""
    J = jacobian(blocks, values, problem, free_gains) * weights[:, None, None]
    J, theta = J.reshape(-1, J.shape[-1]), values[: problem.n_theta]
    e = (errors(blocks, values) * weights[:, None]).reshape(-1)
    return np.column_stack([J, J[:, : len(theta)] @ theta - e])


def _programme(R: np.ndarray, unknowns: StandardUnknowns) -> tuple[np.ndarray, np.ndarray]:
    """Solve one convex programme for unknowns x, and steps of 1/g and of the delays."""
    parameters, c = unknowns.S.shape
    R, y = R[:-1, :-1], R[:-1, -1]  # the last row is the residual of the unconstrained fit
    rest = R[:, parameters:]
    prior = np.hstack([np.diag(1 / unknowns.std), np.zeros((c, rest.shape[1]))])
    A = np.concatenate([np.hstack([R[:, :parameters] @ unknowns.S, rest]), prior])
    sizes = np.linalg.norm(rest, axis=0)
    rigid = unknowns.rigid.beside(1 / np.where(sizes > 0, sizes, 1.0))
    solved = constrained_least_squares(A, np.concatenate([y, unknowns.centre / unknowns.std]), rigid)
    return solved[:c], solved[c:]


def _gain_std(
    errors: Errors,
    problem: Problem,
    values: np.ndarray,
    weights: np.ndarray,
    unknowns: StandardUnknowns,
    stated: np.ndarray,
) -> np.ndarray:
    """Compute standard deviations of the gains (n,) under the constraints, by the delete-one jackknife."""
    n = len(problem.joints)
    factors = [triangle(_linear(errors, unit, values, problem, weights, True)) for unit in problem.units]
    steps = [_programme(triangle(R, stated), unknowns)[1][:n] for R in leave_one_out(factors)]
    gains = 1 / (1 / values[problem.gain_rows] + np.array(steps))
    return np.sqrt(np.diag(jackknife(gains)))
