"""Rank what the column of effort may hold by the likelihood of the same rows.

A meaning alters the column (another instant, another joint's, another sign) or the equations (without gravity), never
the rows nor the freedom of the parameters. What it leaves of each joint's column gives its likelihood, Gaussian with a
variance of each joint, less half the logarithm of the rows for each number that it chooses (BIC); rows count by the
autocorrelation of their residuals. Signs, and columns of joints that move alike, show only where the joints share their
parameters, which torques do and currents of unknown gains do not. "None of these" leaves a quarter of every column.

Gravity is missing only where its coefficient, with that of inertia as one, is 0 and not 1; where the robot's file
states inertias, so is that of the file's gravity. Otherwise another scale, or another direction, explains the log.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any

import numpy as np

from gtau.estimation.diagnostics.effort_rows import JointRows, basis_of, joint_rows, triangles, unexplained
from gtau.estimation.diagnostics.linearisation import least_squares_step
from gtau.estimation.regression.assembly import stated_inertias
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.thresholds.estimates import (
    GRAVITY_MISFIT,
    HARDLY_NEGATIVE,
    LIKELY_SHARES,
    MISFIT,
    RETRIED,
    SIGN_STD,
    SWAPPED,
    TINY,
)
from gtau.estimation.thresholds.logs import AS_WELL, LATE, MEANING_CLOSE, NO_GRAVITY, WITH_GRAVITY
from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.model.base_parameters import of_drive

AS_STATED, NONE = "as stated", "none of these"
SHARES = (0.0, 0.1, 0.2, 0.35, 0.5, 0.7, 0.85, 1.0, 1.2, 1.5, 2.0, 3.0)  # of gravity that are tried
REWEIGHTED = 3  # steps that find the variances of joints with common parameters


@dataclass(frozen=True, eq=False)
class Meaning:
    """A meaning of effort, by ``kind``: ``left`` (n,) are the shares of the columns that it leaves, rms.

    ``altered`` are the joints whose columns it changes, and ``likelihood`` the logarithm. The ``values`` of the stated
    meaning are the interval of the coefficient of ``gravity``, the ``scale``, the torque over that of the file's
    inertias with its standard deviation, None without them, and ``open``, whether the rows fit without gravity as well
    as with it, and the file states no inertias.
    """

    kind: str
    left: np.ndarray
    likelihood: float
    altered: tuple[int, ...] = ()
    values: dict[str, Any] = field(default_factory=dict)


Maker = Callable[..., Meaning]
UNRANKED = (Meaning(AS_STATED, np.zeros(0), 0.0),)


def stated_meaning(meanings: Sequence[Meaning]) -> Meaning:
    """Return the stated one of ranked meanings."""
    return next(meaning for meaning in meanings if meaning.kind == AS_STATED)


def effort_findings(meanings: Sequence[Meaning], dataset: Dataset) -> Iterator[Finding]:
    """Say what the altered columns hold, if that is the most likely meaning, and which one is nearly as likely."""
    best, names, stated = meanings[0], dataset.model.actuated, stated_meaning(meanings).left
    close = [other.kind for other in meanings[1:2] if best.likelihood - other.likelihood < MEANING_CLOSE]
    values = {"kind": dataset.runs[0].kind, "also": f" (nearly as likely: {close[0]})" if close else ""}
    if best.kind == F.LATE:
        for j, lag in zip(best.altered, best.values["lags"], strict=True):
            shares = {"lag": lag, "shifted": float(best.left[j]), "as_logged": float(stated[j])}
            yield Finding(F.LATE, (names[j],), values=values | shares, size=float(stated[j]))
    elif best.kind in (F.SWAPPED, F.MAGNITUDES, F.REVERSED):
        shares = {"exchanged": best.values["after"], "as_logged": best.values["before"]}
        joints = tuple(names[j] for j in best.altered)
        yield Finding(F(best.kind), joints, values=values | shares, size=1 - shares["exchanged"] / shares["as_logged"])


def rank_meanings(dataset: Dataset, slowest: float) -> tuple[Meaning, ...]:
    """Rank the meanings of effort, the most likely first; only the stated one where there are too few rows.

    ``slowest`` is the longest delay that the model describes, s; where it is 0 no other is tried.
    """
    joints = joint_rows(dataset, slowest)
    if not joints:
        return UNRANKED
    left = np.array([float(joint.left(joint.mine)) for joint in joints])
    counts = np.array([joint.independent for joint in joints])

    def made(kind: str, shares: np.ndarray, altered: Sequence[int] = (), chosen: int = 0, **values: Any) -> Meaning:
        likelihood = -float(counts @ np.log(np.maximum(shares, TINY))) - chosen / 2 * float(np.log(counts.sum()))
        return Meaning(kind, shares, likelihood, tuple(altered), values)

    stated, none = made(AS_STATED, left), made(NONE, np.full(len(left), float(MISFIT)))
    factors, meanings = triangles(joints), [none]
    meanings += _late(joints, left, made)
    meanings += _permuted(joints, left, counts, made)
    meanings += _magnitudes(joints, left, made)
    alone = not dataset.robot.floating and not any(run.wrenches for run in dataset.runs)
    torques = alone and dataset.runs[0].kind == "torque"
    if torques and stated.likelihood > none.likelihood:
        meanings += _among_joints(joints, factors, stated, counts)
    profile = _gravity_profile(joints, factors, made)
    likely = np.array([meaning.likelihood for meaning in profile])
    held = np.array(SHARES)[likely > likely.max() - LIKELY_SHARES]
    low, high = float(held.min()), float(held.max())
    as_well = profile[0].likelihood > stated.likelihood - counts.sum() / 2 * np.log(AS_WELL)
    coefficients, gain = _by_file(joints, counts, dataset) if torques else (None, 0.0)
    scale = None
    if coefficients is None:
        without, gain = low <= NO_GRAVITY and high < WITH_GRAVITY, profile[0].likelihood - stated.likelihood
    else:
        (coefficient, std), scale = coefficients
        near = max(abs(coefficient) - SIGN_STD * std, 0.0)  # a reversed column has gravity too
        without = as_well and near < NO_GRAVITY and abs(coefficient) + SIGN_STD * std < WITH_GRAVITY
    if scale is not None and (turned := scale[0] / scale[1]) < -SIGN_STD:
        likelihood = stated.likelihood + 2 * turned**2  # of the coefficient, at its size with either sign
        values = {"after": float(left.max()), "before": 1.0}
        meanings.append(Meaning(F.REVERSED, left, likelihood, tuple(range(len(left))), values))
    if alone and without and gain > MEANING_CLOSE:
        meanings.append(replace(profile[0], likelihood=stated.likelihood + gain))
    is_open = as_well and low <= NO_GRAVITY and coefficients is None
    stated = replace(stated, values={"gravity": (low, high), "scale": scale, "open": is_open})
    return tuple(sorted([stated, *meanings], key=lambda meaning: -meaning.likelihood))


def _late(joints: Sequence[JointRows], left: np.ndarray, made: Maker) -> Iterator[Meaning]:
    """Shift the columns that fit much better at a lag, of either sign, than at any delay that the model describes."""
    shifted = np.array([float(joint.left(joint.shifted)) for joint in joints])
    late = [
        joint.index
        for joint in joints
        if joint.lags[0] != joint.lags[1] and shifted[joint.index] < LATE * left[joint.index]
    ]
    if late:
        shares = np.where(np.isin(range(len(left)), late), shifted, left)
        yield made(F.LATE, shares, late, len(late), lags=[joints[j].lags[1] for j in late])


def _permuted(joints: Sequence[JointRows], left: np.ndarray, counts: np.ndarray, made: Maker) -> Iterator[Meaning]:
    """Assign each joint the column that fits its equations best, every column once."""
    from scipy.optimize import linear_sum_assignment

    shares = np.array([joint.left(joint.effort) for joint in joints])
    _, order = linear_sum_assignment(counts[:, None] * np.log(np.maximum(shares, TINY)))
    altered = np.flatnonzero(order != np.arange(len(joints)))
    assigned = shares[range(len(joints)), order]
    if len(altered) and np.all(assigned[altered] < SWAPPED * left[altered]):
        after, before = float(assigned[altered].max()), float(left[altered].min())
        yield made(F.SWAPPED, assigned, altered.tolist(), after=after, before=before)


def _magnitudes(joints: Sequence[JointRows], left: np.ndarray, made: Maker) -> Iterator[Meaning]:
    """Give columns without negative values the signs with which the equations explain most of them."""
    shares = left.copy()
    for joint in joints:
        effort = joint.mine
        if effort.size and effort.min() > -HARDLY_NEGATIVE * effort.max():
            shares[joint.index] = float(joint.left(_signed(joint, effort)))
    altered = np.flatnonzero(shares < SWAPPED * left).tolist()
    if altered:
        after, before = float(shares[altered].max()), float(left[altered].min())
        yield made(F.MAGNITUDES, shares, altered, len(altered), after=after, before=before)


def _signed(joint: JointRows, effort: np.ndarray) -> np.ndarray:
    """Choose the signs of the stretches between minima, first by an eigenvector, then one by one."""
    lowest = np.flatnonzero((effort[1:-1] <= effort[:-2]) & (effort[1:-1] < effort[2:])) + 1
    stretch = np.searchsorted(lowest, np.arange(len(effort)), side="right")
    parts = np.zeros((len(lowest) + 1, joint.basis.shape[1]))
    np.add.at(parts, stretch, effort[:, None] * joint.basis)
    signs = np.where(np.linalg.svd(parts, full_matrices=False)[0][:, 0] < 0, -1.0, 1.0)
    for _ in range(len(signs)):
        gains = np.sum(parts**2, axis=1) - signs * (parts @ (signs @ parts))
        if (k := int(np.argmax(gains))) >= 0 and gains[k] <= TINY * np.sum(parts**2):
            break
        signs[k] *= -1
    return np.asarray(signs[stretch] * effort)


def _among_joints(
    joints: Sequence[JointRows], factors: Sequence[np.ndarray], stated: Meaning, counts: np.ndarray
) -> Iterator[Meaning]:
    """Exchange two columns, or reverse some, so that the parameters which the joints share explain them together."""
    n = len(joints)
    order, signs = np.arange(n), np.ones(n)
    before = _together(joints, factors, order, signs)

    def likelihood(shares: np.ndarray) -> float:
        return -float(counts @ np.log(np.maximum(shares, TINY)))

    def meaning(kind: str, shares: np.ndarray, altered: list[int], chosen: int) -> Iterator[Meaning]:
        if altered and np.all(shares[altered] < SWAPPED * before[altered]):
            gain = likelihood(shares) - likelihood(before) - chosen / 2 * float(np.log(counts.sum()))
            values = {"after": float(shares[altered].max()), "before": float(before[altered].min())}
            yield Meaning(kind, stated.left, stated.likelihood + gain, tuple(altered), values)

    wrong = np.flatnonzero((before > RETRIED * stated.left) & (before > GRAVITY_MISFIT)).tolist()
    for pair in combinations(range(n), 2):
        if set(pair) & set(wrong):
            other = order.copy()
            other[list(pair)] = order[list(pair[::-1])]
            yield from meaning(F.SWAPPED, _together(joints, factors, other, signs), list(pair), 0)
    shares = before
    for j in wrong:
        turned = signs.copy()
        turned[j] *= -1
        after = _together(joints, factors, order, turned)
        if after[j] < SWAPPED * shares[j]:
            signs, shares = turned, after
    if np.sum(signs < 0) > n / 2:
        signs = -signs
    yield from meaning(F.REVERSED, shares, np.flatnonzero(signs < 0).tolist(), n)


def _together(
    joints: Sequence[JointRows], factors: Sequence[np.ndarray], order: np.ndarray, signs: np.ndarray
) -> np.ndarray:
    """Fit the columns, in some ``order`` and with ``signs``, by common parameters: the shares that they leave (n,)."""
    size = 1 + max(int(part.names.max()) for part in joints)
    rows, efforts = [], []
    for joint, R, column, sign in zip(joints, factors, order, signs, strict=True):
        p = len(joint.names)
        rows.append(np.zeros((len(R), size)))
        rows[-1][:, joint.names] = R[:, :p]
        efforts.append(sign * R[:, 2 * p + column])
    norms = np.array([max(float(np.linalg.norm(part)), 1e-300) for part in efforts])
    left = np.ones(len(joints))
    for _ in range(REWEIGHTED):
        weights = 1 / (norms * np.maximum(left, TINY))
        J = np.concatenate([weight * part for weight, part in zip(weights, rows, strict=True)])
        e = np.concatenate([weight * part for weight, part in zip(weights, efforts, strict=True)])
        theta = least_squares_step(J, -e)
        left = np.array([np.linalg.norm(v - A @ theta) for v, A in zip(efforts, rows, strict=True)]) / norms
    return left


def _gravity_profile(joints: Sequence[JointRows], factors: Sequence[np.ndarray], made: Maker) -> list[Meaning]:
    """Fit the columns with each of the ``SHARES`` of gravity, that of inertia being one."""
    profile = []
    for share in SHARES:
        left = []
        for joint, R in zip(joints, factors, strict=True):
            p = len(joint.names)
            basis = basis_of(R[:, :p] - (1 - share) * R[:, p : 2 * p])
            left.append(float(unexplained(basis, R[:, 2 * p + joint.index])))
        profile.append(made(F.WITHOUT_GRAVITY, np.array(left)))
    return profile


def _by_file(
    joints: Sequence[JointRows], counts: np.ndarray, dataset: Dataset
) -> tuple[list[tuple[float, float]] | None, float]:
    """Regress the torques of the runs without payload on those that the file's inertias give, and friction.

    Coefficients of the file's gravity, and of its whole torque, have standard deviations, and are None without them;
    the number is how much more likely the rows are without the file's gravity than with it, a logarithm.
    """
    stated, base = stated_inertias(dataset.robot), dataset.base
    if not any(stated.values()) or not all(joint.free.any() for joint in joints):
        return None, 0.0
    values = base.matrix @ np.array([stated.get(name, 0.0) for name in dataset.model.parameter_names])
    estimates, gain = np.zeros((2, len(joints), 3)), 0.0  # coefficient, variance and weight, (N m)^2
    for joint, count in zip(joints, counts, strict=True):
        name = dataset.model.actuated[joint.index]
        drive = [k for k, parameter in enumerate(base.standard) if of_drive(parameter, name)]
        first = joint.names < base.count
        first &= np.any(joint.own[joint.free], axis=0)
        W, G = joint.own[joint.free][:, first], joint.weight[joint.free][:, first]
        driven = [k for k, number in enumerate(joint.names[first] % base.count) if number in drive]
        chi = values[joint.names[first] % base.count]
        gravity, total, effort = G @ chi, W @ chi, joint.mine[joint.free]
        for row, columns in enumerate(([gravity, total - gravity], [total])):
            others = (
                basis_of(np.column_stack([*columns[1:], W[:, driven]])) if len(driven) or len(columns) > 1 else W[:, :0]
            )
            x, y = (part - others @ (others.T @ part) for part in (columns[0], effort))
            size, rounding = float(x @ x), TINY * max(float(columns[0] @ columns[0]), 1e-300)
            if size > rounding:
                coefficient = float(x @ y) / size
                rest = y - coefficient * x
                estimates[row, joint.index] = coefficient, float(rest @ rest) / count / size, size
            if row == 0 and size:
                gain += count / 2 * float(np.log(max((y - x) @ (y - x), 1e-300) / max(y @ y, 1e-300)))
    pooled = []
    for coefficient, variance, weight in (part.T for part in estimates):
        mean = float(weight @ coefficient) / max(float(weight.sum()), 1e-300)
        spread = np.sqrt(weight**2 @ ((coefficient - mean) ** 2 + variance)) / max(float(weight.sum()), 1e-300)
        pooled.append((mean, float(spread)))
    return (pooled, gain) if np.any(estimates[0, :, 2]) else (None, 0.0)
