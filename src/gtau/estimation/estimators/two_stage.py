"""Two-stage least squares (2SLS): currents are replaced by their projections on their own joint's regressor.

The start of maximum likelihood. Choose it for a cross-check: it is consistent with noisy currents, needs no
iteration, and shares no weights with the others.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.estimators.estimator import Estimator, Gains, Solution
from gtau.estimation.estimators.least_squares import plain_fit
from gtau.estimation.estimators.newton import finish, least_squares, one_step, residuals, squared, stacked
from gtau.estimation.regression.factors import delayed_signal, triangle
from gtau.estimation.regression.problem import Problem

EXPLAINED = 1e-10  # of the largest singular value: directions of the parameters that rounding leaves


def two_stage(problem: Problem, delays: np.ndarray | None = None) -> Solution:
    """Solve two-stage least squares (2SLS).

    The currents are first projected on their own joint's regressor columns, which removes noise uncorrelated with the
    motion; the known payload is then alone on the right-hand side. ``delays`` (c,), s, are the ones that each joint's
    own model explains best if left out.
    """
    delays = problem.own_delays if delays is None else delays
    n, theta_columns, gain_columns = len(problem.channels), problem.unknowns.theta, problem.unknowns.gains
    coefficients = [
        least_squares(R[:, columns], delayed_signal(R, d))
        for R, columns, d in zip(problem.triangles, problem.own_columns, delays, strict=True)
    ]
    blocks = [_rows(problem, j, R, coefficients[j]) for j, R in enumerate(problem.triangles)]
    gains = np.ones(n)
    for _ in range(3):
        scale = 1 / (problem.own_sigma * np.abs(gains))
        weighted = (block * weight for block, weight in zip(blocks, scale, strict=True))
        A = np.concatenate([*weighted, problem.total_known])
        x = least_squares(A[:, :-1], -A[:, -1])
        if not any(block[:, -1].any() for block in blocks):  # noise biases a scale by known parameters towards zero
            known = problem.total_known[:, :-1] @ x
            x *= -(problem.total_known[:, -1] @ known) / max(known @ known, 1e-300)
        gains = np.where(problem.unknown_gains, x[gain_columns], 1.0)
        if not np.all(np.abs(gains) > 0):
            raise GtauError(
                "the currents of some joint are unrelated to its motion; check the columns of the current references."
            )
    values = np.concatenate([x[theta_columns], gains, delays])
    solution = finish(problem, values, problem.weights(squared(stacked(problem), values)), True)

    def replicates() -> np.ndarray:
        norms = np.linalg.norm(A[:, :-1], axis=0)
        norms[norms == 0] = 1.0
        back = np.linalg.pinv(triangle(A[:, :-1] / norms)) / norms[:, None]
        blocks = []
        for block in problem.units:
            # the projected currents of a unit are its regressor's rows with the coefficients of all units
            A_u = np.concatenate([_rows(problem, j, block[j], coefficients[j]) * scale[j] for j in range(n)])
            e_u = (residuals(block, values) * (scale * gains)[:, None]).reshape(-1)
            white = A_u[:, :-1] @ back
            blocks.append((white.T @ white, white.T @ e_u))
        steps = one_step(blocks) @ back.T
        return np.hstack([steps, np.zeros((len(steps), n))])  # all units have the same delays

    return replace(solution, replicates=replicates)


def first_stage(problem: Problem, solution: Solution, lack: float) -> tuple[float, np.ndarray]:
    """Measure the strength of the instruments of two-stage least squares, and the remaining bias.

    The projected currents keep the part of their noise in the span of the instruments, which biases gains low, and the
    standard deviation does not show it: with weak instruments most of the bias of least squares (Stock and Yogo 2005).
    The equations are weighed at the gains and delays of ``solution``; ``lack`` are standard deviations over the
    standard deviations for independent residuals, 1 at least, which reduces the number of independent rows.

    The strength is the statistic of Cragg and Donald: the F of the combination of gains explained least, infinite where
    no gain is free or the equations leave no instrument to spare. The bias (n,) of the joints' gains is relative
    and to first order (Nagar 1959).
    """
    theta_columns, gain_columns, free = problem.unknowns.theta, problem.unknowns.gains, problem.unknown_gains
    parts = []
    for j, (R, columns, d) in enumerate(zip(problem.triangles, problem.own_columns, solution.delays, strict=True)):
        coefficients = least_squares(R[:, columns], delayed_signal(R, d))
        parts.append(_rows(problem, j, R, coefficients) / (lack * problem.own_sigma[j] * abs(solution.gains[j])))
    rows = np.concatenate([*parts, np.pad(problem.known[:, :-1], ((0, 0), (0, len(free) + 1)))])
    # currents in units of their own noise, less what the parameters that all joints share explain of them
    currents = (rows[:, gain_columns] * solution.gains)[:, free]
    norms = np.linalg.norm(rows[:, theta_columns], axis=0)
    U, s, _ = np.linalg.svd(rows[:, theta_columns] / np.where(norms > 0, norms, 1.0), full_matrices=False)
    U = U[:, s > EXPLAINED * s.max(initial=0.0)]
    instruments = sum(map(len, problem.own_columns)) + len(problem.known) - U.shape[1]
    bias = np.zeros(len(problem.channels))
    if not free.any() or instruments < 1:
        return np.inf, bias[: len(problem.joints)]
    _, s, Vt = np.linalg.svd(currents - U @ (U.T @ currents), full_matrices=False)
    ends = np.cumsum([len(part) for part in parts])
    local = [
        len(columns) - np.sum(U[end - len(part) : end] ** 2)
        for columns, part, end in zip(problem.own_columns, parts, ends, strict=True)
    ]
    bias[free] = -Vt.T @ ((Vt @ np.array(local)[free]) / np.maximum(s, np.finfo(float).tiny) ** 2)
    return float(s[-1] ** 2 / instruments), bias[: len(problem.joints)]


def _rows(problem: Problem, j: int, block: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Build rows of the second stage, ``W_tot`` with projected currents, from a block of channel j."""
    return problem.total_rows_of(block, j, block[:, problem.own_columns[j]] @ coefficients)


TWO_STAGE = Estimator(
    "2sls", "two-stage least squares", Gains.ESTIMATED, lambda gains: two_stage, plain_fit(lambda gains: two_stage)
)
