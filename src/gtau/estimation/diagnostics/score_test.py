"""Score tests for one additional unknown: its size, its significance, and by how much it would move the estimates."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from gtau.estimation.diagnostics.alternatives import Alternative, Candidates, Hypothesis, support
from gtau.estimation.diagnostics.linearisation import (
    LinearisedWindow,
    Windows,
    central_windows,
    in_step,
    known_rows,
    least_squares_step,
    linearise,
    on_channels,
    side_by_side,
    stack,
)
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.newton import to_gains, whitening
from gtau.estimation.thresholds.estimates import SAME_EFFECT, TOGETHER_SHARE
from gtau.findings import Finding

SPANNED = 1e-6  # of the square of a column: less is left by the other unknowns, so it could be any of them


@dataclass(frozen=True, eq=False)
class ScoreTests:
    """Of each candidate column m in each joint's equations, (m, n); n is 1 for columns that act on all joints.

    Its ``size``, the standard deviation ``std`` of that (infinite where the other unknowns span the column), the
    ``share`` of the residual variance that goes with it, and by how much the other unknowns move for a unit of it,
    ``slopes`` (m, n, k), in the order of :func:`gtau.estimation.estimators.newton.jacobian`.
    """

    size: np.ndarray
    std: np.ndarray
    share: np.ndarray
    slopes: np.ndarray

    @property
    def t(self) -> np.ndarray:
        """Sizes in standard deviations."""
        return np.asarray(self.size / np.maximum(self.std, 1e-300))


def score_tests(
    windows: Callable[[], Iterable[LinearisedWindow]],
    hypotheses: Sequence[tuple[slice, bool]],
    clusters: np.ndarray,
    known: np.ndarray | None = None,
) -> tuple[ScoreTests, ...]:
    """Test each candidate column alone, in each channel's equations alone or shared by all channels.

    All other unknowns adapt to it. Standard deviations follow from the scatter over clusters of windows, within which
    residuals may be correlated (a sandwich estimate).

    Parameters
    ----------
    windows : callable
        Gives the windows anew each time, so that they need not be in memory together.
    hypotheses : sequence of (slice, bool)
        Columns that belong together, and whether each of them acts on all channels with one size.
    clusters : ndarray
        (W,) the number of the cluster that each window belongs to, from 0.
    known : ndarray, optional
        Jacobian (., k) of further equations, of known parameters, with errors of unit variance.

    Returns
    -------
    tuple of ScoreTests
        One for each hypothesis.
    """

    def folded(of_joints: np.ndarray) -> list[np.ndarray]:
        """Sum (m, n, ...) by hypothesis, that of shared columns over the channels, (m, 1, ...)."""
        return [
            of_joints[columns].sum(axis=1, keepdims=True) if shared else of_joints[columns]
            for columns, shared in hypotheses
        ]

    count, joints = int(clusters.max()) + 1, next(iter(windows())).errors.shape[0]
    blocks = []
    for each in windows():
        blocks.append(each.jacobian.reshape(-1, each.jacobian.shape[-1]))
    if known is not None:
        blocks.append(known)
    back = whitening(np.concatenate(blocks), np.zeros(joints))
    J_e, e_e = np.zeros(back.shape[1]), 0.0
    sums = [np.zeros(())] * 3
    for each in windows():
        W, e, c = each.jacobian @ back, each.errors, each.offered  # W has orthonormal columns over all windows
        J_e, e_e = J_e + np.einsum("jpk,jp->k", W, e), e_e + float(np.sum(e**2))
        more = _products(W, c, e)
        sums = [before + now for before, now in zip(sums, more, strict=True)]
    J_c, c_c, c_e = (folded(each) for each in sums)
    left = [squares - np.sum(along**2, axis=2) for squares, along in zip(c_c, J_c, strict=True)]
    spanned = [rest <= SPANNED * np.maximum(squares, 1e-300) for rest, squares in zip(left, c_c, strict=True)]
    left = [np.where(lost, 1.0, rest) for lost, rest in zip(spanned, left, strict=True)]
    size = [
        -np.where(lost, 0.0, (score - along @ J_e) / rest)
        for lost, score, along, rest in zip(spanned, c_e, J_c, left, strict=True)
    ]
    scores = [np.zeros((count, *rest.shape)) for rest in left]
    for cluster, each in zip(clusters, windows(), strict=True):
        W, c = each.jacobian @ back, each.offered
        rest = each.errors - W @ J_e
        # the score of a window: what is left of its column, (m, j) of joint j in all rows i, times its residuals
        W_rest, W_W = np.einsum("ipk,ip->k", W, rest), np.einsum("ipk,ipl->kl", W, W, optimize=True)
        own_W, own_own, own_rest = (folded(part) for part in _products(W, c, rest))
        for k, along in enumerate(J_c):
            score = own_rest[k] - along @ W_rest
            square = own_own[k] + np.sum((along @ W_W - 2 * own_W[k]) * along, axis=2)
            scores[k][cluster] += score + size[k] * square
    least = max(e_e - float(J_e @ J_e), 1e-300)
    return tuple(
        ScoreTests(
            size[k],
            np.where(spanned[k], np.inf, np.sqrt(np.sum(scores[k] ** 2, axis=0) * count / max(count - 1, 1)) / left[k]),
            np.where(spanned[k], 0.0, size[k] ** 2 * left[k] / least),
            -J_c[k] @ back.T,
        )
        for k in range(len(hypotheses))
    )


def _products(W: np.ndarray, c: np.ndarray, e: np.ndarray) -> list[np.ndarray]:
    """Multiply columns (c, p, m) with W (c, p, k), themselves and the residuals (c, p), channel by channel."""
    of_joint = c.swapaxes(1, 2)  # (c, m, p)
    return [
        (of_joint @ W).swapaxes(0, 1),
        np.einsum("jpm,jpm->mj", c, c),
        (of_joint @ e[..., None])[..., 0].T,
    ]


WINDOWS = 10  # of a run, within which residuals may be autocorrelated


def find_alternatives(
    fit: Fit, hypotheses: Sequence[Hypothesis], windows: Windows | None = None
) -> tuple[Alternative, ...]:
    """Try all hypotheses on a fit, in one pass over windows of its runs.

    Parameters
    ----------
    fit : Fit
        What was estimated.
    hypotheses : sequence of Hypothesis
        What is tried.
    windows : sequence, optional
        Where: the :func:`central_windows` of the runs, ``WINDOWS`` of each, unless others are given.
    """
    tried = [(each, made) for each in hypotheses if (made := each.candidates(fit)) is not None]
    windows = central_windows(fit.dataset, WINDOWS) if windows is None else windows
    if not windows:
        return ()
    offers = [on_channels(candidates.offer, hypothesis.shared) for hypothesis, candidates in tried]
    linear, known = linearise(fit, side_by_side(offers), windows), known_rows(fit, windows)
    found: list[Alternative] = []
    ends = np.cumsum([0, *(len(candidates.columns) for _, candidates in tried)])
    columns = [slice(*pair) for pair in pairwise(ends.tolist())]
    shared = [hypothesis.shared for hypothesis, _ in tried]
    tests = score_tests(
        lambda: linear, list(zip(columns, shared, strict=True)), in_step(fit.dataset, windows), known[1]
    )
    alone: list[Tried] = []
    for (hypothesis, candidates), of_columns, mine in zip(tried, tests, columns, strict=True):
        alone += _alternatives(fit, hypothesis, candidates, of_columns, mine.start)
    once = _counted_once(alone, linear)
    for (hypothesis, candidates), mine in zip(tried, columns, strict=True):
        kept = [each for column, _, each in once if mine.start <= column < mine.stop]
        together = []
        if candidates.describe is not None and kept:
            windows_of = [replace(each, offered=each.offered[..., mine]) for each in linear]
            together = _together(fit, hypothesis, candidates.describe, windows_of, known)
        found += together or kept  # what they explain together counts once
    return tuple(found)


Tried = tuple[int, int | None, Alternative]
"""An alternative, after the numbers of its column in the windows and of its joint, None where it acts on all."""


def _alternatives(
    fit: Fit, hypothesis: Hypothesis, candidates: Candidates, tests: ScoreTests, first: int
) -> list[Tried]:
    problem, joints = fit.system.problem, fit.dataset.model.actuated
    T = to_gains(fit.solution.iterate, fit.free_gains)
    gains = problem.gain_rows
    found: list[Tried] = []
    for m, column in enumerate(candidates.columns):
        for j in range(1 if hypothesis.shared else len(joints)):
            if not (hypothesis.shared or problem.unknown_gains[j]):
                continue  # a base that floats has no current and no friction
            slopes = T @ tests.slopes[m, j]
            size, std = float(tests.size[m, j]), float(tests.std[m, j])
            plausible, cause = float(column.plausible), column.finding
            alternative = Alternative(
                hypothesis.name,
                (cause if hypothesis.shared else replace(cause, joints=(joints[j],)),),
                size,
                std,
                column.unit,
                plausible,
                ("all", hypothesis.name, str(m)) if hypothesis.shared else (joints[j],),
                *support(size, std, plausible),
                float(tests.share[m, j]),
                slopes,
                slopes[gains] * size / fit.gains,
                hypothesis.description,
            )
            found.append((first + m, None if hypothesis.shared else j, alternative))
    return found


def _counted_once(alone: Sequence[Tried], windows: Sequence[LinearisedWindow]) -> list[Tried]:
    """Keep the alternative with the largest plausible effect among those of the same effect, and name the others."""
    kept = {}
    for group in same_effects(alone, windows):
        column, joint, first = alone[group[0]]
        causes = tuple(cause for position in group for cause in alone[position][-1].causes)
        kept[group[0]] = column, joint, replace(first, causes=causes)
    return [kept[position] for position in sorted(kept)]


def _together(
    fit: Fit,
    hypothesis: Hypothesis,
    describe: Callable[[np.ndarray, np.ndarray], Finding],
    windows: Sequence[LinearisedWindow],
    known: tuple[np.ndarray, np.ndarray],
) -> list[Alternative]:
    """Fit all candidates of a hypothesis jointly, since they may explain much together and little alone."""
    e, J, columns = stack(windows)
    e, J = np.concatenate([e, known[0]]), np.concatenate([J, known[1]])
    columns = np.pad(columns, ((0, len(known[0])), (0, 0)))

    def fitted(more: np.ndarray) -> tuple[np.ndarray, float]:
        wide = np.hstack([J, more])
        step = least_squares_step(wide, e)
        return step, float(np.sum((e + wide @ step) ** 2))

    (before, rest), (step, left) = fitted(columns[:, :0]), fitted(columns)
    share = 1 - left / rest
    if share < TOGETHER_SHARE:
        return []
    alone = np.array([1 - fitted(columns[:, [k]])[1] / rest for k in range(columns.shape[1])])
    T = to_gains(fit.solution.iterate, fit.free_gains)
    slopes = T @ (step[: J.shape[1]] - before)
    cause = describe(step[J.shape[1] :], alone / share)
    moves = slopes[fit.system.problem.gain_rows] / fit.gains
    return [
        Alternative(
            hypothesis.name, (cause,), 1.0, np.nan, "", 1.0, ("together", hypothesis.name), np.inf, 1.0, share, slopes,
            moves, hypothesis.description,
        )
    ]  # fmt: skip


def same_effects(tried: Sequence[Tried], windows: Sequence[LinearisedWindow]) -> list[list[int]]:
    """Group candidates whose torques are proportional to each other, those without effect each by itself.

    Only candidates which contradict the description, or only those which do not, can stand for each other.

    Parameters
    ----------
    tried : sequence of Tried
        All candidates.
    windows : sequence of LinearisedWindow
        Their columns.

    Returns
    -------
    list of list of int
        Positions in ``tried``, those with the largest plausible effect first.
    """
    products = np.sum([np.einsum("jpm,jpn->jmn", each.offered, each.offered) for each in windows], axis=0)
    of_all = products.sum(axis=0)

    def product(joint: int | None, one: int, other: int) -> float:
        return float((of_all if joint is None else products[joint])[one, other])

    def effect(k: int) -> float:
        column, joint, each = tried[k]
        return product(joint, column, column) * each.plausible**2

    def same(one: Tried, other: Tried) -> bool:
        (column, joint, first), (another, of_another, second) = one, other
        if (joint, first.description) != (of_another, second.description):
            return False
        squares = product(joint, column, column) * product(joint, another, another)
        return squares > 0 and 1 - product(joint, column, another) ** 2 / squares < SAME_EFFECT

    groups: list[list[int]] = []
    for k in sorted(range(len(tried)), key=effect, reverse=True):
        group = next((each for each in groups if same(tried[each[0]], tried[k])), None)
        if group is None:
            groups.append([k])
        else:
            group.append(k)
    return groups
