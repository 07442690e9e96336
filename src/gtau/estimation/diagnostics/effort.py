"""Find what the columns of effort hold: what is stated, or what explains the same rows better.

Columns that are late, permuted or without signs are altered, and gravity is left out of the equations; never the rows,
nor the freedom of the parameters. What is left of each joint's column gives the likelihood of a description, Gaussian
with a variance for each joint, less half the logarithm of the rows for each number that it chooses (BIC); rows count by
the autocorrelation of their residuals. Where a quarter of every column is likelier still, none of these explains it.

Gravity is missing only where its coefficient, relative to the coefficient of inertia, is 0 and not 1; where the robot's
file states inertias, so is the coefficient of the file's gravity. Otherwise another scale, or another direction,
explains the log. Single torques that are reversed show beside the others:
:mod:`gtau.estimation.diagnostics.other_columns`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from gtau.estimation.diagnostics.effort_rows import (
    TINY,
    JointRows,
    basis_of,
    beside,
    by_file,
    fitted_together,
    joint_rows,
    signed,
    unexplained,
    with_gravity,
)
from gtau.estimation.diagnostics.other_gravity import WITHOUT_GRAVITY
from gtau.estimation.diagnostics.verdict import WRENCHES, contradiction
from gtau.estimation.estimators.maximum_likelihood import MISFIT
from gtau.estimation.regression.dataset import Dataset
from gtau.findings import Finding
from gtau.findings.words import listed

LATE = 0.5  # unexplained share of a joint's current, shifted by more than a delay can be, over that as logged
LATE_STEADY = 0.6  # unexplained share of the shifted current over the share that terms without acceleration leave
GRAVITY_MISFIT = 0.1  # unexplained share of a joint's signal, from which gravity along other axes is tried
RETRIED = 2.0  # share that common parameters leave over what a joint's own leave, from which exchanges are tried
SWAPPED = 0.5  # unexplained share with the other joint's current over that with its own
LIKELY_SHARES = 1.92  # log likelihood below the largest that bounds a 95 % interval of one unknown
SIGN_STD = 2.0  # size of a coefficient in standard deviations, above which it has a sign
HARDLY_NEGATIVE = 0.05  # most negative value over the largest of a column of magnitudes behind a filter
NO_GRAVITY = 0.1  # coefficient of gravity beside inertia, down to which its interval reaches if torques may have none
WITH_GRAVITY = 0.75  # coefficient of gravity that the interval excludes if torques have none
MEANING_CLOSE = 3.0  # log likelihood by which torques are likelier without gravity, up to which they are not called so
AS_WELL = 1.1  # residual variance without gravity over with it, up to which compensation explains torques as well

AS_STATED, NONE = "as stated", "none of these"
LATE_CURRENTS, SWAPPED_CHANNELS, MAGNITUDES = "currents logged late", "swapped channels", "magnitudes"
REVERSED_CHANNELS = "reversed channels"
SHARES = (0.0, 0.1, 0.2, 0.35, 0.5, 0.7, 0.85, 1.0, 1.2, 1.5, 2.0, 3.0)  # of gravity that are tried
INDEPENDENT = 0.99  # largest autocorrelation that is believed


@dataclass(frozen=True)
class Effort:
    """What the columns of effort hold.

    Attributes
    ----------
    kind : str
        The likeliest description of them.
    findings : tuple of Finding
        On the joints whose columns hold something else than stated.
    gravity : tuple of float, optional
        95 % interval of the coefficient of gravity, relative to inertia; None where there are too few rows.
    gravity_open : bool
        Whether the rows fit without gravity as well as with it, and no inertias of the robot's file decide.
    scale : tuple of float, optional
        Coefficient of the torques by the file's inertias, with its standard deviation; None without them.
    """

    kind: str = AS_STATED
    findings: tuple[Finding, ...] = ()
    gravity: tuple[float, float] | None = None
    gravity_open: bool = False
    scale: tuple[float, float] | None = None


@dataclass(frozen=True)
class Altered:
    """Columns of the joints ``altered`` read otherwise: what is left of all ``after`` that and was ``before`` (n,).

    ``chosen`` is how many numbers that chooses.
    """

    kind: str
    after: np.ndarray
    before: np.ndarray
    altered: list[int]
    chosen: int = 0


def effort_of(dataset: Dataset, slowest: float) -> Effort:
    """Find what the columns of effort hold; as stated where there are too few rows.

    ``slowest`` is the longest delay that the model describes, s; where it is 0 no other is tried.
    """
    joints = joint_rows(dataset, slowest)
    if not joints:
        return Effort()
    shares = np.array([joint.shares_of(joint.effort) for joint in joints])  # (n, n + 1)
    logged, counts = np.diag(shares), np.array([_independent(joint, j) for j, joint in enumerate(joints)])
    rows = float(counts.sum())

    def gain(after: np.ndarray, before: np.ndarray = logged) -> float:
        """Compute the log-likelihood over the columns as stated."""
        return float(counts @ np.log(np.maximum(before, TINY) / np.maximum(after, TINY)))

    none = gain(np.full(len(logged), MISFIT))
    tried: list[tuple[float, str, tuple[Finding, ...]]] = [(0.0, AS_STATED, ()), (none, NONE, ())]
    torques = not _wrenches(dataset) and dataset.runs[0].kind == "torque"
    others = [*_late(joints, shares), *_permuted(shares, counts), *_magnitudes(joints, logged)]
    others += _exchanged(joints, logged) if torques and none < 0 else ()
    for other in others:
        findings = _altered_findings(other, joints, counts, dataset)
        tried.append((gain(other.after, other.before) - other.chosen / 2 * np.log(rows), other.kind, findings))
    gains = np.array([gain(with_gravity(joints, share)) for share in SHARES])
    held = np.array(SHARES)[gains > gains.max() - LIKELY_SHARES]
    low, high = float(held.min()), float(held.max())
    as_well = bool(gains[0] > -rows / 2 * np.log(AS_WELL))
    by_inertias = by_file(joints, counts, dataset) if torques else None
    scale, without, missing = None, float(gains[0]), low <= NO_GRAVITY and high < WITH_GRAVITY
    if by_inertias is not None:
        (coefficient, std), scale, without = by_inertias
        near = max(abs(coefficient) - SIGN_STD * std, 0.0)  # a reversed column has gravity too
        missing = as_well and near < NO_GRAVITY and abs(coefficient) + SIGN_STD * std < WITH_GRAVITY
        if (turned := scale[0] / scale[1]) < -SIGN_STD:  # of the coefficient, at its size with either sign
            names, command = dataset.model.actuated, dataset.runs[0].kind
            text = (
                f"the {command}s of {listed(names)} look reversed: the inertias of the robot file contradict their sign"
            )
            advice = f"check the signs of the {command} and position columns"
            opposite = contradiction(REVERSED_CHANNELS, names, text, advice, size=1 - float(logged.max()))
            tried.append((2 * turned**2, REVERSED_CHANNELS, (opposite,)))
    if not _wrenches(dataset) and missing and without > MEANING_CLOSE:
        tried.append((without, WITHOUT_GRAVITY, ()))
    _, kind, findings = max(tried, key=lambda reading: reading[0])
    return Effort(kind, findings, (low, high), as_well and low <= NO_GRAVITY and by_inertias is None, scale)


def _independent(joint: JointRows, j: int) -> float:
    """Count the independent rows of joint ``j`` by the autocorrelation of their residuals."""
    rest = beside(joint.basis, joint.effort[:, j])
    rho = float(np.clip(rest[1:] @ rest[:-1] / max(rest @ rest, 1e-300), 0.0, INDEPENDENT))
    return max(len(rest) * (1 - rho) / (1 + rho), 1.0)


def _late(joints: Sequence[JointRows], shares: np.ndarray) -> Iterator[Altered]:
    """Shift the columns that fit much better at a lag, of either sign, than at any delay that the model describes.

    Acceleration shows the lag: without it friction, stops and the controller look like one.
    """
    logged, shifted = np.diag(shares), shares[:, -1]
    steady = [unexplained(basis_of(joint.steady), joint.effort[:, -1]) for joint in joints]
    lagging = np.array([joint.lag is not None for joint in joints])
    late = lagging & (shifted < LATE * logged) & (shifted < LATE_STEADY * np.array(steady))
    altered = np.flatnonzero(late).tolist()
    if altered:
        yield Altered(LATE_CURRENTS, np.where(late, shifted, logged), logged, altered, len(altered))


def _permuted(shares: np.ndarray, counts: np.ndarray) -> Iterator[Altered]:
    """Assign each joint the column that fits its equations best, every column once."""
    from scipy.optimize import linear_sum_assignment

    _, order = linear_sum_assignment(counts[:, None] * np.log(np.maximum(shares[:, :-1], TINY)))
    joints, logged = np.arange(len(order)), np.diag(shares)
    altered, assigned = np.flatnonzero(order != joints), shares[joints, order]
    if len(altered) and np.all((assigned < SWAPPED * logged)[altered]):
        yield Altered(SWAPPED_CHANNELS, assigned, logged, altered.tolist())


def _magnitudes(joints: Sequence[JointRows], logged: np.ndarray) -> Iterator[Altered]:
    """Give columns without negative values the signs with which the equations explain most of them."""
    after = logged.copy()
    for j, joint in enumerate(joints):
        effort = joint.effort[:, j]
        if effort.size and effort.min() > -HARDLY_NEGATIVE * effort.max():
            after[j] = joint.shares_of(signed(joint.basis, effort))
    altered = np.flatnonzero(after < SWAPPED * logged).tolist()
    if altered:
        yield Altered(MAGNITUDES, after, logged, altered, len(altered))


def _exchanged(joints: Sequence[JointRows], logged: np.ndarray) -> Iterator[Altered]:
    """Exchange two columns, of joints that move alike, so that the parameters which joints share explain them together.

    So the second and third of a TX40, whose own parameters explain either column.
    """
    order = np.arange(len(joints))
    before = fitted_together(joints, order)
    wrong = before > np.maximum(RETRIED * logged, GRAVITY_MISFIT)
    for pair in map(list, combinations(range(len(joints)), 2)):
        if wrong[pair].any():
            exchanged = order.copy()
            exchanged[pair] = pair[::-1]
            after = fitted_together(joints, exchanged)
            if np.all((after < SWAPPED * before)[pair]):
                yield Altered(SWAPPED_CHANNELS, after, before, pair)


def _altered_findings(
    other: Altered, joints: Sequence[JointRows], counts: np.ndarray, dataset: Dataset
) -> tuple[Finding, ...]:
    """Say what columns hold that are read otherwise, and by how much that leaves less."""
    kind, altered = dataset.runs[0].kind, other.altered
    names = tuple(dataset.model.actuated[j] for j in altered)
    if other.kind == LATE_CURRENTS:
        findings = []
        for j, name in zip(altered, names, strict=True):
            lag, after, before = joints[j].lag or 0.0, other.after[j], other.before[j]
            text = (
                f"the {kind}s were logged {abs(1000 * lag):.0f} ms too {'late' if lag > 0 else 'early'}: "
                f"{100 * after:.2g} % is unexplained after shifting them, {100 * before:.2g} % as logged"
            )
            advice = (
                "log them with the time stamps of the positions, or if all joints are equally late, write "
                f"'preparation: {{delay: {lag:.3g}}}'"
            )
            findings.append(contradiction(LATE_CURRENTS, (name,), text, advice, size=float(before)))
        return tuple(findings)
    # means as the likelihood weighs them, so that what is likelier leaves less
    after, before = (
        float(np.exp(np.average(np.log(np.maximum(shares[altered], TINY)), weights=counts[altered])))
        for shares in (other.after, other.before)
    )
    if other.kind == SWAPPED_CHANNELS:
        how = "swapped" if len(names) == 2 else "permuted"
        text = (
            f"the {kind}s of {listed(names)} look {how}: {100 * after:.2g} % is unexplained after exchanging them, "
            f"{100 * before:.2g} % as logged"
        )
        advice = f"check that the position and {kind} columns are of the same joint in all runs"
        if _wrenches(dataset):  # wrong wrenches make single currents look wrong
            advice = f"{WRENCHES}; otherwise {advice}"
        return (contradiction(SWAPPED_CHANNELS, names, text, advice, size=1 - after / before),)
    text = (
        f"the {kind}s of {listed(names)} look like magnitudes: {100 * after:.2g} % is unexplained with signs that fit "
        f"the motion, {100 * before:.2g} % as logged"
    )
    advice = "log signed values (some drives store the sign in a separate bit or column)"
    return (contradiction(MAGNITUDES, names, text, advice, size=1 - after / before),)


def _wrenches(dataset: Dataset) -> bool:
    return bool(dataset.robot.floating) or any(run.wrenches for run in dataset.runs)
