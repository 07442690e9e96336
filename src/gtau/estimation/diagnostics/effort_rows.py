"""Rows of single joints, to which a column of effort is fitted under any meaning of it.

A joint's rows are its equations in the middle of the runs, with columns of their own for each payload: so neither gains
nor the other joints matter. Gravity's part of a column is what the regressor has at rest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from gtau.estimation.diagnostics.linearisation import window_motion
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.equations import triangle
from gtau.estimation.regression.rows import stream_rows
from gtau.robots.robot import INERTIAL

REACH = 0.3  # s: lags beyond are other runs, or clocks that were never set
COARSE, FINE = 2, 16  # lags tried in the longest delay that the model describes, everywhere and about the best
RANK = 1e-8  # of the largest singular value: directions below it are left out
INDEPENDENT = 0.99  # largest autocorrelation that is believed


@dataclass(frozen=True, eq=False)
class _Window:
    """Rows of a window, with margins for shifts: ``currents`` (3, c, K) with derivatives, every ``step`` (s).

    Of each joint the rows ``kept`` and its columns there, (., p), and gravity's part of them; ``load`` is its payload.
    """

    currents: np.ndarray
    step: float
    kept: list[np.ndarray]
    columns: list[np.ndarray]
    weight: list[np.ndarray]
    load: str | None


@dataclass(frozen=True, eq=False)
class JointRows:
    """The K rows of the joint ``index``.

    ``own`` (K, p) are its columns, ``weight`` (K, p) gravity's part of them, and ``names`` (p,) their numbers among
    ``base.standard``, from ``base.count`` on for a second payload, and so on; ``basis`` is an orthonormal one.
    ``effort`` (K, n) are the columns of all joints, its own at the first of the ``lags`` (s): that which fits best of
    those which a delay of the model describes. ``shifted`` (K,) is its own at the second, which fits best of all.
    ``free`` are the rows without payload and ``independent`` their number, by the autocorrelation of the residuals.
    """

    index: int
    own: np.ndarray
    weight: np.ndarray
    names: np.ndarray
    basis: np.ndarray
    effort: np.ndarray
    lags: tuple[float, float]
    shifted: np.ndarray
    free: np.ndarray
    independent: float

    @property
    def mine(self) -> np.ndarray:
        """Its own column of effort, (K,)."""
        return np.asarray(self.effort[:, self.index])

    def left(self, effort: np.ndarray) -> np.ndarray:
        """Compute the shares of columns (K, m), or of one, that the equations leave, rms."""
        return unexplained(self.basis, effort)


def unexplained(basis: np.ndarray, effort: np.ndarray) -> np.ndarray:
    """Compute the shares of columns (K, m), or of one (K,), beside an orthonormal ``basis``, rms."""
    rest = effort - basis @ (basis.T @ effort)
    return np.asarray(np.linalg.norm(rest, axis=0) / np.maximum(np.linalg.norm(effort, axis=0), 1e-300))


def basis_of(columns: np.ndarray) -> np.ndarray:
    """Make an orthonormal basis of columns (K, p)."""
    from scipy.linalg import orth

    norms = np.linalg.norm(columns, axis=0)
    return np.asarray(orth(columns[:, norms > 0] / norms[norms > 0], rcond=RANK))


def joint_rows(dataset: Dataset, slowest: float) -> list[JointRows]:
    """List the rows of all joints; none where a joint has as many parameters as half its rows, which explain anything.

    ``slowest`` is the longest delay that the model describes, s; where it is 0 no lag is tried.
    """
    reach = max(REACH, 2 * slowest) if slowest else 0.0
    windows = list(_windows(dataset, reach + slowest))
    loads = list(dict.fromkeys(window.load for window in windows))
    found = [
        _rows(j, windows, loads, dataset, reach, slowest) for j in range(len(dataset.model.actuated) * bool(windows))
    ]
    return [] if any(len(each.own) < 2 * each.basis.shape[1] for each in found) else found


def _rows(
    j: int, windows: list[_Window], loads: list[str | None], dataset: Dataset, reach: float, slowest: float
) -> JointRows:
    def stacked(parts: list[np.ndarray]) -> np.ndarray:
        apart = [np.eye(len(loads))[[loads.index(window.load)]] for window in windows]
        return np.concatenate([np.kron(one, part) for one, part in zip(apart, parts, strict=True)])

    regressor, n = dataset.model.columns(dataset.base.standard), len(dataset.model.actuated)
    own, weight = stacked([each.columns[j] for each in windows]), stacked([each.weight[j] for each in windows])
    names = regressor.columns[regressor.rows == j]
    basis = basis_of(own)

    def shifted(lags: np.ndarray, column: int = j) -> np.ndarray:
        return np.concatenate([_shifted(each, j, column, lags) for each in windows])

    lags = _lags(lambda lags: unexplained(basis, shifted(lags)), reach, slowest)
    both = shifted(np.array(lags))
    effort = np.column_stack([shifted(np.zeros(1), k)[:, 0] if k != j else both[:, 0] for k in range(n)])
    rest = both[:, 0] - basis @ (basis.T @ both[:, 0])
    rho = float(np.clip(rest[1:] @ rest[:-1] / max(rest @ rest, 1e-300), 0.0, INDEPENDENT))
    return JointRows(
        j,
        own,
        weight,
        np.concatenate([names + k * dataset.base.count for k in range(len(loads))]),
        basis,
        effort,
        lags,
        both[:, 1],
        np.concatenate([np.full(len(each.kept[j]), each.load is None) for each in windows]),
        max(len(own) * (1 - rho) / (1 + rho), 1.0),
    )


def _shifted(window: _Window, joint: int, column: int, lags: np.ndarray) -> np.ndarray:
    """Compute the currents of a ``column`` at a joint's rows ``lags`` later (rows, lags)."""
    steps = np.round(lags / window.step).astype(int)
    rest = (lags - steps * window.step)[:, None]
    v, v_d, v_dd = window.currents[:, column][:, window.kept[joint] + steps[:, None]]
    return np.asarray((v + rest * v_d + rest**2 / 2 * v_dd).T)


def _lags(left: Callable[[np.ndarray], np.ndarray], reach: float, slowest: float) -> tuple[float, float]:
    """Find the lags that leave least: of those that a delay of the model describes, and of all."""
    if not slowest:
        return 0.0, 0.0
    coarse = slowest / COARSE * np.arange(-round(COARSE * reach / slowest), round(COARSE * reach / slowest) + 1)
    shares = left(coarse)
    longest = slowest * (1 + 1e-9)  # and rounding
    within = np.flatnonzero(np.abs(coarse) <= longest)
    stated, k = float(coarse[within[np.argmin(shares[within])]]), int(np.argmin(shares))
    if k in within or not 0 < k < len(coarse) - 1:
        return stated, stated
    fine = coarse[k] + slowest / FINE * np.arange(-FINE // COARSE, FINE // COARSE + 1)
    shares = left(fine)
    k = int(np.argmin(shares))
    a, b, c = np.take(shares, [k - 1, k, k + 1], mode="clip") ** 2
    between = (a - c) / (2 * (a - 2 * b + c)) if min(a, c) > b else 0.0
    return stated, float(fine[k] + slowest / FINE * between)


def _windows(dataset: Dataset, reach: float) -> Iterator[_Window]:
    """Iterate over the middle of the runs, with currents available up to ``reach`` (s) before and after."""
    model, names = dataset.model, dataset.base.standard
    joints, regressor = range(len(model.actuated)), model.columns(names)
    falling = np.array([name.kind in INERTIAL for name in names])[regressor.columns]
    for run, piece in dataset.windows():
        decimator = dataset.preparation.at(piece.run.rate).decimator
        parts = list(stream_rows(model, regressor, piece, decimator))
        currents, entries = (
            np.concatenate(each, axis=-1) for each in zip(*((p.currents, p.entries) for p in parts), strict=True)
        )
        motion = window_motion(model, piece)
        rest = replace(motion, yd=np.zeros_like(motion.yd), ydd=np.zeros_like(motion.ydd))
        weight = decimator.apply(regressor(model.layout, rest))[:, : entries.shape[1]] * falling[:, None]
        step = decimator.factor / piece.run.rate
        margin = int(np.ceil(reach / step))
        inner = slice(margin, max(currents.shape[2] - margin, 0))
        keep = np.concatenate([part.keep for part in parts], axis=1)
        kept = [np.arange(currents.shape[2])[inner][keep[j, inner]] for j in joints]
        columns, falls = ([each[regressor.rows == j][:, kept[j]].T for j in joints] for each in (entries, weight))
        load = dataset.runs[run].payload
        yield _Window(currents, step, kept, columns, falls, None if load is None else load.name)


def triangles(joints: list[JointRows]) -> list[np.ndarray]:
    """Reduce the rows of each joint to a triangle: its own columns, gravity's part of them, and all efforts."""
    return [triangle(np.hstack([each.own, each.weight, each.effort])) for each in joints]
