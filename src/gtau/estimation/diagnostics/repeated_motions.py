"""Correlate the residuals of runs that repeat a motion with different loads.

Model errors that depend on the motion alone are the same in both runs and cancel in the gains. Residuals of opposite
sign depend on the load, and bias the gains as a wrong payload does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from gtau.estimation.diagnostics.alternatives import Alternative
from gtau.estimation.diagnostics.finding import Finding
from gtau.estimation.diagnostics.finding import FindingKind as F
from gtau.estimation.diagnostics.hypotheses.drives import FALLING_CONSTANT, LOAD_FRICTION
from gtau.estimation.diagnostics.linearisation import SAMPLES, errors_and_jacobian, window_rows
from gtau.estimation.estimators.estimator import Fit, jackknife
from gtau.estimation.regression.equations import STRETCHES
from gtau.estimation.thresholds.estimates import CORRELATED, CORRELATED_STD, PROBABLE
from gtau.signals.preparation import InMemoryRun

OF_LOAD = (LOAD_FRICTION.kind, FALLING_CONSTANT.kind, F.GAIN_CHANGE)  # effects that depend on the load


@dataclass(frozen=True, eq=False)
class Correlations:
    """Correlations (n,) of each joint's residuals between runs that repeat a motion with different loads.

    With their standard deviations (n,), from the scatter over stretches.
    """

    values: np.ndarray
    std: np.ndarray

    @property
    def significant(self) -> np.ndarray:
        """Joints whose residuals are significantly correlated, (n,)."""
        return (np.abs(self.values) > CORRELATED) & (np.abs(self.values) > CORRELATED_STD * self.std)


def residual_correlations(fit: Fit) -> Correlations | None:
    """Correlate the residuals of runs that repeat a motion with different loads; None where there are none.

    Parameters
    ----------
    fit : Fit
        What was estimated.
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
    sums = np.zeros((3, STRETCHES, n))
    for k, m in pairs:
        (t, e), (t_m, e_m) = series[k], series[m]
        again = t + places[m].begin - places[k].begin
        stretch = np.clip((STRETCHES * (t - t[0]) / (t[-1] - t[0])).astype(int), 0, STRETCHES - 1)
        for j in range(n):
            one, other = e[j], np.interp(again, t_m, e_m[j], left=np.nan, right=np.nan)
            both = np.isfinite(one) & np.isfinite(other)
            for sum_of, products in zip(sums, (one * other, one**2, other**2), strict=True):
                np.add.at(sum_of[:, j], stretch[both], products[both])
    total = sums.sum(axis=1)
    value = _correlation(total)
    without = _correlation(total[:, None] - sums) - value
    return Correlations(value, np.sqrt(np.diag(jackknife(without))))


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
    findings = []
    for kind, sign in ((F.COMMON_RESIDUALS, 1), (F.OPPOSED_RESIDUALS, -1)):
        mine = np.flatnonzero(found.significant & (sign * found.values > 0))
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
        values = {"correlations": [[joints[j], float(found.values[j])] for j in mine]}
        findings.append(Finding(kind, names, "", values, causes if sign < 0 else ()))
    return findings
