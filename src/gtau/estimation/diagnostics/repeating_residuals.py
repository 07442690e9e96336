"""Residuals that repeat: at the same positions, and between runs of the same motion with different loads.

Ripple of the motors, cables and springs repeat at the same positions in every run, so the jackknife cannot detect their
effect on the estimates, but cross-validation can: each joint is offered a torque that is any function of its own
position (piecewise linear, one for each run, as encoders may have been set to zero in between), found in the first half
of each run and tried in the second, and the other way round. Where it reduces the errors, the torque is added in all
runs, and the resulting shift of the estimates is their uncertainty.

Model errors that depend on the motion alone are the same in runs which repeat it, and cancel in the gains. Residuals of
opposite sign depend on the load, and bias the gains as a wrong payload does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from gtau.estimation.diagnostics.alternatives import Alternative
from gtau.estimation.diagnostics.hypotheses.drives import FALLING_CONSTANT, LOAD_FRICTION
from gtau.estimation.diagnostics.linearisation import (
    SAMPLES,
    CandidateColumns,
    LinearisedWindow,
    at_full_rate,
    central_windows,
    errors_and_jacobian,
    known_rows,
    least_squares_step,
    linearise,
    on_channels,
    stack,
    window_rows,
)
from gtau.estimation.estimators.estimator import Fit, jackknife
from gtau.estimation.estimators.newton import to_gains
from gtau.estimation.regression.equations import BLOCKS, triangle
from gtau.estimation.thresholds.estimates import CORRELATED, CORRELATED_STD, PROBABLE, RIPPLE_SHARE
from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.signals.preparation.prepared_run import InMemoryRun

KNOTS = 24  # of the piecewise linear function, over a joint's range in all runs
LARGEST = 10.0  # times the joint's error: how large such a torque may be, more or less
OF_LOAD = (LOAD_FRICTION.kind, FALLING_CONSTANT.kind, F.GAIN_CHANGE)  # effects that depend on the load


@dataclass(frozen=True, eq=False)
class PositionRipple:
    """Residual torque that repeats at the same positions.

    ``shares`` (c,) of the variance of each channel's errors that one half of the runs predicts in the other, and by how
    much (theta, gains, delays) move when it is taken into account, ``moves`` (k,), which are zero where
    nothing repeats. A torque sensor does not feel the ripple of its motor.
    """

    shares: np.ndarray
    moves: np.ndarray

    @staticmethod
    def none(fit: Fit) -> PositionRipple:
        """Return a ripple of nothing."""
        return PositionRipple(np.zeros(len(fit.solution.gains)), np.zeros(len(fit.solution.values)))

    @property
    def found(self) -> bool:
        """Whether a ripple was found."""
        return bool(np.max(self.shares) >= RIPPLE_SHARE)

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of (theta, gains, delays) that it adds, (k, k)."""
        return np.outer(self.moves, self.moves)


def position_ripple(fit: Fit) -> PositionRipple:
    """Estimate the part of the residuals that repeats at the same positions.

    Parameters
    ----------
    fit : Fit
        What was estimated.
    """
    dataset, problem, solution = fit.dataset, fit.system.problem, fit.solution
    nothing = PositionRipple.none(fit)
    pieces = central_windows(dataset, pieces=2)
    low = np.min([piece.all.q.min(axis=0) for _, piece in pieces], axis=0)
    high = np.max([piece.all.q.max(axis=0) for _, piece in pieces], axis=0)
    knots = np.linspace(low, high, KNOTS)  # (KNOTS, n)
    width = np.maximum(knots[1] - knots[0], 1e-300)

    def offer(window: InMemoryRun, values: np.ndarray) -> CandidateColumns:
        q = window.samples().q.T
        hats = np.maximum(0.0, 1 - np.abs(q[:, None, :] - knots.T[:, :, None]) / width[:, None, None])
        return at_full_rate(window, dataset, hats.swapaxes(0, 1))

    found, known = linearise(fit, on_channels(offer, felt=False), pieces), known_rows(fit, pieces)
    first, second = found[0::2], found[1::2]
    sigma = np.maximum(solution.sigma, problem.smallest_sigma)
    heights = 1 / (LARGEST * np.abs(solution.gains) * sigma)
    again = [
        LinearisedWindow(each.errors + np.einsum("jpk,jk->jp", each.offered, torque), each.jacobian, each.offered)
        for half, other in ((first, second), (second, first))
        for each, torque in zip(half, _fit([other], heights, known)[1], strict=True)
    ]
    (_, rest), (step, before) = _left(again, known), _left(found, known)
    shares = 1 - rest / np.maximum(before, 1e-300)
    if np.max(shares) < RIPPLE_SHARE:
        return PositionRipple(shares, nothing.moves)
    repeats = shares > 0  # what of a joint does not repeat would only take up what its parameters explain
    moved, _ = _fit([first, second], np.where(repeats, heights, np.inf), known)
    state = solution.iterate
    return PositionRipple(shares, to_gains(state, fit.free_gains) @ (moved - step))


def _fit(
    halves: Sequence[Sequence[LinearisedWindow]], heights: np.ndarray, known: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Fit steps of the estimates (k,) and each run's torques at the knots (runs, n, KNOTS) together.

    Each half has one piece a run. A torque acts in one joint of one run only, so it is eliminated there; it is drawn
    to zero with the weight ``heights`` (c,), as it can stand in for a parameter, and is zero where that is infinite.
    """
    tops, rests = [], []
    for of_run in zip(*halves, strict=True):
        for j, height in enumerate(heights):
            rows = [np.column_stack([each.offered[j], each.jacobian[j], each.errors[j]]) for each in of_run]
            if np.isinf(height):
                height, rows = 1.0, [np.pad(each[:, KNOTS:], ((0, 0), (KNOTS, 0))) for each in rows]
            R = triangle(np.eye(KNOTS, rows[0].shape[1]) * height, *rows)
            tops.append(R[:KNOTS])
            rests.append(R[KNOTS:, KNOTS:])
    rest = np.concatenate([*rests, np.column_stack([known[1], known[0]])])
    step = least_squares_step(rest[:, :-1], rest[:, -1])
    torques = [-np.linalg.solve(top[:, :KNOTS], top[:, KNOTS:-1] @ step + top[:, -1]) for top in tops]
    return step, np.reshape(torques, (-1, len(heights), KNOTS))


def _left(pieces: Sequence[LinearisedWindow], known: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Fit steps of the estimates alone (k,), and compute the remaining squared errors, (n,)."""
    e, J, _ = stack(pieces)
    step = least_squares_step(np.concatenate([J, known[1]]), np.concatenate([e, known[0]]))
    return step, np.sum((e + J @ step).reshape(len(pieces), *pieces[0].errors.shape) ** 2, axis=(0, 2))


def ripple_findings(found: PositionRipple, fit: Fit) -> list[Finding]:
    """Find the torque that repeats at the same positions, and its effect on the gains."""
    if not found.found:
        return []
    problem = fit.system.problem
    j = int(np.argmax(found.shares[: len(problem.joints)]))
    moves = np.abs(found.moves[problem.gain_rows] / fit.gains)
    k = int(np.argmax(moves))
    base = not problem.channels[j].kind.of_joint  # its rows are no joints of the user
    moved = {"move": float(moves[k]), "moved": problem.joints[k]}
    values = {"share": float(found.shares[j]), "base": base, **moved}
    if base:
        return [Finding(F.RIPPLE, (), fit.dataset.robot.floating, values)]
    return [Finding(F.RIPPLE, (problem.joints[j],), "", values)]


def residual_correlations(fit: Fit) -> tuple[np.ndarray, np.ndarray] | None:
    """Correlate residuals of runs that repeat a motion with different loads, by joint; None where there are none.

    Returns
    -------
    tuple of ndarray
        The correlations (n,) and their standard deviations (n,), from the scatter over stretches.
    """
    places, runs, n = fit.dataset.places, fit.dataset.runs, len(fit.system.problem.joints)
    loads = [None if run.payload is None else run.payload.name for run in runs]
    pairs = [
        (k, m)
        for k, m in combinations(range(len(runs)), 2)
        if places[k].group == places[m].group and loads[k] != loads[m]
    ]
    if not pairs:
        return None
    series = {k: _residuals(fit, k) for k in sorted({k for pair in pairs for k in pair})}
    sums = np.zeros((3, BLOCKS, n))
    for k, m in pairs:
        (t, e), (t_m, e_m) = series[k], series[m]
        again = t + places[m].begin - places[k].begin
        stretch = np.clip((BLOCKS * (t - t[0]) / (t[-1] - t[0])).astype(int), 0, BLOCKS - 1)
        for j in range(n):
            one, other = e[j], np.interp(again, t_m, e_m[j], left=np.nan, right=np.nan)
            both = np.isfinite(one) & np.isfinite(other)
            for sum_of, products in zip(sums, (one * other, one**2, other**2), strict=True):
                np.add.at(sum_of[:, j], stretch[both], products[both])
    total = sums.sum(axis=1)
    value = _correlation(total)
    without = _correlation(total[:, None] - sums) - value
    return value, np.sqrt(np.diag(jackknife(without)))


def _correlation(sums: np.ndarray) -> np.ndarray:
    return np.asarray(sums[0] / np.maximum(np.sqrt(np.maximum(sums[1] * sums[2], 0.0)), 1e-300))


def _residuals(fit: Fit, run: int) -> tuple[np.ndarray, np.ndarray]:
    """Compute residuals (c, K) in the middle of a run, NaN where a row is not kept, and their instants (K,)."""
    prepared, place = fit.dataset.prepared[run], fit.dataset.places[run]
    size = min(SAMPLES // len(fit.dataset.prepared), len(prepared))
    middle = int((0.5 * (place.begin + place.end) - float(prepared.time[0])) * prepared.run.rate)
    start = min(max(middle - size // 2, 0), len(prepared) - size)
    window = InMemoryRun(prepared.run, prepared.samples(start, start + size))
    A, keep = window_rows(fit, run, window, None, fit.dataset.model)
    e, _, _ = errors_and_jacobian(fit, run, window, A)
    decimator = prepared.preparation.decimator
    return window.all.time[decimator.instants(size)], np.where(keep, e, np.nan)


def repeated_motion_findings(fit: Fit, alternatives: Sequence[Alternative]) -> list[Finding]:
    """Find joints whose residuals are correlated, or anticorrelated, between runs with different loads.

    Parameters
    ----------
    fit : Fit
        What was estimated.
    alternatives : sequence of Alternative
        What was tried; of those that act otherwise with another load the likeliest are the causes.
    """
    found, joints = residual_correlations(fit), fit.system.problem.joints
    if found is None:
        return []
    correlations, std = found
    significant = (np.abs(correlations) > CORRELATED) & (np.abs(correlations) > CORRELATED_STD * std)
    findings = []
    for kind, sign in ((F.COMMON_RESIDUALS, 1), (F.OPPOSED_RESIDUALS, -1)):
        mine = np.flatnonzero(significant & (sign * correlations > 0))
        if not mine.size:
            continue
        names = tuple(joints[j] for j in mine)
        likely = [
            each
            for each in alternatives
            if each.causes[0].kind in OF_LOAD
            and each.probability > PROBABLE
            and set(each.causes[0].joints) <= set(names)
        ]
        causes = tuple(each.causes[0] for each in sorted(likely, key=lambda each: -each.share))
        causes = causes or (Finding(LOAD_FRICTION.kind, names[:1]),)
        values = {"correlations": [[joints[j], float(correlations[j])] for j in mine]}
        findings.append(Finding(kind, names, "", values, causes if sign < 0 else ()))
    return findings
