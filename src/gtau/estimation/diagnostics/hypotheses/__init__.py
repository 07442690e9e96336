"""The hypotheses that every fit is tested against: all that stand in modules of this package."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from importlib import import_module
from itertools import pairwise
from pkgutil import iter_modules

import numpy as np

from gtau.estimation.diagnostics.alternatives import Alternative, Hypothesis, compete
from gtau.estimation.diagnostics.linearisation import Linearised, linearise, on_channels, side_by_side
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.newton import to_gains
from gtau.estimation.regression.run_blocks import WINDOWS
from gtau.estimation.thresholds.estimates import SAME_EFFECT, TOGETHER_SHARE
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
    tried = [(hypothesis, columns) for hypothesis in hypotheses if (columns := hypothesis.offered(fit))]
    if not windows:
        return []
    offers = [on_channels(hypothesis.torques(fit), hypothesis.shared) for hypothesis, _ in tried]
    linear = linearise(fit, windows, side_by_side(offers))
    ends = np.cumsum([0, *(len(columns) for _, columns in tried)]).tolist()
    others = _other_causes(fit, linear, tried)
    T = to_gains(fit.solution.values, len(fit.solution.gains), fit.free_gains)
    alternatives: list[Alternative] = []
    for (hypothesis, columns), (start, stop) in zip(tried, pairwise(ends), strict=True):
        sizes, stds, shares, slopes = linear.score_tests(slice(start, stop), hypothesis.shared)
        alone = []
        for m, joint in np.ndindex(*sizes.shape):
            if (start + m, joint) not in others:
                continue
            tested = replace(
                columns[m],
                causes=others[start + m, joint],
                size=float(sizes[m, joint]),
                std=float(stds[m, joint]) if np.isfinite(stds[m, joint]) else None,
                share=float(shares[m, joint]),
            )
            alone.append(tested.moving(fit, T @ slopes[m, joint]))
        together = _together(fit, hypothesis, linear, range(start, stop)) if hypothesis.describe and alone else []
        alternatives += together or alone  # what they explain together counts once
    return alternatives


def ranked(
    alternatives: Sequence[Alternative], hypotheses: Sequence[Hypothesis] = HYPOTHESES
) -> tuple[Alternative, ...]:
    """Weigh alternatives: those of one joint's drive would explain the same residuals and compete."""
    of_drives = {hypothesis.name for hypothesis in hypotheses if not hypothesis.shared}
    return compete(alternatives, lambda effect: effect.causes[0].joints if effect.hypothesis in of_drives else None)


def _other_causes(
    fit: Fit, linear: Linearised, tried: Sequence[tuple[Hypothesis, Sequence[Alternative]]]
) -> dict[tuple[int, int], tuple[Finding, ...]]:
    """Group columns of one effect: by number and joint of that with the largest plausible effect, what they all are.

    Only those that contradict the description, or only those that do not, stand for each other, on the same joint.
    """
    grams = np.einsum("wjpm,wjpn->jmn", linear.offered, linear.offered)
    columns = [(hypothesis, column) for hypothesis, of_one in tried for column in of_one]
    plausible = np.array([column.plausible for _, column in columns])
    joints = fit.dataset.model.actuated
    causes: dict[tuple[int, int], tuple[Finding, ...]] = {}
    for shared in (False, True):
        # a base that floats has no current and no friction
        acting = [0] if shared else np.flatnonzero(fit.system.problem.unknown_gains[: len(joints)]).tolist()
        for joint in acting:
            gram = grams.sum(axis=0) if shared else grams[joint]
            for description_ in (False, True):
                kinds = (shared, description_)
                mine = [k for k, (each, _) in enumerate(columns) if (each.shared, each.description) == kinds]
                for group in same_effects(gram[np.ix_(mine, mine)], plausible[mine]):
                    named = [columns[mine[k]][1].causes[0] for k in group]
                    named = named if shared else [replace(cause, joints=(joints[joint],)) for cause in named]
                    causes[mine[group[0]], joint] = tuple(named)
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
    (before, rest), (step, left) = linear.fitted(), linear.fitted(columns)
    share = 1 - left @ left / (rest @ rest)
    if share < TOGETHER_SHARE:
        return []
    each_left = [linear.fitted([k])[1] for k in columns]
    alone = np.array([1 - left_alone @ left_alone / (rest @ rest) for left_alone in each_left])
    T = to_gains(fit.solution.values, len(fit.solution.gains), fit.free_gains)
    cause = hypothesis.describe(fit, step[len(before) :], alone / share)
    together = Alternative(hypothesis.name, (cause,), 1.0, None, "", share=float(share))
    return [together.moving(fit, T @ (step[: len(before)] - before))]
