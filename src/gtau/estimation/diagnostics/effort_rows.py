"""Rows of single joints, and fits of columns of effort to them.

A joint's rows are its equations in the middle of the runs, with columns of their own for each payload: so neither gains
nor the other joints matter. Gravity's part of a column is what the regressor has at rest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gtau.estimation.effects.linearisation import least_squares_step, window_motion
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.factors import triangle
from gtau.estimation.regression.priors import stated_inertias
from gtau.estimation.regression.rows import stream_rows
from gtau.model.base_parameters import belongs_to_drive
from gtau.robots.robot import DRIVE, INERTIAL
from gtau.signals.preparation.prepared_run import SampleWindow

REACH = 0.3  # s: lags beyond are other runs, or clocks that were never set
COARSE, FINE = 2, 16  # lags tried in the longest delay that the model describes, everywhere and about the best
RANK = 1e-8  # of the largest singular value: directions below it are left out
TINY = 1e-9  # share of a torque that is rounding
REWEIGHTED = 3  # steps that find the variances of joints with common parameters


@dataclass(frozen=True, eq=False)
class JointRows:
    """The K rows of a joint.

    ``columns`` (K, p) are its own, ``weight`` (K, p) gravity's part of them, ``steady`` (K, p) that part with friction
    and offsets, and ``names`` (p,) their numbers among ``base.standard``, from ``base.count`` on for a second payload,
    and so on; those without payload are first.
    ``effort`` (K, n + 1) are the columns of all joints, its own as the delay of the model shifts it that fits best, and
    its own again, shifted by the ``lag`` (s) that fits best of all: None where it is such a delay.
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

    @cached_property
    def factor(self) -> np.ndarray:
        """Triangle of its columns, gravity's part of them, and all efforts."""
        return triangle(np.hstack([self.columns, self.weight, self.effort]))

    def shares_of(self, effort: np.ndarray) -> np.ndarray:
        """Compute the shares of columns (K, m), or of one, that the equations leave, rms."""
        return unexplained(self.basis, effort)


def beside(basis: np.ndarray, effort: np.ndarray) -> np.ndarray:
    """Compute the part of columns (K, m), or of one (K,), beside an orthonormal ``basis``."""
    return np.asarray(effort - basis @ (basis.T @ effort))


def unexplained(basis: np.ndarray, effort: np.ndarray) -> np.ndarray:
    """Compute the rms share of columns (K, m), or of one (K,), beside an orthonormal ``basis``."""
    rest = np.linalg.norm(beside(basis, effort), axis=0)
    return np.asarray(rest / np.maximum(np.linalg.norm(effort, axis=0), 1e-300))


def basis_of(columns: np.ndarray) -> np.ndarray:
    """Make an orthonormal basis of columns (K, p)."""
    from scipy.linalg import orth

    norms = np.linalg.norm(columns, axis=0)
    return np.asarray(orth(columns[:, norms > 0] / norms[norms > 0], rcond=RANK))


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
    places = [names.index(load) for load in loads]
    streamed = [_streamed(dataset, window) for _, window in windows]
    steps = [dataset.preparation.at(window.run.rate).decimator.factor / window.run.rate for _, window in windows]
    joints = [
        _rows(j, dataset, streamed, np.eye(len(names))[places], steps, slowest)
        for j in range(len(dataset.model.actuated))
    ]
    return [] if any(len(joint.columns) < 2 * joint.basis.shape[1] for joint in joints) else joints


Streamed = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Entries of the regressor and gravity's part of them (2, entries, K), currents (3, c, K), and the rows kept (c, K)."""


def _streamed(dataset: Dataset, window: SampleWindow) -> Streamed:
    """Stream the rows along a window."""
    model, names = dataset.model, dataset.base.standard
    regressor, decimator = model.columns(names), dataset.preparation.at(window.run.rate).decimator
    parts = list(stream_rows(model, regressor, window, decimator))
    entries = np.concatenate([part.entries for part in parts], axis=-1)
    motion = window_motion(model, window)
    rest = replace(motion, yd=np.zeros_like(motion.yd), ydd=np.zeros_like(motion.ydd))
    falling = np.array([name.kind in INERTIAL for name in names])[regressor.columns]
    weight = decimator.apply(regressor(model.layout, rest))[:, : entries.shape[1]]
    return (
        np.stack([entries, weight * falling[:, None]]),
        np.concatenate([part.currents for part in parts], axis=-1),
        np.concatenate([part.keep for part in parts], axis=-1),
    )


def _rows(
    j: int, dataset: Dataset, windows: list[Streamed], loaded: np.ndarray, steps: list[float], slowest: float
) -> JointRows:
    """Stack the rows of joint ``j`` in all windows, of ``steps`` (s), with margins for shifts.

    ``loaded`` (windows, loads) marks the payload of each, which has columns of its own.
    """
    regressor = dataset.model.columns(dataset.base.standard)
    mine = regressor.rows == j
    reach = max(REACH, 2 * slowest) if slowest else 0.0
    rows = []
    for (_, currents, keep), step in zip(windows, steps, strict=True):
        margin, length = int(np.ceil((reach + slowest) / step)), currents.shape[2]
        inner = np.arange(length)[margin : max(length - margin, 0)]
        rows.append(inner[keep[j, inner]])

    def shifted(lags: np.ndarray, column: int = j) -> np.ndarray:
        """Compute a column of effort at the joint's rows ``lags`` later (K, lags)."""
        parts = []
        for (_, currents, _), kept, step in zip(windows, rows, steps, strict=True):
            late = np.round(lags / step).astype(int)
            rest = (lags - late * step)[:, None]
            v, v_d, v_dd = currents[:, column][:, kept + late[:, None]]
            parts.append((v + rest * v_d + rest**2 / 2 * v_dd).T)
        return np.concatenate(parts)

    parts = zip(windows, rows, loaded, strict=True)
    stacked = [np.kron(load, entries[:, mine][..., kept].swapaxes(1, 2)) for (entries, *_), kept, load in parts]
    columns, weight = np.concatenate(stacked, axis=1)
    stated, lag = _lags(columns, shifted, reach, slowest)
    n = len(dataset.model.actuated)
    rubbing = [dataset.base.standard[column].kind in DRIVE[1:] for column in regressor.columns[mine]]
    efforts = [shifted(np.array([stated if k == j else 0.0]), k) for k in range(n)]
    return JointRows(
        columns,
        weight,
        weight + columns * np.tile(rubbing, loaded.shape[1]),
        np.concatenate([regressor.columns[mine] + k * dataset.base.count for k in range(loaded.shape[1])]),
        np.hstack([*efforts, shifted(np.array([lag]))]),
        None if lag == stated else lag,
    )


def _lags(
    columns: np.ndarray, shifted: Callable[[np.ndarray], np.ndarray], reach: float, slowest: float
) -> tuple[float, float]:
    """Find the lags that leave least: of those that a delay of the model describes, and of all."""
    if not slowest:
        return 0.0, 0.0
    basis, most = basis_of(columns), round(COARSE * reach / slowest)
    coarse = slowest / COARSE * np.arange(-most, most + 1)
    shares = unexplained(basis, shifted(coarse))
    longest = slowest * (1 + 1e-9)  # and rounding
    within = np.abs(coarse) <= longest
    stated, k = float(coarse[np.argmin(np.where(within, shares, np.inf))]), int(np.argmin(shares))
    if within[k] or not 0 < k < len(coarse) - 1:
        return stated, stated
    fine = coarse[k] + slowest / FINE * np.arange(-FINE // COARSE, FINE // COARSE + 1)
    shares = unexplained(basis, shifted(fine))
    k = int(np.argmin(shares))
    a, b, c = np.take(shares, [k - 1, k, k + 1], mode="clip") ** 2
    between = (a - c) / (2 * (a - 2 * b + c)) if min(a, c) > b else 0.0
    return stated, float(fine[k] + slowest / FINE * between)


def with_gravity(joints: Sequence[JointRows], share: float) -> np.ndarray:
    """Fit the columns with a ``share`` of gravity, relative to inertia: the shares that they leave (n,)."""
    shares = []
    for j, joint in enumerate(joints):
        R, p = joint.factor, joint.columns.shape[1]
        shares.append(unexplained(basis_of(R[:, :p] - (1 - share) * R[:, p : 2 * p]), R[:, 2 * p + j]))
    return np.array(shares)


def fitted_together(joints: Sequence[JointRows], order: np.ndarray) -> np.ndarray:
    """Fit the columns, in some ``order``, by common parameters: the shares that they leave (n,)."""
    size = 1 + max(int(joint.names.max()) for joint in joints)
    rows, efforts = [], []
    for joint, column in zip(joints, order, strict=True):
        R, p = joint.factor, len(joint.names)
        rows.append(np.zeros((len(R), size)))
        rows[-1][:, joint.names] = R[:, :p]
        efforts.append(R[:, 2 * p + column])
    norms = np.array([max(float(np.linalg.norm(effort)), 1e-300) for effort in efforts])
    shares = np.ones(len(joints))
    for _ in range(REWEIGHTED):
        weights = 1 / (norms * np.maximum(shares, TINY))
        J, e = (np.concatenate([w * part for w, part in zip(weights, parts, strict=True)]) for parts in (rows, efforts))
        theta = least_squares_step(J, -e)
        shares = np.array([np.linalg.norm(v - A @ theta) for v, A in zip(efforts, rows, strict=True)]) / norms
    return shares


def signed(basis: np.ndarray, effort: np.ndarray) -> np.ndarray:
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


def by_file(
    joints: Sequence[JointRows], counts: np.ndarray, dataset: Dataset
) -> tuple[tuple[float, float], tuple[float, float], float] | None:
    """Regress the torques of the runs without payload on those that the file's inertias give, and friction.

    Returns the coefficients of the file's gravity and of its whole torque, with standard deviations, and how much more
    likely the rows are without the file's gravity than with it, a logarithm; None without inertias that show.
    """
    stated, base = stated_inertias(dataset.robot), dataset.base
    if not any(stated.values()) or all(run.payload for run in dataset.runs):
        return None
    values = base.matrix @ [stated.get(name, 0.0) for name in dataset.model.parameter_names]
    gravity_terms, torque_terms, without = [], [], 0.0
    for j, (joint, count) in enumerate(zip(joints, counts, strict=True)):
        first = joint.names < base.count  # without payload
        free = joint.columns[:, first].any(axis=1)
        names, W, effort = joint.names[first], joint.columns[free][:, first], joint.effort[free, j]
        gravity, torque = joint.weight[free][:, first] @ values[names], W @ values[names]
        driven = W[:, [belongs_to_drive(base.standard[k], dataset.model.actuated[j]) for k in names]]
        gravity_terms.append(_coefficient(effort, gravity, np.column_stack([torque - gravity, driven]), count))
        torque_terms.append(_coefficient(effort, torque, driven, count))
        without += gravity_terms[-1][-1]
    if not any(size for _, _, size, _ in gravity_terms):
        return None
    return _weighted(gravity_terms), _weighted(torque_terms), without


def _coefficient(
    effort: np.ndarray, column: np.ndarray, others: np.ndarray, count: float
) -> tuple[float, float, float, float]:
    """Regress on a column beside others: its coefficient, variance and size, and the likelihood ratio of 0 to 1."""
    basis = basis_of(others)
    x, y = beside(basis, column), beside(basis, effort)
    size = float(x @ x)
    if not size > TINY * float(column @ column):
        return 0.0, 0.0, 0.0, 0.0
    coefficient, apart = float(x @ y) / size, y - x
    rest = y - coefficient * x
    none = count / 2 * float(np.log(max(apart @ apart, 1e-300) / max(y @ y, 1e-300)))
    return coefficient, float(rest @ rest) / count / size, size, none


def _weighted(parts: Sequence[tuple[float, float, float, float]]) -> tuple[float, float]:
    """Average coefficients by the squares of their columns, (N m)^2, with the standard deviation by their scatter."""
    coefficients, variances, sizes, _ = np.array(parts).T
    weights = sizes / max(sizes.sum(), 1e-300)
    mean = float(weights @ coefficients)
    return mean, float(np.sqrt(weights**2 @ ((coefficients - mean) ** 2 + variances)))
