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

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from gtau.estimation.diagnostics.alternatives import RIPPLE, Alternative, Hypothesis, candidate
from gtau.estimation.diagnostics.hypotheses import find_alternatives
from gtau.estimation.diagnostics.hypotheses.drives import FALLING_CONSTANT, LOAD_FRICTION
from gtau.estimation.diagnostics.linearisation import (
    CandidateColumns,
    FitWindow,
    Linearised,
    least_squares_step,
    linearise,
    on_channels,
    slopes_of,
    weights_of,
)
from gtau.estimation.estimators.estimator import Fit, jackknife
from gtau.estimation.regression.factors import triangle
from gtau.estimation.regression.run_blocks import BLOCKS, SAMPLES
from gtau.estimation.thresholds.refutation import CORRELATED, CORRELATED_STD, PROBABLE, RIPPLE_SHARE, SPRING_SHARE
from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.robots.parameter import unit_of
from gtau.robots.robot import STIFFNESS

KNOTS = 24  # of the piecewise linear function, over a joint's range in all runs
LARGEST = 10.0  # times the joint's error: how large such a torque may be, more or less
OF_LOAD = (LOAD_FRICTION.kind, FALLING_CONSTANT.kind, F.GAIN_CHANGE)  # effects that depend on the load


def _springs(at: FitWindow) -> CandidateColumns:
    """Add a spring across a joint, such as a balancer."""
    return at.decimated(np.eye(len(at.fit.gains))[:, :, None] * at.window.q.T)


SPRINGS = Hypothesis("springs", True, _springs, lambda fit: map(candidate(F.SPRING).on, fit.dataset.model.actuated))


def springs(fit: Fit, others: Iterable[Alternative]) -> Iterator[Finding]:
    """Find joints whose residuals a spring explains that is not in the robot's file, more than all ``others``."""
    least = max(SPRING_SHARE, *(effect.share for effect in others), 0.0)
    for effect in find_alternatives(fit, [SPRINGS]):
        if effect.share > least:
            unit = unit_of(STIFFNESS, fit.dataset.robot, effect.causes[0].joints[0])
            yield replace(effect.causes[0], values={"stiffness": effect.size, "unit": unit, "share": effect.share})


def position_ripple(fit: Fit) -> Alternative:
    """Estimate the part of the residuals that repeats at the same positions; where it is a ripple, its finding says so.

    Its share is the mean over the channels, of the variance of whose errors one half of the runs predicts in the other.
    A torque sensor does not feel the ripple of its motor.
    """
    solution, pieces = fit.solution, fit.dataset.windows(2)
    low = np.min([piece.q.min(axis=0) for _, piece in pieces], axis=0)
    high = np.max([piece.q.max(axis=0) for _, piece in pieces], axis=0)
    knots = np.linspace(low, high, KNOTS)  # (KNOTS, n)
    width = np.maximum(knots[1] - knots[0], 1e-300)

    def offer(at: FitWindow) -> CandidateColumns:
        q = at.window.samples().q.T
        hats = np.maximum(0.0, 1 - np.abs(q[:, None, :] - knots.T[:, :, None]) / width[:, None, None])
        return at.decimated(hats.swapaxes(0, 1))

    linear = linearise(fit, pieces, on_channels(offer, felt=False))
    even, odd = np.arange(0, len(pieces), 2), np.arange(1, len(pieces), 2)
    heights = weights_of(fit) / (LARGEST * np.abs(solution.gains))
    errors = linear.errors.copy()
    for half, other in ((even, odd), (odd, even)):
        torques = _fit(linear, [other], heights)[1]
        errors[half] += np.einsum("wjpk,wjk->wjp", linear.offered[half], torques)
    (_, rest), (step, before) = _left(replace(linear, errors=errors)), _left(linear)
    shares = 1 - rest / np.maximum(before, 1e-300)
    share, shifts = float(np.maximum(shares, 0.0).mean()), np.zeros(len(solution.values))
    nothing = Alternative(RIPPLE, (), 0.0, None, "", 1.0, share, shifts=shifts)
    if np.max(shares) < RIPPLE_SHARE:
        return nothing
    # what of a joint does not repeat would only take up what its parameters explain
    moved, _ = _fit(linear, [even, odd], np.where(shares > 0, heights, np.inf))
    shifts = slopes_of(fit) @ (moved - step)
    return replace(nothing, causes=(_ripple(fit, shares, shifts),), shifts=shifts)


def _fit(linear: Linearised, pieces: Sequence[np.ndarray], heights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fit steps of the estimates (k,) and each run's torques at the knots (runs, n, KNOTS) together.

    The numbers of the ``pieces`` are those of each run, one or two. A torque acts in one joint of one run only, so it
    is eliminated there; it is drawn to zero with the weight ``heights`` (c,), as it can stand in for a parameter, and
    is zero where that is infinite.
    """
    tops, rests = [], []
    all_rows = np.concatenate([linear.offered, linear.jacobian, linear.errors[..., None]], axis=-1)
    all_rows[:, np.isinf(heights), :, :KNOTS] = 0.0
    heights = np.where(np.isinf(heights), 1.0, heights)
    for of_run in zip(*pieces, strict=True):
        for j, height in enumerate(heights):
            R = triangle(np.eye(KNOTS, all_rows.shape[-1]) * height, *all_rows[list(of_run), j])
            tops.append(R[:KNOTS])
            rests.append(R[KNOTS:, KNOTS:])
    e, J = linear.known
    rest = np.concatenate([*rests, np.column_stack([J, e])])
    step = least_squares_step(rest[:, :-1], rest[:, -1])
    torques = [-np.linalg.solve(top[:, :KNOTS], top[:, KNOTS:-1] @ step + top[:, -1]) for top in tops]
    return step, np.reshape(torques, (-1, len(heights), KNOTS))


def _left(linear: Linearised) -> tuple[np.ndarray, np.ndarray]:
    """Fit steps of the estimates alone (k,), and compute the remaining squared errors of each channel, (c,)."""
    step, rest = linear.fitted()
    return step, np.sum(rest[: linear.errors.size].reshape(linear.errors.shape) ** 2, axis=(0, 2))


def _ripple(fit: Fit, shares: np.ndarray, shifts: np.ndarray) -> Finding:
    """Find the torque that repeats at the same positions, and its effect on the gains."""
    problem = fit.system.problem
    j, moves = int(np.argmax(shares[: len(problem.joints)])), np.abs(shifts[problem.gain_rows] / fit.gains)
    base = not problem.channels[j].kind.of_joint  # its rows are no joints of the user
    moved = {"move": float(moves.max()), "moved": problem.joints[int(np.argmax(moves))]}
    joints, subject = ((), fit.dataset.robot.floating) if base else ((problem.joints[j],), "")
    return Finding(F.RIPPLE, joints, subject, {"share": float(shares[j]), "base": base, **moved})


def residual_correlations(fit: Fit) -> tuple[np.ndarray, np.ndarray] | None:
    """Correlate residuals of runs that repeat a motion with different loads, by joint; None where there are none.

    The correlations (n,) have standard deviations (n,) from the scatter over blocks.
    """
    (groups, spans), runs, n = fit.dataset.prepared.places, fit.dataset.runs, len(fit.system.problem.joints)
    kinds = [(group, run.payload and run.payload.name) for group, run in zip(groups, runs, strict=True)]
    pairs = [(k, m) for k, m in combinations(range(len(runs)), 2) if kinds[k][0] == kinds[m][0]]
    pairs = [(k, m) for k, m in pairs if kinds[k] != kinds[m]]
    if not pairs:
        return None
    series = {k: _residuals(fit, k) for k in sorted({k for pair in pairs for k in pair})}
    sums = np.zeros((BLOCKS, 3, n))
    for k, m in pairs:
        (t, e), (t_m, e_m) = series[k], series[m]
        again = t + spans[m, 0] - spans[k, 0]
        block = np.clip((BLOCKS * (t - t[0]) / (t[-1] - t[0])).astype(int), 0, BLOCKS - 1)
        for j in range(n):
            one, other = e[j], np.interp(again, t_m, e_m[j], left=np.nan, right=np.nan)
            products = np.stack([one * other, one**2, other**2])
            products[:, ~np.isfinite(products[0])] = 0.0
            np.add.at(sums[..., j], block, products.T)
    total = sums.sum(axis=0)
    value = _correlation(total)
    without = _correlation(np.moveaxis(total - sums, 1, 0)) - value
    return value, np.sqrt(np.diag(jackknife(without)))


def _correlation(sums: np.ndarray) -> np.ndarray:
    return np.asarray(sums[0] / np.maximum(np.sqrt(np.maximum(sums[1] * sums[2], 0.0)), 1e-300))


def _residuals(fit: Fit, run: int) -> tuple[np.ndarray, np.ndarray]:
    """Compute residuals (c, K) in the middle of a run, NaN where a row is not kept, and their instants (K,)."""
    prepared, span = fit.dataset.prepared[run], fit.dataset.prepared.places[1][run]
    size = min(SAMPLES // len(fit.dataset.prepared), len(prepared))
    middle = int((span.mean() - float(prepared.time[0])) * prepared.run.rate)
    start = min(max(middle - size // 2, 0), len(prepared) - size)
    window = prepared.samples(start, start + size)
    fit_window = FitWindow(fit, run, window)
    A, keep = fit_window.rows()
    e, _ = fit_window.errors_and_jacobian(A)
    decimator = prepared.preparation.decimator
    return window.time[decimator.instants(size)], np.where(keep, e, np.nan)


def repeated_motion_findings(fit: Fit, alternatives: Sequence[Alternative]) -> Iterator[Finding]:
    """Find joints whose residuals are correlated, or anticorrelated, between runs with different loads.

    Of the ``alternatives`` that act otherwise with another load the likeliest are the causes.
    """
    correlated, joints = residual_correlations(fit), fit.system.problem.joints
    if correlated is None:
        return
    values, std = correlated
    significant = np.abs(values) > np.maximum(CORRELATED, CORRELATED_STD * std)
    for kind, sign in ((F.COMMON_RESIDUALS, 1), (F.OPPOSED_RESIDUALS, -1)):
        places = np.flatnonzero(significant & (sign * values > 0))
        names = tuple(joints[j] for j in places)
        if not names:
            continue
        of_load = [effect for effect in alternatives if effect.kind in OF_LOAD and effect.probability > PROBABLE]
        likely = [effect for effect in of_load if set(effect.causes[0].joints) <= set(names)]
        causes = [effect.causes[0] for effect in sorted(likely, key=lambda effect: -effect.share)]
        causes = causes or [Finding(LOAD_FRICTION.kind, names[:1])]
        listed = {"correlations": [[joints[j], float(values[j])] for j in places]}
        yield Finding(kind, names, "", listed, tuple(causes) if sign < 0 else ())
