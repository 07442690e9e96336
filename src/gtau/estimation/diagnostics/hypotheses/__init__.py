"""The hypotheses that every fit is tested against: all that stand in modules of this package."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from importlib import import_module
from itertools import pairwise
from pkgutil import iter_modules

import numpy as np

from gtau.estimation.diagnostics.alternatives import Alternative, Hypothesis, compete
from gtau.estimation.diagnostics.linearisation import Linearised, linearise, on_channels, side_by_side, slopes_of
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.regression.run_blocks import WINDOWS
from gtau.estimation.thresholds.refutation import SAME_EFFECT, TOGETHER_SHARE
from gtau.findings import Finding

HYPOTHESES: tuple[Hypothesis, ...] = tuple(
    value
    for module in iter_modules(__path__, f"{__name__}.")
    for value in vars(import_module(module.name)).values()
    if isinstance(value, Hypothesis)
)


def find_alternatives(fit: Fit, hypotheses: Sequence[Hypothesis] = HYPOTHESES) -> list[Alternative]:
    """Try all hypotheses on a fit, in one pass over windows of its runs; those of one effect count once."""
    windows = fit.dataset.windows(WINDOWS)
    if not windows:
        return []
    tried = [(hypothesis, columns) for hypothesis in hypotheses if (columns := hypothesis.offered(fit))]
    offers = [on_channels(hypothesis.torques, hypothesis.shared) for hypothesis, _ in tried]
    linear = linearise(fit, windows, side_by_side(offers))
    ends = np.cumsum([0, *(len(columns) for _, columns in tried)]).tolist()
    causes = _all_causes(fit, linear, tried)
    T = slopes_of(fit)
    alternatives: list[Alternative] = []
    for (hypothesis, columns), (start, stop) in zip(tried, pairwise(ends), strict=True):
        sizes, stds, shares, slopes = linear.score_tests(slice(start, stop), hypothesis.shared)
        alone = []
        for m, j in np.ndindex(*sizes.shape):
            if named := causes.get((start + m, j)):
                std = float(stds[m, j]) if np.isfinite(stds[m, j]) else None
                size, share = float(sizes[m, j]), float(shares[m, j])
                tested = replace(columns[m], causes=named, size=size, std=std, share=share)
                alone.append(tested.moving(fit, T @ slopes[m, j]))
        together = _together(fit, hypothesis, linear, range(start, stop)) if hypothesis.describe and alone else []
        alternatives += together or alone  # what they explain together counts once
    return alternatives


def ranked(
    alternatives: Sequence[Alternative], hypotheses: Sequence[Hypothesis] = HYPOTHESES
) -> tuple[Alternative, ...]:
    """Weigh alternatives: those of one joint's drive would explain the same residuals and compete."""
    of_drives = {hypothesis.name for hypothesis in hypotheses if not hypothesis.shared}
    return compete(alternatives, lambda effect: effect.causes[0].joints if effect.hypothesis in of_drives else None)


def _all_causes(
    fit: Fit, linear: Linearised, tried: Sequence[tuple[Hypothesis, Sequence[Alternative]]]
) -> dict[tuple[int, int], tuple[Finding, ...]]:
    """Group columns of one effect: by number and joint of that with the largest plausible effect, what they all are.

    Only those that contradict the description, or only those that do not, stand for each other, on the same joint.
    """
    grams = np.einsum("wjpm,wjpn->jmn", linear.offered, linear.offered)
    columns = [column for _, of_one in tried for column in of_one]
    kinds = [(hypothesis.shared, hypothesis.description) for hypothesis, of_one in tried for _ in of_one]
    plausible = np.array([column.plausible for column in columns])
    joints = fit.dataset.model.actuated
    # a base that floats has no current and no friction
    driven = np.flatnonzero(fit.system.problem.unknown_gains[: len(joints)]).tolist()
    causes: dict[tuple[int, int], tuple[Finding, ...]] = {}
    for kind in dict.fromkeys(kinds):
        shared, _ = kind
        alike = [k for k, other in enumerate(kinds) if other == kind]
        for joint in [0] if shared else driven:
            gram = grams.sum(axis=0) if shared else grams[joint]
            for group in same_effects(gram[np.ix_(alike, alike)], plausible[alike]):
                named = [columns[alike[k]].causes[0] for k in group]
                named = named if shared else [replace(cause, joints=(joints[joint],)) for cause in named]
                causes[alike[group[0]], joint] = tuple(named)
    return causes


def same_effects(gram: np.ndarray, plausible: np.ndarray) -> list[list[int]]:
    """Group columns with products ``gram`` (m, m) that are proportional to each other, those without effect alone.

    Those with the largest effect at a ``plausible`` size (m,) stand first.
    """
    groups: list[list[int]] = []
    for k in np.argsort(-np.diag(gram) * plausible**2, kind="stable").tolist():
        for group in groups:
            squares = gram[group[0], group[0]] * gram[k, k]
            if squares > 0 and 1 - gram[group[0], k] ** 2 / squares < SAME_EFFECT:
                group.append(k)
                break
        else:
            groups.append([k])
    return groups


def _together(fit: Fit, hypothesis: Hypothesis, linear: Linearised, columns: range) -> list[Alternative]:
    """Fit all columns of a hypothesis jointly, since they may explain much together and little alone."""
    assert hypothesis.describe is not None
    before, rest = linear.fitted()
    squares = rest @ rest

    def explained(tried: Sequence[int]) -> tuple[np.ndarray, float]:
        step, rest = linear.fitted(tried)
        return step, float(1 - rest @ rest / squares)

    step, share = explained(columns)
    if share < TOGETHER_SHARE:
        return []
    alone = np.array([explained([k])[1] for k in columns])
    cause = hypothesis.describe(fit, step[len(before) :], alone / share)
    slopes = slopes_of(fit) @ (step[: len(before)] - before)
    return [Alternative(hypothesis.name, (cause,), 1.0, None, "", share=share).moving(fit, slopes)]
