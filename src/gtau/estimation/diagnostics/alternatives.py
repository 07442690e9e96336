"""Model uncertainty of the estimates: alternative models, weighted by the data.

Each alternative has one unknown more, of size s. The data find s and its standard deviation; experience allows sizes up
to a plausible standard deviation. The Bayes factor between the model with it and without it (s = 0) measures the
support of the data, and the posterior of s gives the shift of the estimates (Bayesian model averaging, to first order):

    E[s^2] = p (m^2 + v),    p the probability of the alternative, m and v mean and variance of s under it.

An alternative that the data refute adds nothing; where the data are uninformative, it adds its plausible size; where
they support it, its full shift counts. Alternatives that would explain the residuals of the same joint compete for p.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from gtau.estimation.diagnostics.hypotheses import HYPOTHESES
from gtau.estimation.diagnostics.hypotheses.hypothesis import Candidates, Hypothesis
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
from gtau.estimation.diagnostics.score_test import ScoreTests, score_tests
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.newton import to_gains
from gtau.estimation.thresholds.estimates import ALTERNATIVE_PRIOR, REFUTED_STD, SAME_EFFECT, TOGETHER_SHARE
from gtau.findings import Finding

CERTAIN = 1e9  # log factor that stands for certainty
WINDOWS = 10  # of a run, within which residuals may be autocorrelated


@dataclass(frozen=True, eq=False)
class Alternative:
    """The model with one unknown more.

    Attributes
    ----------
    hypothesis : str
        The name of its hypothesis.
    causes : tuple of Finding
        What it is, and what else has the same effect; the first has the largest plausible effect.
    size, std, unit : float, float, str
        The unknown as the data find it; ``std`` is infinite where the other unknowns explain as much, and NaN where
        the share of the residual variance alone shows how significant it is.
    plausible : float
        Standard deviation of the sizes that experience allows.
    group : tuple of str
        Alternatives of one group compete: they would explain the same residuals.
    log_factor, second_moment : float
        See :func:`support`.
    probability : float
        That it holds, given the data; see :func:`compete`.
    share : float
        Share of the residual variance that goes with it.
    slopes : ndarray
        By how much (theta, gains, delays) move for a unit of it, (k,).
    moves : ndarray
        By what share of itself each gain moves at that size, (n,).
    description : bool
        Whether it contradicts the user's description of robot and logs.
    """

    hypothesis: str
    causes: tuple[Finding, ...]
    size: float
    std: float
    unit: str
    plausible: float
    group: tuple[str, ...]
    log_factor: float
    second_moment: float
    share: float
    slopes: np.ndarray
    moves: np.ndarray
    description: bool
    probability: float = 0.0

    @property
    def t(self) -> float:
        """Size in standard deviations."""
        return self.size / self.std if 0 < self.std < np.inf else 0.0

    @property
    def significant(self) -> bool:
        """Whether it is significant: by its size, or by the share that made it an alternative."""
        return bool(np.isnan(self.std)) or abs(self.t) > REFUTED_STD

    @property
    def mean_square(self) -> float:
        """Posterior mean square of its size, given the data."""
        return self.probability * self.second_moment


def support(size: float, std: float, plausible: float) -> tuple[float, float]:
    """Compute the log Bayes factor of an alternative over none, and the second moment of its size under it.

    Parameters
    ----------
    size, std : float
        The size as the data find it; ``std`` is infinite where they say nothing of it.
    plausible : float
        Standard deviation of the sizes that experience allows.
    """
    if not np.isfinite(std):
        return 0.0, plausible**2
    ratio = plausible**2 / (plausible**2 + std**2)
    factor = 0.5 * np.log1p(-min(ratio, 1 - 1e-16)) + 0.5 * ratio * (size / std) ** 2
    return float(factor), float((ratio * size) ** 2 + ratio * std**2)


def compete(alternatives: Sequence[Alternative]) -> tuple[Alternative, ...]:
    """Assign probabilities to the alternatives of each group: one of them holds, or none."""
    groups: dict[tuple[str, ...], list[Alternative]] = {}
    for each in alternatives:
        groups.setdefault(each.group, []).append(each)
    found: list[Alternative] = []
    for members in groups.values():
        prior = np.log(ALTERNATIVE_PRIOR / len(members) / (1 - ALTERNATIVE_PRIOR))
        # log odds over none, of which certain ones are beyond all others; the largest is taken off against overflow
        odds = np.append(prior + np.minimum([each.log_factor for each in members], CERTAIN), 0.0)
        odds = np.exp(odds - odds.max())
        found += [replace(each, probability=float(p)) for each, p in zip(members, odds[:-1] / odds.sum(), strict=True)]
    return tuple(found)


def find_alternatives(
    fit: Fit, hypotheses: Sequence[Hypothesis] = HYPOTHESES, windows: Windows | None = None
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
    T = to_gains(fit.solution.iterate, problem.n_theta, fit.free_gains)
    gains = problem.gain_rows
    found: list[Tried] = []
    for m, column in enumerate(candidates.columns):
        for j in range(1 if hypothesis.shared else len(joints)):
            if not (hypothesis.shared or problem.free[j]):
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
    T = to_gains(fit.solution.iterate, fit.system.problem.n_theta, fit.free_gains)
    slopes = T @ (step[: J.shape[1]] - before)
    cause = describe(step[J.shape[1] :], alone / share)
    moves = slopes[fit.system.problem.gain_rows] / fit.gains
    return [
        Alternative(
            hypothesis.name, (cause,), 1.0, np.nan, "", 1.0, ("together", hypothesis.name), np.inf, 1.0, share, slopes,
            moves, hypothesis.description,
        )
    ]  # fmt: skip


def established(
    fit: Fit,
    hypothesis: str,
    cause: Finding,
    moves: np.ndarray,
    share: float,
    size: float = 1.0,
    std: float = np.nan,
    unit: str = "",
) -> Alternative:
    """Make an alternative of what a separate test found to be significant; ``moves`` (n,) are those of the gains."""
    slopes = np.zeros(len(fit.solution.stacked))
    slopes[fit.system.problem.gain_rows] = moves * fit.gains / size
    group = (cause.kind, *cause.joints)
    return Alternative(
        hypothesis, (cause,), size, std, unit, abs(size), group, np.inf, size**2, share, slopes, moves, description=True
    )


def model_covariance(alternatives: Sequence[Alternative], size: int) -> np.ndarray:
    """Compute the covariance of (theta, gains, delays) that all alternatives together add, (k, k)."""
    total = np.zeros((size, size))
    for each in alternatives:
        total += each.mean_square * np.outer(each.slopes, each.slopes)
    return total


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
