"""Fits of the same rows under another description, compared with the user's by their likelihood."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.effects.effect import EstimatedEffect
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.priors import require_scale
from gtau.findings import Finding, Grade
from gtau.signals.reading.statements import Payload


def refitted(
    fit: Fit, payloads: Sequence[Payload | None] | None = None, dataset: Dataset | None = None, method: str = "ml"
) -> Fit | None:
    """Fit the same equations with other loads, or another dataset's priors; None where then nothing gives the scale."""
    system = fit.system.again(dataset, payloads=payloads)
    payloads = [run.payload for run in fit.dataset.runs] if payloads is None else payloads
    try:
        if fit.free_gains:
            require_scale(fit.dataset.robot, system.problem, system.stated, payloads, method)
        solution = fit.solve(system.problem)
    except GtauError:
        return None
    return replace(fit, system=system, solution=solution)


def unrefined(fit: Fit) -> Fit:
    """Give a fit the residuals of one pass, to compare with other fits."""
    return replace(fit, solution=replace(fit.solution, sigma=fit.solve(fit.system.problem).sigma))


def residual_ratio(other: Fit, unaltered: Fit) -> float:
    """Compute the residual variance relative to another fit, the geometric mean over all channels (the likelihood's).

    So a single joint that feels gravity, say, counts among many that do not.
    """
    rows = unaltered.system.problem.total_rows
    return float(np.exp(2 * rows @ np.log(other.solution.sigma / unaltered.solution.sigma) / rows.sum()))


def described_otherwise(fit: Fit, effect: str, cause: Finding, other: Fit, unaltered: Fit) -> EstimatedEffect:
    """Compare a fit with another description to the ``unaltered`` one, with the user's description."""
    rows, ratio = unaltered.system.problem.total_rows, other.solution.sigma / unaltered.solution.sigma
    likelihood = -float(rows @ np.log(ratio))
    share = min(1 - float(rows @ ratio**2 / rows.sum()), 1.0)
    change = 100 * (other.gains / unaltered.gains - 1) if fit.free_gains else np.zeros(len(fit.gains))
    moves = dict(zip(fit.dataset.model.actuated, map(float, change), strict=True))
    moves = {joint: move for joint, move in moves.items() if joint in fit.dataset.robot.motors}
    return EstimatedEffect(effect, cause, 1.0, 0.0, "", likelihood, share, moves, description=True)


def untested(check: str, refusal: GtauError) -> Finding:
    """Note that a check refused these data."""
    return Finding(
        "other estimators not tried",
        text=f"{check} could not be tested: {str(refusal).removesuffix('.')}",
        grade=Grade.INFORMATION,
        shown_as="reading",
    )
