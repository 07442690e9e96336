"""Hausman's test: other estimators agree with the one used where the model holds and the regressor is exact.

Their difference is then noise, with a standard deviation from its scatter over the windows of the runs. A larger one
shows that the estimates depend on a choice:

- the cut-off of the position filter and the rate of rows, 0.7 and 1.4 times those chosen;
- the speed below which a joint's rows are left out, half and twice the one chosen;
- two-stage least squares: the same equations with the currents that their joint's motion explains;
- instrumental variables: the equations are weighed along the motion filtered much further, whose noise is not that of
  the regressor, so that noise of the positions does not bias them.

Each takes one step from the solution, on the middle of the runs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.alternatives import Alternative, compete, support
from gtau.estimation.diagnostics.linearisation import (
    Windows,
    central_windows,
    errors_and_jacobian,
    in_step,
    known_rows,
    linearise,
    moving_stretches,
    window_rows,
)
from gtau.estimation.diagnostics.log_checks import lack_of_fit
from gtau.estimation.estimators.estimator import Fit, jackknife
from gtau.estimation.estimators.newton import to_gains, whitening
from gtau.estimation.estimators.two_stage import first_stage, two_stage
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.equations import SIGNALS, triangle
from gtau.estimation.regression.friction import TERMS
from gtau.estimation.thresholds.estimates import DIFFERENT_PROBABILITY, DIFFERENT_STD, NOISE_STD, WEAK_INSTRUMENTS
from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.findings.words import RELATIVE
from gtau.signals.preparation.filters import below_nyquist
from gtau.signals.preparation.prepared_run import Preparation

WINDOWS = 10  # of a run
FURTHER = 4.0  # cut-off of the instruments over the bandwidth of the motion
# and at most that of the position filter times this: instruments above would share more than 3 % of the noise of the
# accelerations.
HALF = 0.5
SPANNED = 1e-6  # of the largest singular value: directions that the instruments do not reach are left as they are

Moments = tuple[np.ndarray, np.ndarray]
"""Of a window: ``Z^T J`` (k, k) and ``Z^T e`` (k,) of instruments Z; those of least squares are J."""


@dataclass(frozen=True, eq=False)
class Difference:
    """Difference between the estimates of another estimator and those used.

    Attributes
    ----------
    estimator : Finding
        Which one; of its values it is the first cause of an alternative.
    moves, std : ndarray
        Of (theta, gains, delays), (k,), and their standard deviations, SI units.
    """

    estimator: Finding
    moves: np.ndarray
    std: np.ndarray


def alternatives_of(fit: Fit, differences: Sequence[Difference]) -> list[Alternative]:
    """Make an alternative of each difference in a gain, and of each significant one in a parameter.

    They compete for each estimate: one of the other estimators is right, or the one used. Before the data a difference
    is thought to be as large as the random standard deviation.
    """
    problem, solution = fit.system.problem, fit.solution
    plausible = np.sqrt(np.diag(solution.jackknife))
    estimates = [((), name) for name in problem.parameters] + [((joint,), "") for joint in problem.joints]
    estimated = np.concatenate(
        [np.ones(len(problem.parameters), dtype=bool), problem.unknown_gains[: len(problem.joints)]]
    )
    found = []
    for each in differences:
        for k, (joints, parameter) in enumerate(estimates):
            value, size, std = solution.values[k], each.moves[k], each.std[k]
            if not (estimated[k] and std > 0 and plausible[k] > 0 and value):
                continue
            if parameter and abs(size) < DIFFERENT_STD * std:
                continue
            relative, error, prior = float(size / value), float(std / abs(value)), float(plausible[k] / abs(value))
            factor, moment = support(relative, error, prior)
            slopes = np.zeros(len(solution.values))
            slopes[k] = value
            found.append(
                Alternative(
                    hypothesis=each.estimator.kind,
                    causes=(replace(each.estimator, joints=joints, subject=parameter),),
                    size=relative,
                    std=error,
                    unit=RELATIVE,
                    plausible=prior,
                    group=("estimate", *joints, parameter),
                    log_factor=factor,
                    second_moment=moment,
                    share=0.0,
                    slopes=slopes,
                    moves=slopes[problem.gain_rows] * (size / value) / fit.gains,
                    description=False,
                )
            )
    return [each for each in compete(found) if each.moves.any() or each.probability > DIFFERENT_PROBABILITY]


def position_noise(fit: Fit, alternatives: Sequence[Alternative]) -> list[Finding]:
    """Find the bias from position noise, where Hausman's test against instrumental variables shows it."""
    biased = [
        each
        for each in alternatives
        if each.causes[0].kind == F.INSTRUMENTS and abs(each.t) > NOISE_STD and abs(each.size) > each.plausible
    ]
    if not biased:
        return []
    worst = max(biased, key=lambda each: abs(each.size) / each.plausible)
    estimate = worst.causes[0]
    values = {
        "count": len(biased),
        "all": len(fit.solution.theta) + len(fit.gains),
        "deviations": abs(worst.size) / worst.plausible,
        "t": abs(worst.t),
    }
    return [Finding(F.POSITION_NOISE, estimate.joints, estimate.subject, values)]


def two_stage_difference(fit: Fit) -> Difference | Finding:
    """Compare 2SLS on the same equations with the estimator used, by the jackknife of both.

    The standard deviation counts as no smaller than that of the estimates themselves, and the bias that instruments of
    this strength leave counts beside it. Where they are weak, what 2SLS finds otherwise is its bias, and the finding
    says so instead.
    """
    problem, solution = fit.system.problem, fit.solution
    strength, bias = first_stage(problem, solution, max(lack_of_fit(problem, solution), 1.0))
    if strength < WEAK_INSTRUMENTS:
        return Finding(F.WEAK_INSTRUMENTS, values={"strength": strength, "needed": float(WEAK_INSTRUMENTS)})
    # with the same delays: where motions are slow, a joint's own equations hardly determine its delay
    other = two_stage(problem, solution.delays)
    between = np.sqrt(np.diag(jackknife(solution.replicates() - other.replicates())))
    std = np.maximum(between, np.sqrt(np.diag(solution.jackknife)))
    moves = np.zeros(len(std))
    moves[problem.gain_rows] = other.gains[: len(problem.joints)] - fit.gains
    std[problem.gain_rows] = np.hypot(std[problem.gain_rows], bias * fit.gains)
    return Difference(Finding(F.TWO_STAGE), moves, std)


def other_estimators(fit: Fit, windows: Windows | None = None) -> tuple[tuple[Difference, ...], tuple[Finding, ...]]:
    """Compare estimates with other preparations and instrumental variables; also list the estimators that refuse.

    Parameters
    ----------
    fit : Fit
        What was estimated.
    windows : sequence, optional
        Where: the :func:`central_windows` of the runs, ``WINDOWS`` of each, unless others are given.
    """
    dataset = fit.dataset
    windows = central_windows(dataset, WINDOWS) if windows is None else windows
    cut = moving_stretches(dataset, WINDOWS)
    further, preparations = _filtered_further(dataset.preparation), _preparations(dataset.preparation)
    try:
        filtered = dataset if further is None else _prepared_as(dataset, further)
        pairs = _pairs(fit, windows, central_windows(filtered, WINDOWS, cut))
    except GtauError as refusal:  # the loops do not close along motion that is filtered otherwise
        return (), (_untested(refusal, Finding(F.INSTRUMENTS), *(changed for changed, _ in preparations)),)
    if not pairs:
        return (), ()
    rows = [J for _, J, _ in pairs]
    known, clusters = known_rows(fit, windows)[1], in_step(dataset, windows)
    back = whitening(np.concatenate([*rows, known]), np.zeros(len(fit.solution.gains)))
    T = to_gains(fit.solution.iterate, fit.free_gains) @ back
    usual = [(J.T @ J, J.T @ e) for _, J, e in pairs]
    found, untested = [], []
    if further is not None and not fit.noise_free:
        weighed = [(Z.T @ J, Z.T @ e) for Z, J, e in pairs]
        found.append(Difference(Finding(F.INSTRUMENTS), *_difference(usual, weighed, clusters, known, back, T)))
    for changed, preparation in preparations:
        other = replace(fit, dataset=_prepared_as(dataset, preparation))
        try:
            linear = linearise(other, None, central_windows(other.dataset, WINDOWS, cut))
        except GtauError as refusal:
            untested.append(_untested(refusal, changed))
            continue
        if len(linear) != len(pairs):
            continue  # its filters are longer than a window
        moments = [(each.jacobian.reshape(-1, len(back)), each.errors.ravel()) for each in linear]
        weighed = [(J.T @ J, J.T @ e) for J, e in moments]
        found.append(Difference(changed, *_difference(usual, weighed, clusters, known, back, T)))
    return tuple(found), tuple(untested)


def _untested(refusal: GtauError, *estimators: Finding) -> Finding:
    return Finding(F.UNTESTED, values={"refusal": str(refusal).removesuffix(".")}, causes=estimators)


def _preparations(chosen: Preparation) -> list[tuple[Finding, Preparation]]:
    """List the preparations to try, each with its change."""
    found = []
    for factor in (0.7, 1.4):
        cutoff = None if chosen.cutoff is None else below_nyquist(factor * chosen.cutoff, chosen.rate)
        decimator = replace(chosen.decimator, factor=max(1, round(chosen.decimator.factor / factor)))
        other = replace(chosen, cutoff=cutoff, decimator=decimator)
        if other != chosen:
            found.append((Finding(F.BANDWIDTH, values={"factor": factor}), other))
    for factor in (0.5, 2.0):
        fraction = factor * chosen.speed_fraction
        found.append((Finding(F.SLOW_ROWS, values={"fraction": fraction}), replace(chosen, speed_fraction=fraction)))
    return found


def _filtered_further(chosen: Preparation) -> Preparation | None:
    """Return the preparation of the instruments; None where the logs are too slow for a filter."""
    cutoff = FURTHER * chosen.bandwidth
    cutoff = cutoff if chosen.cutoff is None else min(cutoff, HALF * chosen.cutoff)
    return None if below_nyquist(cutoff, chosen.rate) is None else replace(chosen, cutoff=cutoff)


def _prepared_as(dataset: Dataset, preparation: Preparation) -> Dataset:
    """Prepare the same samples of the same runs with another preparation."""
    prepared = tuple(replace(each, preparation=preparation.at(each.run.rate)) for each in dataset.prepared)
    return replace(dataset, preparation=preparation, prepared=prepared)


def _pairs(fit: Fit, usual: Windows, further: Windows) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Compute Jacobians along the further filtered and the usual motion, (., k) each, and residuals (.,), by window.

    Rows of a joint are reduced together, so that products of their columns remain. The sign of a speed that is filtered
    further changes at other samples, which is no noise: columns of Coulomb friction are the usual ones in both.
    """
    model, found = fit.dataset.model, []
    dry = [k for k, name in enumerate(fit.dataset.base.standard) if name.kind == "fs"]
    dry.append(fit.dataset.base.count + TERMS.index("fl"))
    for (run, window), (_, filtered) in zip(usual, further, strict=True):
        A, keep = window_rows(fit, run, window, None, model)
        Z, keep_filtered = window_rows(fit, run, filtered, None, model)
        b = A.shape[-1] - 3
        Z[..., dry] = A[..., dry]
        both = np.concatenate([Z[..., :b], A], axis=-1)
        factors = [triangle(of_joint[kept]) for of_joint, kept in zip(both, keep & keep_filtered, strict=True)]
        height = max(map(len, factors))
        R = np.stack([np.pad(each, ((0, height - len(each)), (0, 0))) for each in factors])
        e, J, _ = errors_and_jacobian(fit, run, window, R[..., b:])
        _, J_filtered, _ = errors_and_jacobian(fit, run, window, np.concatenate([R[..., :b], R[..., SIGNALS]], axis=-1))
        found.append((J_filtered.reshape(-1, J.shape[-1]), J.reshape(-1, J.shape[-1]), e.ravel()))
    return found


def _difference(
    usual: Sequence[Moments],
    weighed: Sequence[Moments],
    clusters: np.ndarray,
    known: np.ndarray,
    back: np.ndarray,
    T: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the differences of (theta, gains, delays) between two estimators, (k,), and their standard deviations.

    The solution counts as where the first estimator ends; the share of a cluster of windows in the difference is its
    influence on one estimator less that on the other.
    """
    whole, white = np.eye(back.shape[1]), known @ back
    curvatures = [back.T @ A @ back for A, _ in weighed]
    rest = white.T @ white
    inverse = np.linalg.pinv(np.sum(curvatures, axis=0) + rest, rcond=SPANNED)
    scale = np.trace(np.sum(curvatures, axis=0)) / max(np.trace(whole - rest), 1.0)  # as there are other rows
    gradients = [back.T @ g - scale * (back.T @ g_usual) for (_, g), (_, g_usual) in zip(weighed, usual, strict=True)]
    step = -inverse @ np.sum(gradients, axis=0)
    count = int(clusters.max()) + 1
    of_windows = [
        -inverse @ (back.T @ g + A @ step) + back.T @ g_usual
        for A, (_, g), (_, g_usual) in zip(curvatures, weighed, usual, strict=True)
    ]
    shares = np.zeros((count, len(step)))
    np.add.at(shares, clusters, of_windows)
    scatter = (shares - shares.mean(axis=0)) @ T.T
    return T @ step, np.sqrt(count / max(count - 1, 1) * np.sum(scatter**2, axis=0))
