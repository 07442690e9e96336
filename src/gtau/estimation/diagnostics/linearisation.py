"""The errors of a solution along pieces of the runs, beside what may explain them: more columns than the model has."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gtau.estimation.estimators.newton import jacobian, residuals
from gtau.estimation.estimators.solution import Solution
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.factors import CURRENTS, EXTRA
from gtau.estimation.regression.rows import Rows, stream_rows
from gtau.estimation.regression.system import System
from gtau.estimation.regression.triangle import triangle
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.signals.preparation import InMemoryRun

SAMPLES = 40_000  # that are looked at, of all runs together
RANK = 1e-6  # of the largest singular value: less is not told

CandidateColumns = Callable[[InMemoryRun, np.ndarray, Iterator[Rows]], Iterator[tuple[Rows, np.ndarray]]]
"""Gives each block of a piece's rows its torques offered (n, K, m), from the values of the base columns (n_b,)."""


@dataclass(frozen=True, eq=False)
class LinearisedWindow:
    """Rows of a piece reduced to triangles, in standard deviations of the current.

    ``errors`` (n, p), their ``jacobian`` (n, p, k) by the unknowns of
    :func:`gtau.estimation.estimators.newton.jacobian`, and by the m torques ``offered`` (n, p, m).
    """

    errors: np.ndarray
    jacobian: np.ndarray
    offered: np.ndarray


def central_windows(dataset: Dataset, pieces: int = 1) -> list[tuple[int, InMemoryRun]]:
    """The middle of every run, at most ``SAMPLES`` of all together, in so many ``pieces``, each with its run's number.

    Runs too short for a row of each piece are left out.
    """
    found = []
    for run, whole in enumerate(dataset.prepared):
        size = min(SAMPLES // len(dataset.prepared), len(whole)) // pieces
        if dataset.preparation.at(whole.run.rate).decimator.outputs(size) == 0:
            continue
        begin = (len(whole) - size * pieces) // 2
        starts = (begin + k * size for k in range(pieces))
        found += [(run, InMemoryRun(whole.run, whole.samples(start, start + size))) for start in starts]
    return found


def linearise(
    dataset: Dataset,
    system: System,
    solution: Solution,
    free_gains: bool,
    offer: CandidateColumns,
    pieces: Iterable[tuple[int, InMemoryRun]],
    model: InverseDynamics | None = None,
) -> list[LinearisedWindow]:
    """Errors along ``pieces`` of the runs, their Jacobian, and what is offered to explain them.

    Those of another ``model`` of the robot, where one is given.

    Raises
    ------
    GtauError
        Where what is offered cannot be computed along a run.
    """
    problem, n = system.problem, len(dataset.model.actuated)
    model = dataset.model if model is None else model
    regressor = model.columns(dataset.base.standard)
    b, p = dataset.base.count, dataset.base.count + EXTRA
    kept = [system.whole.parameters.index(name) for name in problem.parameters]
    columns = [*kept, *range(system.whole.n_theta, system.whole.n_theta + 1 + CURRENTS)]
    state = solution.iterate
    weights = 1 / np.maximum(solution.sigma, problem.smallest_sigma)
    with_load = any(term.startswith("fl_") for term in system.friction.terms)
    found = []
    for run, piece in pieces:
        load = system.load(run, solution.theta) if with_load else None
        rows = stream_rows(model, regressor, piece, dataset.preparation.at(piece.run.rate).decimator, load)
        waiting: list[list[np.ndarray]] = [[] for _ in range(n)]
        for part, torques in offer(piece, system.motion(run, solution.theta), rows):
            m = torques.shape[-1]
            A = np.zeros((n, len(part.time), p + m))
            A[regressor.rows, :, regressor.columns] = part.entries
            A[:, :, b : p - CURRENTS] = part.terms.transpose(1, 2, 0)
            A[:, :, p - CURRENTS : p] = part.currents.transpose(1, 2, 0)
            A[:, :, p:] = torques
            for j in range(n):
                waiting[j].append(A[j, part.keep[j]])
        blocks, offered = np.zeros((n, p + m, len(columns))), np.zeros((n, p + m, m))
        for j in range(n):
            T = triangle(*waiting[j])
            blocks[j, : len(T)] = (T[:, :p] @ system.maps[run, j])[:, columns]
            offered[j, : len(T)] = -state.b[j] * weights[j] * T[:, p:]
        e, J = residuals(blocks, state, problem.n_theta), jacobian(blocks, state, problem, free_gains)
        found.append(LinearisedWindow(e * weights[:, None], J * weights[:, None, None], offered))
    return found


def nothing(piece: InMemoryRun, values: np.ndarray, rows: Iterator[Rows]) -> Iterator[tuple[Rows, np.ndarray]]:
    """No torques are offered."""
    for part in rows:
        yield part, np.zeros((*part.keep.shape, 0))


def stack(pieces: Sequence[LinearisedWindow]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors (.,), Jacobian (., k) and what is offered (., m) of all joints in all pieces."""
    return (
        np.concatenate([each.errors.ravel() for each in pieces]),
        np.concatenate([of_joint for each in pieces for of_joint in each.jacobian]),
        np.concatenate([of_joint for each in pieces for of_joint in each.offered]),
    )


def least_squares_step(J: np.ndarray, e: np.ndarray) -> np.ndarray:
    """The steps (k, ...) that make ``e + J step`` least, in the directions that the pieces tell."""
    scale = np.linalg.norm(J, axis=0)
    scale[scale == 0] = 1.0
    return np.asarray((np.linalg.lstsq(J / scale, -e, rcond=RANK)[0].T / scale).T)
