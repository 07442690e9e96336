"""Hausman's test: other estimators agree with the one used where the model holds and the regressor is exact.

Their difference is then noise, with a standard deviation from its scatter over the windows of the runs. A larger one
shows that the estimates depend on a choice:

- the cut-off of the position filter and the rate of rows, 0.7 and 1.4 times those chosen;
- the speed below which a joint's rows are left out, half and twice the one chosen;
- two-stage least squares: the same equations with the currents that their joint's motion explains;
- instrumental variables: the equations are weighted by the motion filtered much further, whose noise is not that of
  the regressor, so that noise of the positions does not bias them.

Each takes one step from the solution, on the middle of the runs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.alternatives import Alternative
from gtau.estimation.diagnostics.linearisation import FitWindow, known_rows, linearise, slopes_of, stacked_triangles
from gtau.estimation.diagnostics.log_checks import lack_of_fit
from gtau.estimation.estimators.estimator import Fit, jackknife
from gtau.estimation.estimators.newton import whitening
from gtau.estimation.estimators.two_stage import first_stage, two_stage
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.factors import SIGNALS, triangle
from gtau.estimation.regression.rows import TERMS
from gtau.estimation.regression.run_blocks import (
    WINDOWS,
    PreparedRuns,
    Windows,
    central_windows,
    moving_stretches,
    usable_rows,
    window_clusters,
)
from gtau.estimation.thresholds.estimates import FEWEST_FOR_TESTS
from gtau.estimation.thresholds.refutation import DIFFERENT_STD, NOISE_STD, WEAK_INSTRUMENTS
from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.findings.words import RELATIVE
from gtau.signals.preparation.filters import below_nyquist
from gtau.signals.preparation.prepared_run import Preparation

FURTHER = 4.0  # cut-off of the instruments over the bandwidth of the motion
# and at most that of the position filter times this: instruments above would share more than 3 % of the noise of the
# accelerations.
HALF = 0.5
SPANNED = 1e-6  # of the largest singular value: directions that the instruments do not reach are left as they are
ESTIMATORS = (F.BANDWIDTH, F.SLOW_ROWS, F.TWO_STAGE, F.INSTRUMENTS)

Moments = tuple[np.ndarray, np.ndarray]
"""Of a window: ``Z^T J`` (k, k) and ``Z^T e`` (k,) of instruments Z; those of least squares are J."""


def _alternatives(fit: Fit, estimator: Finding, moves: np.ndarray, stds: np.ndarray) -> Iterator[Alternative]:
    """Make an alternative of each difference in a gain, and of each significant one in a parameter.

    ``moves`` and ``stds`` (k,) are those of (theta, gains, delays). They compete for each estimate: one of the other
    estimators is right, or the one used. Before the data a difference is thought to be as large as the random standard
    deviation.
    """
    problem, values = fit.system.problem, fit.solution.values
    plausible = np.sqrt(np.diag(fit.solution.jackknife))
    counted = (stds > 0) & (plausible > 0) & (values != 0)
    counted[problem.gain_rows] &= problem.unknown_gains[: len(problem.joints)]
    counted[problem.unknowns.theta] &= (np.abs(moves) >= DIFFERENT_STD * stds)[problem.unknowns.theta]
    counted[problem.gain_rows.stop :] = False
    for k in np.flatnonzero(counted):
        name, scale = problem.unknowns[k], abs(values[k])
        joints, subject = ((name.body,), "") if name.kind == "gain" else ((), name)
        cause = replace(estimator, joints=joints, subject=subject)
        size, std = float(moves[k] / values[k]), float(stds[k] / scale)
        effect = Alternative(estimator.kind, (cause,), size, std, RELATIVE, plausible=float(plausible[k] / scale))
        yield effect.moving(fit, np.where(np.arange(len(values)) == k, values, 0.0))


def position_noise(fit: Fit, alternatives: Sequence[Alternative]) -> Iterator[Finding]:
    """Find the bias from position noise, where Hausman's test against instrumental variables shows it."""
    tested = [effect for effect in alternatives if effect.hypothesis == F.INSTRUMENTS]
    biased = [effect for effect in tested if abs(effect.t) > NOISE_STD and abs(effect.size) > effect.plausible]
    if biased:
        worst = max(biased, key=lambda effect: abs(effect.size) / effect.plausible)
        count = {"count": len(biased), "all": len(fit.solution.theta) + len(fit.gains)}
        sizes = {"deviations": abs(worst.size) / worst.plausible, "t": abs(worst.t)}
        cause = worst.causes[0]
        yield Finding(F.POSITION_NOISE, cause.joints, cause.subject, count | sizes)


def two_stage_difference(fit: Fit) -> Iterator[Alternative | Finding]:
    """Compare 2SLS on the same equations with the estimator used, by the jackknife of both.

    The standard deviation counts as no smaller than that of the estimates themselves, and the bias that instruments of
    this strength leave counts beside it. Where they are weak, what 2SLS finds otherwise is its bias, and the finding
    says so instead.
    """
    problem, solution = fit.system.problem, fit.solution
    if not fit.free_gains:
        return
    strength, bias = first_stage(problem, solution, max(lack_of_fit(problem, solution), 1.0))
    if strength < WEAK_INSTRUMENTS:
        yield Finding(F.WEAK_INSTRUMENTS, values={"strength": strength, "needed": float(WEAK_INSTRUMENTS)})
        return
    # with the same delays: where motions are slow, a joint's own equations hardly determine its delay
    other = two_stage(problem, solution.delays)
    between = np.sqrt(np.diag(jackknife(solution.replicates() - other.replicates())))
    std = np.maximum(between, np.sqrt(np.diag(solution.jackknife)))
    moves = np.zeros(len(std))
    moves[problem.gain_rows] = other.gains[: len(problem.joints)] - fit.gains
    std[problem.gain_rows] = np.hypot(std[problem.gain_rows], bias * fit.gains)
    yield from _alternatives(fit, Finding(F.TWO_STAGE), moves, std)


def other_estimators(fit: Fit) -> Iterator[Alternative | Finding]:
    """Compare estimates with other preparations and instrumental variables, and find the estimators that refuse."""
    for difference in differences(fit):
        if isinstance(difference, Finding):
            yield difference
        else:
            yield from _alternatives(fit, *difference)


def differences(fit: Fit) -> Iterator[tuple[Finding, np.ndarray, np.ndarray] | Finding]:
    """Compare with each other estimator: differences of (theta, gains, delays) and their stds, (k,), or a refusal."""
    dataset, windows = fit.dataset, fit.dataset.windows(WINDOWS)
    cut = moving_stretches(dataset.prepared, WINDOWS)
    further, preparations = _filtered_further(dataset.preparation), _preparations(dataset.preparation)
    try:
        others = windows if further is None else _windows(fit, _prepared_as(dataset, further), cut)
        pairs = _pairs(fit, windows, others)
    except GtauError as refusal:  # its filter leaves no rows, or the loops do not close along that motion
        yield _untested(refusal, Finding(F.INSTRUMENTS))
        further, pairs = None, _pairs(fit, windows, windows)
    known, clusters = known_rows(fit, windows)[1], window_clusters(windows, *dataset.prepared.places)
    jacobians = [J for _, J, _ in pairs]
    back = whitening(np.concatenate([*jacobians, known]), np.zeros(len(fit.solution.gains)))
    usual, white = [(J.T @ J, J.T @ e) for _, J, e in pairs], known @ back
    T = slopes_of(fit) @ back

    def compared(weighed: Sequence[Moments]) -> tuple[np.ndarray, np.ndarray]:
        first, second = ([(back.T @ A @ back, back.T @ g) for A, g in moments] for moments in (usual, weighed))
        step, scatter = _difference(first, second, clusters, white.T @ white)
        return T @ step, np.sqrt(np.sum((scatter @ T.T) ** 2, axis=0))

    if further is not None and not fit.noise_free:
        yield Finding(F.INSTRUMENTS), *compared([(Z.T @ J, Z.T @ e) for Z, J, e in pairs])
    for changed, preparation in preparations:
        other = replace(fit, system=replace(fit.system, dataset=_prepared_as(dataset, preparation)))
        try:
            others = _windows(fit, other.dataset, cut)
            linear = linearise(other, others)
        except GtauError as refusal:
            yield _untested(refusal, changed)
            continue
        rows = zip(linear.jacobian.reshape(len(others), -1, len(back)), linear.errors, strict=True)
        yield changed, *compared([(J.T @ J, J.T @ e.ravel()) for J, e in rows])


def _untested(refusal: GtauError, *estimators: Finding) -> Finding:
    return Finding(F.UNTESTED, values={"refusal": str(refusal).removesuffix(".")}, causes=estimators)


def _preparations(chosen: Preparation) -> list[tuple[Finding, Preparation]]:
    """List the preparations to try, each with its change."""
    others = []
    for factor in (0.7, 1.4):
        cutoff = None if chosen.cutoff is None else below_nyquist(factor * chosen.cutoff, chosen.rate)
        decimator = replace(chosen.decimator, factor=max(1, round(chosen.decimator.factor / factor)))
        other = replace(chosen, cutoff=cutoff, decimator=decimator)
        if other != chosen:
            others.append((Finding(F.BANDWIDTH, values={"factor": factor}), other))
    for factor in (0.5, 2.0):
        fraction = factor * chosen.speed_fraction
        others.append((Finding(F.SLOW_ROWS, values={"fraction": fraction}), replace(chosen, speed_fraction=fraction)))
    return others


def _filtered_further(chosen: Preparation) -> Preparation | None:
    """Return the preparation of the instruments; None where the logs are too slow for a filter."""
    cutoff = FURTHER * chosen.bandwidth
    cutoff = cutoff if chosen.cutoff is None else min(cutoff, HALF * chosen.cutoff)
    return None if below_nyquist(cutoff, chosen.rate) is None else replace(chosen, cutoff=cutoff)


def _prepared_as(dataset: Dataset, preparation: Preparation) -> Dataset:
    """Prepare the same samples of the same runs with another preparation."""
    prepared = PreparedRuns(replace(run, preparation=preparation.at(run.run.rate)) for run in dataset.prepared)
    return replace(dataset, preparation=preparation, prepared=prepared)


def _windows(fit: Fit, dataset: Dataset, cut: Sequence[list[range]]) -> Windows:
    """Cut the windows of the fit from runs that are prepared otherwise; raises GtauError where there are others."""
    windows = central_windows(dataset.prepared, WINDOWS, cut)
    rows = usable_rows(windows, dataset.prepared)
    if len(windows) != len(fit.dataset.windows(WINDOWS)) or rows < FEWEST_FOR_TESTS * len(fit.solution.values):
        raise GtauError(f"its filters leave {rows} rows in the middle of these runs.")
    return windows


def _pairs(fit: Fit, usual: Windows, further: Windows) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Compute Jacobians along the further filtered and the usual motion, (., k) each, and residuals (.,), by window.

    Rows of a joint are reduced together, so that products of their columns remain. The sign of a speed that is filtered
    further changes at other samples, which is no noise: columns of Coulomb friction are the usual ones in both.
    """
    pairs = []
    dry = [k for k, name in enumerate(fit.dataset.base.standard) if name.kind == "fs"]
    dry.append(fit.dataset.base.count + TERMS.index("fl"))
    for (run, window), (_, filtered) in zip(usual, further, strict=True):
        usual_window = FitWindow(fit, run, window)
        (A, keep), (Z, kept) = usual_window.rows(), FitWindow(fit, run, filtered).rows()
        b = A.shape[-1] - 3
        Z[..., dry] = A[..., dry]
        both = np.concatenate([Z[..., :b], A], axis=-1)
        factors = [triangle(rows[used]) for rows, used in zip(both, keep & kept, strict=True)]
        R = stacked_triangles([factors])[0]
        e, J = usual_window.errors_and_jacobian(R[..., b:])
        R_filtered = np.concatenate([R[..., :b], R[..., SIGNALS]], axis=-1)
        _, J_filtered = usual_window.errors_and_jacobian(R_filtered)
        k = J.shape[-1]
        pairs.append((J_filtered.reshape(-1, k), J.reshape(-1, k), e.ravel()))
    return pairs


def _difference(
    usual: Sequence[Moments], weighed: Sequence[Moments], clusters: np.ndarray, known: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the difference between two estimators (r,), and its scatter over clusters of windows, (clusters, r).

    Moments, and the part (r, r) of ``known`` parameters, are by unknowns that make the usual curvature one. The
    solution counts as where the first estimator ends; the share of a cluster in the difference is its influence on one
    estimator less that on the other.
    """
    curvature = np.sum([A for A, _ in weighed], axis=0)
    inverse = np.linalg.pinv(curvature + known, rcond=SPANNED)
    scale = np.trace(curvature) / max(len(known) - np.trace(known), 1.0)  # as there are other rows
    pairs = list(zip(weighed, usual, strict=True))
    step = -inverse @ np.sum([g - scale * first for (_, g), (_, first) in pairs], axis=0)
    count = int(clusters.max()) + 1
    shares = np.zeros((count, len(step)))
    np.add.at(shares, clusters, [first - inverse @ (g + A @ step) for (A, g), (_, first) in pairs])
    return step, np.sqrt(count / max(count - 1, 1)) * (shares - shares.mean(axis=0))
