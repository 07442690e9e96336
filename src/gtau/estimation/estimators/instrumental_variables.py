"""Instrumental variables (IDIM-IV): the equations as measured, weighted by a motion without noise.

Encoder noise is amplified twice by differentiation to accelerations. It enters the regressor, so least squares and
maximum likelihood underestimate every parameter, the more so the poorer the filter. The method of Janot et al.
multiplies the equations not by the Jacobian J of the errors e, but by the same Jacobian along a motion simulated with
the current estimate, whose errors are uncorrelated with the errors of the equations:

    J_s^T e = 0    instead of    J^T e = 0 ,

solved by Newton's method and simulated again with the new estimate until convergence. Choose it where encoders are
coarse or noisy, or the filter is poor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.estimators.didim import resimulated_runs
from gtau.estimation.estimators.estimator import Estimator, Fit, Gains, Solution
from gtau.estimation.estimators.maximum_likelihood import ml_or_wls
from gtau.estimation.estimators.newton import RANK, moved, one_step, squared, to_gains, weighted
from gtau.estimation.regression.dataset import Dataset, System
from gtau.estimation.regression.factors import EXTRA, SIGNALS, Factors, Triangles, triangle
from gtau.estimation.regression.problem import Problem
from gtau.estimation.regression.rows import stream_rows
from gtau.estimation.regression.run_blocks import block_of
from gtau.findings import Progress, silent
from gtau.robots.parameter import DRY, TERMS
from gtau.signals.preparation.prepared_run import SampleWindow

PASSES = 6  # simulations
SAME = 0.01  # standard deviations: a smaller change ends them
STEPS = 50
CONVERGED = 1e-8  # of a standard deviation


@dataclass(frozen=True, eq=False)
class Pair:
    """The same equations along the motion ``measured`` and the one ``simulated``; ``merged`` has all units."""

    measured: Problem
    simulated: Problem
    merged: tuple[np.ndarray, np.ndarray]

    def of(self, parameters: Sequence[str]) -> Pair:
        """Keep some parameters only, the others set to zero."""
        gone = [name for name in self.measured.parameters if name not in set(parameters)]
        columns = self.measured.columns_of(name for name in self.measured.parameters if name in set(parameters))
        measured, simulated = (rows[..., columns] for rows in self.merged)
        return Pair(self.measured.without(gone), self.simulated.without(gone), (measured, simulated))


def instrumental(system: System, solution: Solution, free_gains: bool, progress: Progress) -> tuple[Pair, Solution]:
    """Estimate by instrumental variables from a ``solution`` without; return equations too. Raises GtauError."""
    for k in range(PASSES):
        progress("simulation", k, PASSES)
        pair = paired(system, solution)
        before = solution
        solution = with_instruments(pair, solution, free_gains)
        std = np.sqrt(np.diag(solution.covariance))
        if np.all(np.abs(solution.values - before.values) <= SAME * std):
            break
    progress("simulation", PASSES, PASSES)
    return pair, solution


def with_instruments(pair: Pair, start: Solution, free_gains: bool) -> Solution:
    """Solve measured equations by the Jacobian of simulated ones, from gains and delays; raises GtauError."""
    problem, n = pair.measured, len(pair.measured.joints)
    values = np.concatenate([np.zeros(problem.n_theta), start.gains, start.delays])

    def linear(blocks: np.ndarray, instruments: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Linearise: weighted errors (., n p), their Jacobian (., n p, k) and the instruments' Jacobian."""
        e, J = weighted(blocks, values, problem, free, weights)
        return e, J, weighted(instruments, values, problem, free, weights)[1]

    for k in range(STEPS):
        free = free_gains and k > 0  # theta comes first: without it the model gives no currents for gains
        errors = squared(pair.merged[0], values)
        weights = problem.weights(errors)
        e, J, Z = linear(*pair.merged)
        norms = np.linalg.norm(Z, axis=0)
        norms[norms == 0] = 1.0
        Q, R = np.linalg.qr(Z / norms)
        U, s, Vt = np.linalg.svd(R)
        shown = s > RANK * s[0]  # a delay that is lost in noise has no column
        Q, back = Q @ U[:, shown], (Vt[shown] / norms).T / s[shown]
        A = Q.T @ J @ back  # not Z^T J, in which half of the digits would be lost
        if np.linalg.cond(A) * RANK > 1:
            raise GtauError(
                "instrumental variables do not determine the estimates, as the simulated motion shows nothing of some; "
                "use --method ml, or add runs that excite the parameters better."
            )
        step = -np.linalg.solve(A, Q.T @ e)
        values = moved(values, back @ step, n)
        if k > 0 and np.linalg.norm(step) < CONVERGED * np.sqrt(len(step)):
            break
    else:
        raise GtauError(
            "the iteration with instrumental variables did not converge, as the simulated motion is far from the "
            "measured one; use --method ml, or add runs that excite the parameters better."
        )
    sigma = np.sqrt(errors / np.maximum(problem.total_rows - len(step) / n, 1))
    T, inverse = to_gains(values, n, free_gains) @ back, np.linalg.inv(A)
    white = inverse @ (Q * np.repeat(sigma * weights, len(Q) // n)[:, None]).T

    def replicates() -> np.ndarray:
        blocks = []
        for block, other in zip(pair.measured.units, pair.simulated.units, strict=True):
            e_u, J_u, Z_u = linear(block, other)
            weighed = inverse @ (Z_u @ back).T
            blocks.append((weighed @ J_u @ back, weighed @ e_u))
        return one_step(blocks) @ T.T

    return Solution(problem.unknowns, values, sigma, T @ white @ white.T @ T.T, replicates)


def paired(system: System, solution: Solution) -> Pair:
    """Build the problem along the measured motion and along the simulated one."""
    dataset, simulated = system.dataset, resimulated_runs(system, solution)
    loads = system.loads(solution.theta)
    pairs = [_reduced(dataset, k, run, load) for k, (run, load) in enumerate(zip(simulated, loads, strict=True))]
    measured, instruments = (
        system.again(replace(dataset, factors=factors)).unreduced for factors in zip(*pairs, strict=True)
    )
    b = len(measured.parameters) + 1
    rows = np.concatenate([instruments.blocks[..., :b], measured.blocks], axis=-1)
    R = np.stack([triangle(*rows[:, j]) for j in range(len(measured.joints))])
    merged = R[..., b:], np.concatenate([R[..., :b], R[..., SIGNALS]], axis=-1)
    return Pair(measured, instruments, merged).of(system.problem.parameters)


def _reduced(dataset: Dataset, run: int, simulated: SampleWindow, load: np.ndarray | None) -> tuple[Factors, Factors]:
    """Reduce a run along the measured and the simulated motion, with the same instants row by row.

    The sign of a noisy speed is not the sign of the speed plus noise, so the columns of Coulomb friction are the
    simulated ones. The rows ``[W_s terms_s | W terms | v v' v'']`` are reduced together, and the triangle cut by
    columns.
    """
    model = dataset.model
    columns = dataset.base.standard
    measured = dataset.prepared[run]
    regressor = model.columns(columns)
    decimator = dataset.preparation.at(measured.run.rate).decimator
    blocks = block_of(dataset.prepared.edges[run], decimator.outputs(len(measured)))
    n, b = len(model.actuated), len(columns) + EXTRA - 3
    dry = np.flatnonzero([kind in DRY for kind in (*(name.kind for name in columns), *TERMS)])
    collected = Triangles([np.arange(2 * b + 3)] * n)
    streams = (stream_rows(model, regressor, along, decimator, load) for along in (simulated, measured))
    for part, other in zip(*streams, strict=True):
        A = np.zeros((n, len(part.time), 2 * b + 3))
        for begin, rows in ((0, part), (b, other)):
            end = begin + len(columns)
            A[regressor.rows, :, regressor.columns + begin] = rows.entries
            A[:, :, end : end + len(TERMS)] = rows.terms.transpose(1, 2, 0)
        A[:, :, b + dry] = A[:, :, dry]
        A[:, :, SIGNALS] = other.currents.transpose(1, 2, 0)
        collected.add(A, part.keep & other.keep, blocks[part.outputs])
    R, signals = collected.factors(2 * b + 3), np.arange(2 * b, 2 * b + 3)
    pair = (R[..., np.append(np.arange(begin, begin + b), signals)] for begin in (b, 0))
    along, instruments = (Factors(columns, collected.rows) for columns in pair)
    return along, instruments


def _fit(system: System, gains: np.ndarray | None = None, progress: Progress = silent) -> Fit:
    solver, free_gains = ml_or_wls(gains), gains is None
    pair, solution = instrumental(system, solver(system.problem), free_gains, progress)

    def solve_fixed(problem: Problem) -> Solution:
        return with_instruments(pair.of(problem.parameters), solution, free_gains=False)

    return Fit(system, solution, solver, solve_fixed, free_gains)


IV = Estimator(
    "iv",
    "instrumental variables along simulated motion (IDIM-IV)",
    Gains.EITHER,
    ml_or_wls,
    _fit,
    least_squares=False,
    takes_priors=False,
)
