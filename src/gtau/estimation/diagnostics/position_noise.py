"""Noise of the positions: instrumental variables agree with the estimator used where the regressor is exact.

Their difference is then noise, with a standard deviation from its scatter over the windows of the runs (Hausman's
test). The equations are weighted by the motion filtered much further, whose noise is not the noise of the regressor, so
that noise of the positions does not bias them. They take one step from the solution, on the middle of the runs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.refits import untested
from gtau.estimation.effects.linearisation import FitWindow, known_rows, slopes_of, stacked_triangles
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.newton import whitening
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.factors import SIGNALS, triangle
from gtau.estimation.regression.run_blocks import (
    WINDOWS,
    PreparedRuns,
    Windows,
    central_windows,
    moving_stretches,
    usable_rows,
    window_clusters,
)
from gtau.findings import Finding, Grade
from gtau.robots.parameter import DRY, TERMS
from gtau.signals.preparation.filters import below_nyquist
from gtau.signals.preparation.prepared_run import Preparation

FEWEST_FOR_TESTS = 3.0  # rows for each unknown; with fewer, effects fit the noise and are not tried
NOISE_STD = 4.0  # Hausman's statistic of instrumental variables, from which noise of the positions is named
DIFFERENT_STD = 3.0  # difference of another estimator's parameter, standard deviations, from which it counts

POSITION_NOISE = "position noise"
FURTHER = 4.0  # cut-off of the instruments over the bandwidth of the motion
HALF = 0.5  # and over the position filter's, at most: instruments above share more than 3 % of the accelerations' noise
SPANNED = 1e-6  # of the largest singular value: directions that the instruments do not reach are left as they are

Moments = tuple[np.ndarray, np.ndarray]
"""Of a window: ``Z^T J`` (k, k) and ``Z^T e`` (k,) of instruments Z; J for least squares."""


def position_noise(fit: Fit) -> Iterator[Finding]:
    """Find the bias from position noise: of gains, and of parameters that differ significantly."""
    problem, values = fit.system.problem, fit.solution.values
    try:
        difference = instruments_difference(fit)
    except GtauError as refusal:  # its filter leaves no rows, or the loops do not close along that motion
        yield untested("noise of the positions", refusal)
        return
    if difference is None:
        return
    moves, stds = (np.abs(part) for part in difference)
    usual = np.sqrt(np.diag(fit.solution.jackknife))
    counted = (stds > 0) & (usual > 0) & (values != 0) & (moves > NOISE_STD * stds) & (moves > usual)
    counted[problem.gain_rows] &= problem.unknown_gains[: len(problem.joints)]
    counted[problem.unknowns.theta] &= (moves >= DIFFERENT_STD * stds)[problem.unknowns.theta]
    counted[problem.gain_rows.stop :] = False
    if counted.any():
        worst = int(np.argmax(np.where(counted, moves / np.maximum(usual, 1e-300), 0.0)))
        name = problem.unknowns[worst]
        joint = name.body if name.kind == "gain" else ""
        what = f"the gain of '{joint}'" if joint else name
        deviations, t = float(moves[worst] / usual[worst]), float(moves[worst] / stds[worst])
        yield Finding(
            POSITION_NOISE,
            (joint,) if joint else (),
            "" if joint else name,
            size=deviations / 1.96,  # in halves of a 95 % interval
            text=f"position noise biases {counted.sum()} of {len(fit.solution.theta) + len(fit.gains)} estimates by "
            f"more than one standard deviation: {what} by {deviations:.1f} standard deviations (instrumental "
            f"variables, which such noise does not bias, differ by {t:.0f} standard deviations of the difference); the "
            "intervals include this bias",
            advice="use --method iv or didim, or encoders with less noise",
            grade=Grade.WARNING,
        )


def instruments_difference(fit: Fit) -> tuple[np.ndarray, np.ndarray] | None:
    """Differences of (theta, gains, delays) by instrumental variables, and their standard deviations, (k,) each.

    None where the logs are too slow for a further filter, or the estimates are free of such bias. Raises GtauError.
    """
    dataset, windows = fit.dataset, fit.dataset.windows(WINDOWS)
    further = _filtered_further(dataset.preparation)
    if further is None or fit.noise_free:
        return None
    cut = moving_stretches(dataset.prepared, WINDOWS)
    pairs = _pairs(fit, windows, _windows(fit, _prepared_as(dataset, further), cut))
    known, clusters = known_rows(fit, windows)[1], window_clusters(windows, *dataset.prepared.places)
    back = whitening(np.concatenate([*(J for _, J, _ in pairs), known]), np.zeros(len(fit.solution.gains)))
    white, T = known @ back, slopes_of(fit) @ back
    usual, weighed = (
        [(back.T @ (A.T @ J) @ back, back.T @ (A.T @ e)) for A, J, e in rows]
        for rows in ([(J, J, e) for _, J, e in pairs], pairs)
    )
    step, scatter = _difference(usual, weighed, clusters, white.T @ white)
    return T @ step, np.sqrt(np.sum((scatter @ T.T) ** 2, axis=0))


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
    """Cut the windows of the fit from runs that are prepared otherwise; raises GtauError where few rows are left."""
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
    dry += [fit.dataset.base.count + k for k, term in enumerate(TERMS) if term in DRY]
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
