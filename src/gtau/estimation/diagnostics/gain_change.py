"""Currents that change between runs.

Friction may differ between runs, and has values of its own in each (:mod:`gtau.estimation.regression.friction`); a
drive gain may not, as a payload is weighed by how loaded and unloaded runs differ. A motor that got warmer, by 2 per
cent of its torque constant, can move the gain by 5. All that the payload does not add to is the same in all runs, and
shows it: the current of the model is offered once more in these runs alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gtau.estimation.diagnostics.alternatives import Alternative, established, support
from gtau.estimation.diagnostics.linearisation import LinearisedWindow
from gtau.estimation.diagnostics.score_test import score_tests
from gtau.estimation.estimators.estimator import Fit, Solution
from gtau.estimation.estimators.newton import jacobian, jacobian_of_known, residuals, to_gains
from gtau.estimation.regression.equations import KNOWN, modelled
from gtau.estimation.regression.problem import Problem
from gtau.estimation.thresholds.estimates import DOMINANT, PLAUSIBLE_GAIN_CHANGE, SCALED, TIE
from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.findings.words import RELATIVE


def gain_changes(fit: Fit) -> list[Alternative]:
    """Find the most significant change of every joint's current between one run, or the loaded ones, and the others.

    Its size is the relative increase of the current, its share that of the residual variance of all joints where each
    has such a change in these runs. Changes that no motor makes, of sign or unit, are left to other checks.
    """
    problem, solution, gains = fit.system.problem, fit.solution, fit.gains
    positions = fit.system.block_positions  # number of the run, and time from its beginning (0) to its end (1)
    runs, of_block = np.unique(positions[:, 0].astype(int), return_inverse=True)
    loaded = np.zeros(len(runs), dtype=bool)
    np.logical_or.at(loaded, of_block, np.any(problem.blocks[..., KNOWN], axis=(1, 2)))
    groups = np.unique(np.vstack([np.eye(len(runs), dtype=bool), loaded]), axis=0)
    groups = groups[~groups.all(axis=1) & groups.any(axis=1)]
    if not len(groups):
        return []
    tried = len(np.unique(groups ^ groups[:, :1], axis=0))  # larger in some runs is smaller in the others
    known = jacobian_of_known(problem, problem.n_theta + 2 * len(problem.channels))
    offers, clusters = [(slice(None), False)], np.unique(problem.block_numbers, return_inverse=True)[1]
    (tests,) = score_tests(lambda: _windows(problem, solution, groups[:, of_block]), offers, clusters, known)
    shares = tests.share.sum(axis=1)
    worst = _first_largest(np.abs(tests.t[:, : len(gains)]))
    if shares.max() > DOMINANT:  # the same runs for all joints
        worst[:] = _first_largest(shares)
    T = to_gains(solution.iterate, problem.n_theta, True)
    found = []
    for j, k in enumerate(worst):
        change, t = float(tests.size[k, j]), float(tests.t[k, j])
        if not t or abs(change) > SCALED:
            continue  # reversed, or in another unit: other checks name these better
        names = [fit.dataset.runs[run].name for run in runs[groups[k]]]
        cause = Finding(F.GAIN_CHANGE, (problem.joints[j],), "", {"runs": names, "change": change})
        moves = (T @ tests.slopes[k, j])[problem.gain_rows] * change / gains
        std = abs(change / t)
        factor, moment = support(change, std, PLAUSIBLE_GAIN_CHANGE)
        each = established(fit, "gain change", cause, moves, float(shares[k]), change, std, RELATIVE)
        factor -= np.log(tried)  # the largest of several changes is larger by chance
        found.append(replace(each, plausible=PLAUSIBLE_GAIN_CHANGE, log_factor=factor, second_moment=moment))
    return found


def _first_largest(values: np.ndarray) -> np.ndarray:
    """Find the first of the largest values along the first axis, robust to rounding of ties.

    Of two runs one is larger as significantly as the other is smaller.
    """
    return np.asarray(np.argmax(values >= (1 - TIE) * values.max(axis=0), axis=0))


def _windows(problem: Problem, solution: Solution, members: np.ndarray) -> Iterator[LinearisedWindow]:
    """Build the jackknife blocks, each joint offered its model's current again in each group (groups, U)."""
    state = solution.iterate
    weights = 1 / np.maximum(solution.sigma, problem.smallest_sigma)
    for block, mine in zip(problem.blocks, members.T, strict=True):
        e, J = residuals(block, state), jacobian(block, state, problem, True)
        current = modelled(block, state.theta) * state.b[:, None]
        yield LinearisedWindow(
            e * weights[:, None], J * weights[:, None, None], -(current * weights[:, None])[..., None] * mine
        )
