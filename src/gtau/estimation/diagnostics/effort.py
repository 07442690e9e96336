"""Find what the columns of effort hold: what is stated, or what explains the same rows better.

A joint's rows are its equations in the middle of the runs, with columns of their own for each payload: so neither gains
nor the other joints matter. Columns that are late, permuted or without signs are altered, and gravity is left out of
the equations; never the rows, nor the freedom of the parameters. What is left of each joint's column gives the
likelihood of a description, Gaussian with a variance for each joint, less half the logarithm of the rows for each
number that it chooses (BIC); rows count by the autocorrelation of their residuals. Where a quarter of every column is
likelier still, none of these explains it.

Single torques that are reversed show beside the others: :mod:`gtau.estimation.diagnostics.descriptions`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from gtau.estimation.diagnostics.gravity import WITHOUT_GRAVITY
from gtau.estimation.diagnostics.verdict import WRENCHES, contradiction
from gtau.estimation.effects.rows import least_squares_step
from gtau.estimation.estimators.maximum_likelihood import MISFIT
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.factors import triangle
from gtau.estimation.regression.rows import stream_rows
from gtau.findings import Finding, listed
from gtau.robots.robot import DRIVE, INERTIAL
from gtau.signals.preparation.prepared_run import SampleWindow

LATE = 0.5  # unexplained share of a joint's current, shifted by more than a delay can be, over that as logged
LATE_STEADY = 0.6  # unexplained share of the shifted current over the share that terms without acceleration leave
GRAVITY_MISFIT = 0.1  # unexplained share of a joint's signal, from which gravity along other axes is tried
RETRIED = 2.0  # share that common parameters leave over what a joint's own leave, from which exchanges are tried
SWAPPED = 0.5  # unexplained share with the other joint's current over that with its own
HARDLY_NEGATIVE = 0.05  # most negative value over the largest of a column of magnitudes behind a filter
LESS_GRAVITY = 0.5  # share of gravity with which rows are less likely than without, where torques have none
MEANING_CLOSE = 3.0  # log likelihood by which torques are likelier without gravity, up to which they are not called so
AS_WELL = 1.1  # residual variance without gravity over with it, up to which compensation explains torques as well
TINY = 1e-9  # share of a torque or a delay that is rounding

AS_STATED, NONE = "as stated", "none of these"
LATE_CURRENTS, SWAPPED_CHANNELS, MAGNITUDES = "currents logged late", "swapped channels", "magnitudes"
INDEPENDENT = 0.99  # largest autocorrelation that is believed
REACH = 0.3  # s: lags beyond are other runs, or clocks that were never set
COARSE = 2  # lags tried in the longest delay that the model describes
RANK = 1e-8  # of the largest singular value: directions below it are left out
REWEIGHTED = 3  # steps that find the variances of joints with common parameters


@dataclass(frozen=True, eq=False)
class JointRows:
    """The K rows of a joint.

    ``columns`` (K, p) are its own, ``weight`` (K, p) gravity's part of them, ``steady`` (K, p) that part with friction
    and offsets, and ``names`` (p,) their numbers among ``base.standard``, from ``base.count`` on for a second payload,
    and so on. ``effort`` (K, n + 1) are the columns of all joints, its own as the delay of the model shifts it that
    fits best, and its own again, shifted by the ``lag`` (s) that fits best of all: None where it is such a delay.
    """

    columns: np.ndarray
    weight: np.ndarray
    steady: np.ndarray
    names: np.ndarray
    effort: np.ndarray
    lag: float | None

    @cached_property
    def basis(self) -> np.ndarray:
        """Orthonormal basis of its columns (K, r)."""
        return basis_of(self.columns)


def basis_of(columns: np.ndarray) -> np.ndarray:
    """Make an orthonormal basis of columns (K, p)."""
    from scipy.linalg import orth

    norms = np.linalg.norm(columns, axis=0)
    return np.asarray(orth(columns[:, norms > 0] / norms[norms > 0], rcond=RANK))


def unexplained(basis: np.ndarray, effort: np.ndarray) -> np.ndarray:
    """Compute the rms share of columns (K, m), or of one (K,), beside an orthonormal ``basis``."""
    rest = np.linalg.norm(effort - basis @ (basis.T @ effort), axis=0)
    return np.asarray(rest / np.maximum(np.linalg.norm(effort, axis=0), 1e-300))


Reading = tuple[str, np.ndarray, np.ndarray, list[int], int]
"""How columns are read: what is left of all with it and before (n,), the joints altered, and numbers chosen."""


def effort_of(dataset: Dataset, slowest: float) -> tuple[str, tuple[Finding, ...], bool]:
    """Find what the columns of effort hold; as stated where there are too few rows.

    ``slowest`` is the longest delay that the model describes, s; where it is 0 no other is tried. Returns the likeliest
    description, findings on the joints whose columns hold something else than stated, and whether the rows fit as well
    without gravity.
    """
    joints = joint_rows(dataset, slowest)
    if not joints:
        return AS_STATED, (), False
    shares = np.array([unexplained(joint.basis, joint.effort) for joint in joints])  # (n, n + 1)
    logged = np.diag(shares)
    counts = np.array([_independent(joint, j) for j, joint in enumerate(joints)])
    rows, wrenches = float(counts.sum()), _wrenches(dataset)

    def likelier(after: np.ndarray, before: np.ndarray = logged) -> float:
        """Compute the log-likelihood over the columns as stated."""
        return float(counts @ np.log(np.maximum(before, TINY) / np.maximum(after, TINY)))

    none = likelier(np.full(len(logged), MISFIT))
    readings = [*_late(joints, shares), *_permuted(shares, counts), *_magnitudes(joints, logged)]
    if none < 0 and dataset.runs[0].kind == "torque" and not wrenches:
        readings += _exchanged(joints, logged)
    tried: list[tuple[float, str, tuple[Finding, ...]]] = [(0.0, AS_STATED, ()), (none, NONE, ())]
    for kind, after, before, altered, chosen in readings:
        findings = tuple(_said(kind, after, before, altered, joints, counts, dataset))
        tried.append((likelier(after, before) - chosen / 2 * np.log(rows), kind, findings))
    without, less = (likelier(_with_gravity(joints, share)) for share in (0.0, LESS_GRAVITY))
    if not wrenches and without > max(less, MEANING_CLOSE):
        tried.append((without, WITHOUT_GRAVITY, ()))
    _, kind, findings = max(tried, key=lambda reading: reading[0])
    return kind, findings, without > -rows / 2 * np.log(AS_WELL)


def _independent(joint: JointRows, j: int) -> float:
    """Count the independent rows of joint ``j`` by the autocorrelation of their residuals."""
    effort = joint.effort[:, j]
    rest = effort - joint.basis @ (joint.basis.T @ effort)
    rho = float(np.clip(rest[1:] @ rest[:-1] / max(rest @ rest, 1e-300), 0.0, INDEPENDENT))
    return max(len(rest) * (1 - rho) / (1 + rho), 1.0)


def _late(joints: Sequence[JointRows], shares: np.ndarray) -> Iterator[Reading]:
    """Shift the columns that fit much better at a lag, of either sign, than at any delay that the model describes.

    Acceleration shows the lag: without it friction, stops and the controller look like one.
    """
    logged, shifted = np.diag(shares), shares[:, -1]
    steady = np.array([unexplained(basis_of(joint.steady), joint.effort[:, -1]) for joint in joints])
    lagging = np.array([joint.lag is not None for joint in joints])
    late = lagging & (shifted < LATE * logged) & (shifted < LATE_STEADY * steady)
    altered = np.flatnonzero(late).tolist()
    if altered:
        yield LATE_CURRENTS, np.where(late, shifted, logged), logged, altered, len(altered)


def _permuted(shares: np.ndarray, counts: np.ndarray) -> Iterator[Reading]:
    """Assign each joint the column that fits its equations best, every column once."""
    from scipy.optimize import linear_sum_assignment

    joints, order = linear_sum_assignment(counts[:, None] * np.log(np.maximum(shares[:, :-1], TINY)))
    altered = np.flatnonzero(order != joints)
    assigned = shares[joints, order]
    logged = np.diag(shares)
    if len(altered) and np.all((assigned < SWAPPED * logged)[altered]):
        yield SWAPPED_CHANNELS, assigned, logged, altered.tolist(), 0


def _magnitudes(joints: Sequence[JointRows], logged: np.ndarray) -> Iterator[Reading]:
    """Give columns without negative values the signs with which the equations explain most of them."""
    after = logged.copy()
    for j, joint in enumerate(joints):
        effort = joint.effort[:, j]
        if effort.size and effort.min() > -HARDLY_NEGATIVE * effort.max():
            after[j] = unexplained(joint.basis, _signed(joint.basis, effort))
    altered = np.flatnonzero(after < SWAPPED * logged).tolist()
    if altered:
        yield MAGNITUDES, after, logged, altered, len(altered)


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


def _exchanged(joints: Sequence[JointRows], logged: np.ndarray) -> Iterator[Reading]:
    """Exchange two columns, of joints that move alike, so that the parameters which joints share explain them together.

    So the second and third of a TX40, whose own parameters explain either column.
    """
    factors = [triangle(np.hstack([joint.columns, joint.effort])) for joint in joints]
    order = np.arange(len(joints))
    before = _fitted_together(joints, factors, order)
    wrong = before > np.maximum(RETRIED * logged, GRAVITY_MISFIT)
    for pair in map(list, combinations(range(len(joints)), 2)):
        if wrong[pair].any():
            exchanged = order.copy()
            exchanged[pair] = pair[::-1]
            after = _fitted_together(joints, factors, exchanged)
            if np.all((after < SWAPPED * before)[pair]):
                yield SWAPPED_CHANNELS, after, before, pair, 0


def _fitted_together(joints: Sequence[JointRows], factors: Sequence[np.ndarray], order: np.ndarray) -> np.ndarray:
    """Fit the columns, in some ``order``, by common parameters: the shares that they leave (n,)."""
    size = 1 + max(int(joint.names.max()) for joint in joints)
    rows, efforts = [], []
    for joint, R, column in zip(joints, factors, order, strict=True):
        p = len(joint.names)
        rows.append(np.zeros((len(R), size)))
        rows[-1][:, joint.names] = R[:, :p]
        efforts.append(R[:, p + column])
    norms = np.array([max(float(np.linalg.norm(effort)), 1e-300) for effort in efforts])
    shares = np.ones(len(joints))
    for _ in range(REWEIGHTED):
        weights = 1 / (norms * np.maximum(shares, TINY))
        J, e = (np.concatenate([w * part for w, part in zip(weights, parts, strict=True)]) for parts in (rows, efforts))
        theta = least_squares_step(J, -e)
        shares = np.array([np.linalg.norm(v - A @ theta) for v, A in zip(efforts, rows, strict=True)]) / norms
    return shares


def _with_gravity(joints: Sequence[JointRows], share: float) -> np.ndarray:
    """Fit the columns with a ``share`` of gravity, relative to inertia: the shares that they leave (n,)."""
    columns = (joint.columns - (1 - share) * joint.weight for joint in joints)
    efforts = (joint.effort[:, j] for j, joint in enumerate(joints))
    return np.array([unexplained(basis_of(W), effort) for W, effort in zip(columns, efforts, strict=True)])


def _said(
    held: str,
    after: np.ndarray,
    before: np.ndarray,
    altered: list[int],
    joints: Sequence[JointRows],
    counts: np.ndarray,
    dataset: Dataset,
) -> Iterator[Finding]:
    """Say what columns hold that are read otherwise, and by how much that leaves less."""
    signal, names = dataset.runs[0].kind, tuple(dataset.model.actuated[j] for j in altered)
    if held == LATE_CURRENTS:
        for j, name in zip(altered, names, strict=True):
            lag = joints[j].lag or 0.0
            text = (
                f"the {signal}s were logged {abs(1000 * lag):.0f} ms too {'late' if lag > 0 else 'early'}: "
                f"{100 * after[j]:.2g} % is unexplained after shifting them, {100 * before[j]:.2g} % as logged"
            )
            advice = (
                "log them with the time stamps of the positions, or if all joints are equally late, write "
                f"'preparation: {{delay: {lag:.3g}}}'"
            )
            yield contradiction(LATE_CURRENTS, (name,), text, advice, size=float(before[j]))
        return
    # means as the likelihood weighs them, so that what is likelier leaves less
    after_share, before_share = (
        float(np.exp(np.average(np.log(np.maximum(shares[altered], TINY)), weights=counts[altered])))
        for shares in (after, before)
    )
    kind, how, read = MAGNITUDES, "like magnitudes", "with signs that fit the motion"
    advice = "log signed values (some drives store the sign in a separate bit or column)"
    if held == SWAPPED_CHANNELS:
        kind, read = SWAPPED_CHANNELS, "after exchanging them"
        how = "swapped" if len(names) == 2 else "permuted"
        advice = f"check that the position and {signal} columns are of the same joint in all runs"
        if _wrenches(dataset):  # wrong wrenches make single currents look wrong
            advice = f"{WRENCHES}; otherwise {advice}"
    text = (
        f"the {signal}s of {listed(names)} look {how}: {100 * after_share:.2g} % is unexplained {read}, "
        f"{100 * before_share:.2g} % as logged"
    )
    yield contradiction(kind, names, text, advice, size=1 - after_share / before_share)


def _wrenches(dataset: Dataset) -> bool:
    return bool(dataset.robot.floating) or any(run.wrenches for run in dataset.runs)


def joint_rows(dataset: Dataset, slowest: float) -> list[JointRows]:
    """List the rows of all joints; none where a joint has as many parameters as half its rows, which explain anything.

    ``slowest`` is the longest delay that the model describes, s; where it is 0 no lag is tried.
    """
    windows = dataset.windows()
    if not windows:
        return []
    payloads = [dataset.runs[run].payload for run, _ in windows]
    loads = [payload and payload.name for payload in payloads]
    names = sorted(dict.fromkeys(loads), key=lambda name: name is not None)
    loaded = np.eye(len(names))[[names.index(load) for load in loads]]
    streamed = [_streamed(dataset, window) for _, window in windows]
    steps = [dataset.preparation.at(window.run.rate).decimator.factor / window.run.rate for _, window in windows]
    joints = [_rows(j, dataset, streamed, loaded, steps, slowest) for j in range(len(dataset.model.actuated))]
    return [] if any(len(joint.columns) < 2 * joint.basis.shape[1] for joint in joints) else joints


Streamed = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Entries of the regressor and gravity's part of them (2, entries, K), currents (3, c, K), and the rows kept (c, K)."""


def _streamed(dataset: Dataset, window: SampleWindow) -> Streamed:
    """Stream the rows along a window."""
    model, names = dataset.model, dataset.base.standard
    regressor, decimator = model.columns(names), dataset.preparation.at(window.run.rate).decimator
    falling = np.array([name.kind in INERTIAL for name in names])[regressor.columns, None]
    entries, currents, keep = [], [], []
    for part in stream_rows(model, regressor, window, decimator):
        still = np.zeros_like(part.motion.yd)
        rest = regressor(model.layout, replace(part.motion, yd=still, ydd=still))
        entries.append(np.stack([part.entries, rest[: len(part.entries)] * falling]))
        currents.append(part.currents)
        keep.append(part.keep)
    return np.concatenate(entries, axis=-1), np.concatenate(currents, axis=-1), np.concatenate(keep, axis=-1)


def _rows(
    j: int, dataset: Dataset, windows: list[Streamed], loaded: np.ndarray, steps: list[float], slowest: float
) -> JointRows:
    """Stack the rows of joint ``j`` in all windows, of ``steps`` (s), with margins for shifts.

    ``loaded`` (windows, loads) marks the payload of each, which has columns of its own.
    """
    base, n = dataset.base, len(dataset.model.actuated)
    regressor = dataset.model.columns(base.standard)
    mine = regressor.rows == j
    reach = max(REACH, 2 * slowest) if slowest else 0.0
    rows = []
    for (_, currents, keep), step in zip(windows, steps, strict=True):
        margin, length = int(np.ceil((reach + slowest) / step)), currents.shape[2]
        inner = np.arange(length)[margin : max(length - margin, 0)]
        rows.append(inner[keep[j, inner]])

    def shifted(lag: float, column: int = j) -> np.ndarray:
        """Compute a column of effort at the joint's rows ``lag`` later (K,)."""
        parts = []
        for (_, currents, _), kept, step in zip(windows, rows, steps, strict=True):
            late = round(lag / step)
            rest = lag - late * step
            v, v_d, v_dd = currents[:, column, kept + late]
            parts.append(v + rest * v_d + rest**2 / 2 * v_dd)
        return np.concatenate(parts)

    parts = zip(windows, rows, loaded, strict=True)
    stacked = [np.kron(load, entries[:, mine][..., kept].swapaxes(1, 2)) for (entries, *_), kept, load in parts]
    columns, weight = np.concatenate(stacked, axis=1)
    stated, lag = _lags(columns, shifted, reach, slowest) if slowest else (0.0, 0.0)
    rubbing = [base.standard[column].kind in DRIVE[1:] for column in regressor.columns[mine]]
    efforts = [shifted(stated if k == j else 0.0, k) for k in range(n)]
    return JointRows(
        columns,
        weight,
        weight + columns * np.tile(rubbing, loaded.shape[1]),
        np.concatenate([regressor.columns[mine] + k * base.count for k in range(loaded.shape[1])]),
        np.column_stack([*efforts, shifted(lag)]),
        None if lag == stated else lag,
    )


def _lags(
    columns: np.ndarray, shifted: Callable[[float], np.ndarray], reach: float, slowest: float
) -> tuple[float, float]:
    """Find the lags that leave least: of those that a delay of the model describes, and of all."""
    from scipy.optimize import minimize_scalar

    basis, most = basis_of(columns), round(COARSE * reach / slowest)
    coarse = slowest / COARSE * np.arange(-most, most + 1)
    shares = unexplained(basis, np.column_stack([shifted(lag) for lag in coarse]))
    longest = slowest * (1 + TINY)  # and rounding
    within = np.abs(coarse) <= longest
    stated, k = float(coarse[np.argmin(np.where(within, shares, np.inf))]), int(np.argmin(shares))
    if within[k] or not 0 < k < len(coarse) - 1:
        return stated, stated
    best = minimize_scalar(
        lambda lag: unexplained(basis, shifted(lag)), bounds=(coarse[k - 1], coarse[k + 1]), method="bounded"
    )
    return stated, float(best.x)
