"""Rank what the column of effort may hold by the likelihood of the same rows.

A meaning alters the column (another instant, another joint's, another sign) or the equations (without gravity), never
the rows nor the freedom of the parameters. What it leaves of each joint's column gives its likelihood, Gaussian with a
variance of each joint, less half the logarithm of the rows for each number that it chooses (BIC); rows count by the
autocorrelation of their residuals. Signs, and columns of joints that move alike, show only where the joints share their
parameters, which torques do and currents of unknown gains do not. "None of these" leaves a quarter of every column.

Gravity is missing only where its coefficient, with that of inertia as one, is 0 and not 1; where the robot's file
states inertias, so is that of the file's gravity. Otherwise another scale, or another direction, explains the log.

A meaning is a finding on the joints whose columns it alters, with its ``likelihood``, a logarithm over
that of the stated one, and the shares that are left as it says and as logged. The stated one has the interval of the
coefficient of ``gravity``; the ``scale``, the torque over that of the file's inertias with its standard deviation, None
without them; and ``open``, whether the rows fit without gravity as well as with it, and the file states no inertias.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np

from gtau.estimation.diagnostics.effort_rows import JointRows, basis_of, beside, joint_rows, unexplained
from gtau.estimation.effects.linearisation import least_squares_step
from gtau.estimation.estimators.maximum_likelihood import MISFIT
from gtau.estimation.regression.assembly import stated_inertias
from gtau.estimation.regression.dataset import Dataset
from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.model.base_parameters import of_drive

LATE = 0.5  # unexplained share of a joint's current, shifted by more than a delay can be, over that as logged
LATE_STEADY = 0.6  # unexplained share of the shifted current over the share that terms without acceleration leave
GRAVITY_MISFIT = 0.1  # unexplained share of a joint's signal, from which gravity along other axes is tried
SWAPPED = 0.5  # unexplained share with the other joint's current over that with its own
LIKELY_SHARES = 1.92  # log likelihood below the largest that bounds a 95 % interval of one unknown
SIGN_STD = 2.0  # size of a coefficient in standard deviations, above which it has a sign
RETRIED = 2.0  # share that a joint's columns leave over that of its own parameters: more is tried with other columns
HARDLY_NEGATIVE = 0.05  # most negative value over the largest of a column of magnitudes behind a filter
TINY = 1e-9  # share of a torque that is rounding
NO_GRAVITY = 0.1  # coefficient of gravity beside inertia, down to which its interval reaches if torques may have none
WITH_GRAVITY = 0.75  # coefficient of gravity that the interval excludes if torques have none
MEANING_CLOSE = 3.0  # log likelihood by which a meaning of effort is likelier, up to which the other is said too
AS_WELL = 1.1  # residual variance without gravity over with it, up to which compensation explains torques as well

AS_STATED, NONE = "as stated", "none of these"
SHARES = (0.0, 0.1, 0.2, 0.35, 0.5, 0.7, 0.85, 1.0, 1.2, 1.5, 2.0, 3.0)  # of gravity that are tried
REWEIGHTED = 3  # steps that find the variances of joints with common parameters
INDEPENDENT = 0.99  # largest autocorrelation that is believed

Maker = Callable[..., Finding]
UNRANKED = (Finding(AS_STATED, values={"likelihood": 0.0}),)


def stated_meaning(meanings: Sequence[Finding]) -> Finding:
    """Return the stated one of ranked meanings."""
    return next(meaning for meaning in meanings if meaning.kind == AS_STATED)


def effort_findings(meanings: Sequence[Finding], dataset: Dataset) -> Iterator[Finding]:
    """Say what the altered columns hold, if that is the most likely meaning, and which one is nearly as likely."""
    best, *others = meanings
    given = best.values
    close = [other.kind for other in others[:1] if given["likelihood"] - other.values["likelihood"] < MEANING_CLOSE]
    said = {"kind": dataset.runs[0].kind, "also": f" (nearly as likely: {close[0]})" if close else ""}
    if best.kind == F.LATE:
        for joint, lag, shifted, logged in zip(best.joints, *given["late"], strict=True):
            values = said | {"lag": lag, "shifted": shifted, "as_logged": logged}
            yield Finding(F.LATE, (joint,), values=values, size=logged)
    elif best.kind in (F.SWAPPED, F.MAGNITUDES, F.REVERSED):
        exchanged, logged = given["exchanged"], given["as_logged"]
        values = said | {"exchanged": exchanged, "as_logged": logged}
        yield replace(best, values=values, size=1 - exchanged / logged)


def rank_meanings(dataset: Dataset, slowest: float) -> tuple[Finding, ...]:
    """Rank the meanings of effort, the most likely first; only the stated one where there are too few rows.

    ``slowest`` is the longest delay that the model describes, s; where it is 0 no other is tried.
    """
    joints = joint_rows(dataset, slowest)
    if not joints:
        return UNRANKED
    shares = np.array([joint.left(joint.effort) for joint in joints])  # (n, n + 1)
    remaining, names = np.diag(shares), dataset.model.actuated
    counts = np.array([_independent(joint, j) for j, joint in enumerate(joints)])
    total = float(counts.sum())

    def gain(after: np.ndarray, before: np.ndarray = remaining) -> float:
        return float(counts @ np.log(np.maximum(before, TINY) / np.maximum(after, TINY)))

    def made(
        kind: str,
        after: np.ndarray,
        altered: Sequence[int],
        chosen: int = 0,
        before: np.ndarray = remaining,
        **values: Any,
    ) -> Finding:
        values["likelihood"] = gain(after, before) - chosen / 2 * float(np.log(total))
        # means as the likelihood weighs them, so that what is likelier leaves less
        exchanged, logged = (
            float(np.exp(np.average(np.log(np.maximum(left[altered], TINY)), weights=counts[altered])))
            for left in (after, before)
        )
        values |= {"exchanged": exchanged, "as_logged": logged}
        return Finding(kind, tuple(names[j] for j in altered), values=values)

    none = gain(np.full(len(remaining), float(MISFIT)))
    meanings = [Finding(NONE, values={"likelihood": none})]
    meanings += _late(joints, shares, made)
    meanings += _permuted(shares, counts, made)
    meanings += _magnitudes(joints, remaining, made)
    alone = not dataset.robot.floating and not any(run.wrenches for run in dataset.runs)
    torques = alone and dataset.runs[0].kind == "torque"
    if torques and none < 0:
        meanings += _among_joints(joints, remaining, made)
    gains = np.array([gain(_with_gravity(joints, share)) for share in SHARES])
    held = np.array(SHARES)[gains > gains.max() - LIKELY_SHARES]
    low, high = float(held.min()), float(held.max())
    as_well = gains[0] > -total / 2 * np.log(AS_WELL)
    of_file, without = _by_file(joints, counts, dataset) if torques else (None, 0.0)
    if of_file is None:
        scale, without = None, float(gains[0])
        missing = low <= NO_GRAVITY and high < WITH_GRAVITY
    else:
        (coefficient, std), scale = of_file
        near = max(abs(coefficient) - SIGN_STD * std, 0.0)  # a reversed column has gravity too
        missing = as_well and near < NO_GRAVITY and abs(coefficient) + SIGN_STD * std < WITH_GRAVITY
        if (turned := scale[0] / scale[1]) < -SIGN_STD:  # of the coefficient, at its size with either sign
            values = {"likelihood": 2 * turned**2, "exchanged": float(remaining.max()), "as_logged": 1.0}
            meanings.append(Finding(F.REVERSED, names, values=values))
    if alone and missing and without > MEANING_CLOSE:
        meanings.append(Finding(F.WITHOUT_GRAVITY, values={"likelihood": without}))
    is_open = bool(as_well) and low <= NO_GRAVITY and of_file is None
    stated = Finding(AS_STATED, values={"likelihood": 0.0, "gravity": (low, high), "scale": scale, "open": is_open})
    return tuple(sorted([stated, *meanings], key=lambda meaning: -meaning.values["likelihood"]))


def _independent(joint: JointRows, j: int) -> float:
    """Count the independent rows of joint ``j`` by the autocorrelation of their residuals."""
    rest = beside(joint.basis, joint.effort[:, j])
    rho = float(np.clip(rest[1:] @ rest[:-1] / max(rest @ rest, 1e-300), 0.0, INDEPENDENT))
    return max(len(rest) * (1 - rho) / (1 + rho), 1.0)


def _late(joints: Sequence[JointRows], shares: np.ndarray, made: Maker) -> Iterator[Finding]:
    """Shift the columns that fit much better at a lag, of either sign, than at any delay that the model describes.

    Acceleration shows the lag: without it friction, stops and the controller look like one.
    """
    remaining, shifted = np.diag(shares), shares[:, -1]
    lags = [joint.lag for joint in joints]
    late = [j for j, lag in enumerate(lags) if lag is not None and shifted[j] < LATE * remaining[j]]
    late = [
        j for j in late if shifted[j] < LATE_STEADY * unexplained(basis_of(joints[j].steady), joints[j].effort[:, -1])
    ]
    if late:
        after = np.where(np.isin(range(len(remaining)), late), shifted, remaining)
        of_joints = [lags[j] for j in late], shifted[late].tolist(), remaining[late].tolist()
        yield made(F.LATE, after, late, len(late), late=of_joints)


def _permuted(shares: np.ndarray, counts: np.ndarray, made: Maker) -> Iterator[Finding]:
    """Assign each joint the column that fits its equations best, every column once."""
    from scipy.optimize import linear_sum_assignment

    _, order = linear_sum_assignment(counts[:, None] * np.log(np.maximum(shares[:, :-1], TINY)))
    joints = np.arange(len(order))
    altered, assigned = np.flatnonzero(order != joints), shares[joints, order]
    if len(altered) and np.all((assigned < SWAPPED * np.diag(shares))[altered]):
        yield made(F.SWAPPED, assigned, altered.tolist())


def _magnitudes(joints: Sequence[JointRows], remaining: np.ndarray, made: Maker) -> Iterator[Finding]:
    """Give columns without negative values the signs with which the equations explain most of them."""
    shares = remaining.copy()
    for j, joint in enumerate(joints):
        effort = joint.effort[:, j]
        if effort.size and effort.min() > -HARDLY_NEGATIVE * effort.max():
            shares[j] = joint.left(_signed(joint.basis, effort))
    altered = np.flatnonzero(shares < SWAPPED * remaining).tolist()
    if altered:
        yield made(F.MAGNITUDES, shares, altered, len(altered))


def _signed(basis: np.ndarray, effort: np.ndarray) -> np.ndarray:
    """Choose the signs of the parts between minima, first by an eigenvector, then one by one."""
    lowest = np.flatnonzero((effort[1:-1] <= effort[:-2]) & (effort[1:-1] < effort[2:])) + 1
    part = np.searchsorted(lowest, np.arange(len(effort)), side="right")
    sums = np.zeros((len(lowest) + 1, basis.shape[1]))
    np.add.at(sums, part, effort[:, None] * basis)
    signs = np.where(np.linalg.svd(sums, full_matrices=False)[0][:, 0] < 0, -1.0, 1.0)
    for _ in signs:
        gains = np.sum(sums**2, axis=1) - signs * (sums @ (signs @ sums))
        k = int(np.argmax(gains))
        if gains[k] <= TINY * np.sum(sums**2):
            break
        signs[k] *= -1
    return np.asarray(signs[part] * effort)


def _among_joints(joints: Sequence[JointRows], remaining: np.ndarray, made: Maker) -> Iterator[Finding]:
    """Exchange two columns, or reverse some, so that the parameters which the joints share explain them together."""
    n = len(joints)
    order, signs = np.arange(n), np.ones(n)
    before = _together(joints, order, signs)

    def helping(kind: str, after: np.ndarray, altered: list[int], chosen: int) -> Iterator[Finding]:
        if altered and np.all((after < SWAPPED * before)[altered]):
            yield made(kind, after, altered, chosen, before)

    wrong = np.flatnonzero(before > np.maximum(RETRIED * remaining, GRAVITY_MISFIT)).tolist()
    for pair in combinations(range(n), 2):
        if set(pair) & set(wrong):
            other = order.copy()
            other[list(pair)] = pair[::-1]
            yield from helping(F.SWAPPED, _together(joints, other, signs), list(pair), 0)
    shares = before
    for j in wrong:
        turned = np.where(order == j, -signs, signs)
        after = _together(joints, order, turned)
        if after[j] < SWAPPED * shares[j]:
            signs, shares = turned, after
    reversed_ = signs < 0
    if np.sum(reversed_) > n / 2:
        reversed_ = ~reversed_
    yield from helping(F.REVERSED, shares, np.flatnonzero(reversed_).tolist(), n)


def _together(joints: Sequence[JointRows], order: np.ndarray, signs: np.ndarray) -> np.ndarray:
    """Fit the columns, in some ``order`` and with ``signs``, by common parameters: the shares that they leave (n,)."""
    size = 1 + max(int(joint.names.max()) for joint in joints)
    rows, efforts = [], []
    for joint, column, sign in zip(joints, order, signs, strict=True):
        R, p = joint.factor, len(joint.names)
        rows.append(np.zeros((len(R), size)))
        rows[-1][:, joint.names] = R[:, :p]
        efforts.append(sign * R[:, 2 * p + column])
    norms = np.array([max(float(np.linalg.norm(effort)), 1e-300) for effort in efforts])
    remaining = np.ones(len(joints))
    for _ in range(REWEIGHTED):
        weights = 1 / (norms * np.maximum(remaining, TINY))
        J, e = (np.concatenate([w * part for w, part in zip(weights, parts, strict=True)]) for parts in (rows, efforts))
        theta = least_squares_step(J, -e)
        remaining = np.array([np.linalg.norm(v - A @ theta) for v, A in zip(efforts, rows, strict=True)]) / norms
    return remaining


def _with_gravity(joints: Sequence[JointRows], share: float) -> np.ndarray:
    """Fit the columns with a ``share`` of gravity, that of inertia being one: the shares that they leave (n,)."""
    remaining = []
    for j, joint in enumerate(joints):
        R, p = joint.factor, len(joint.names)
        basis = basis_of(R[:, :p] - (1 - share) * R[:, p : 2 * p])
        remaining.append(unexplained(basis, R[:, 2 * p + j]))
    return np.array(remaining)


def _by_file(
    joints: Sequence[JointRows], counts: np.ndarray, dataset: Dataset
) -> tuple[list[tuple[float, float]] | None, float]:
    """Regress the torques of the runs without payload on those that the file's inertias give, and friction.

    Coefficients of the file's gravity, and of its whole torque, have standard deviations, and are None without them;
    the number is how much more likely the rows are without the file's gravity than with it, a logarithm.
    """
    stated, base = stated_inertias(dataset.robot), dataset.base
    if not any(stated.values()) or all(run.payload for run in dataset.runs):
        return None, 0.0
    values = base.matrix @ [stated.get(name, 0.0) for name in dataset.model.parameter_names]
    estimates, gain = np.zeros((2, len(joints), 3)), 0.0  # coefficient, variance and weight, (N m)^2
    for j, (joint, count) in enumerate(zip(joints, counts, strict=True)):
        first = joint.names < base.count
        free = joint.columns[:, first].any(axis=1)
        names, W = joint.names[first], joint.columns[free][:, first]
        gravity, torque = joint.weight[free][:, first] @ values[names], W @ values[names]
        driven = W[:, [of_drive(base.standard[k], dataset.model.actuated[j]) for k in names]]
        regressed = (gravity, np.column_stack([torque - gravity, driven])), (torque, driven)
        for row, (column, others) in enumerate(regressed):
            basis = basis_of(others)
            x, y = beside(basis, column), beside(basis, joint.effort[free, j])
            size, rounding = float(x @ x), TINY * max(float(column @ column), 1e-300)
            if size > rounding:
                coefficient = float(x @ y) / size
                rest = y - coefficient * x
                estimates[row, j] = coefficient, float(rest @ rest) / count / size, size
            if row == 0 and size:
                gain += count / 2 * float(np.log(max((y - x) @ (y - x), 1e-300) / max(y @ y, 1e-300)))
    if not np.any(estimates[0, :, 2]):
        return None, 0.0
    coefficients, variances, weights = np.moveaxis(estimates, -1, 0)  # (2, n) each
    weights = weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-300)
    means = np.sum(weights * coefficients, axis=1, keepdims=True)
    stds = np.sqrt(np.sum(weights**2 * ((coefficients - means) ** 2 + variances), axis=1))
    return list(zip(means[:, 0].tolist(), stds.tolist(), strict=True)), gain
