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


def two_stage(problem: Problem) -> Solution:
    """Solve two-stage least squares (2SLS).

    The currents are first projected on their own joint's regressor columns, which removes noise uncorrelated with the
    motion; the known payload is then alone on the right-hand side.
    """
    delays, n = problem.own_delays, len(problem.channels)
    coefficients = [
        least_squares(R[:, columns], delayed_signal(R, d))
        for R, columns, d in zip(problem.triangles, problem.own_columns, delays, strict=True)
    ]

    def projected(j: int, block: np.ndarray) -> np.ndarray:
        """Build rows of ``W_tot`` with projected currents from a block of channel j."""
        return problem.total_rows_of(block, j, block[:, problem.own_columns[j]] @ coefficients[j])

    blocks = [projected(j, R) for j, R in enumerate(problem.triangles)]
    known = problem.total_known
    gains = np.ones(n)
    for _ in range(3):
        scale = 1 / (problem.own_sigma * np.abs(gains))
        weighted = (block * weight for block, weight in zip(blocks, scale, strict=True))
        A = np.concatenate([*weighted, known])
        x = least_squares(A[:, :-1], -A[:, -1])
        if not any(block[:, -1].any() for block in blocks):  # noise biases a scale by known parameters towards zero
            explained = known[:, :-1] @ x
            x *= -(known[:, -1] @ explained) / max(explained @ explained, 1e-300)
        gains = np.where(problem.unknown_gains, x[problem.unknowns.gains], 1.0)
        if not np.all(np.abs(gains) > 0):
            raise GtauError(
                "the currents of some joint are unrelated to its motion; check the columns of the current references."
            )
    values = np.concatenate([x[problem.unknowns.theta], gains, delays])
    solution = finish(problem, values, problem.weights(squared(stacked(problem), values)), True)

    def replicates() -> np.ndarray:
        norms = np.linalg.norm(A[:, :-1], axis=0)
        norms[norms == 0] = 1.0
        back = np.linalg.pinv(triangle(A[:, :-1] / norms)) / norms[:, None]
        blocks = []
        for block in problem.units:
            # with the coefficients of all units
            A_u = np.concatenate([projected(j, block[j]) * scale[j] for j in range(n)])
            e_u = (residuals(block, values) * (scale * gains)[:, None]).reshape(-1)
            white = A_u[:, :-1] @ back
            blocks.append((white.T @ white, white.T @ e_u))
        steps = one_step(blocks) @ back.T
        return np.hstack([steps, np.zeros((len(steps), n))])  # all units have the same delays

    return replace(solution, replicates=replicates)


TWO_STAGE = Estimator(
    "2sls", "two-stage least squares", Gains.ESTIMATED, lambda gains: two_stage, plain_fit(lambda gains: two_stage)
)
