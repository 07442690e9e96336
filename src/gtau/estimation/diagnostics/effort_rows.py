"""Rows of single joints, to which a column of effort is fitted under any meaning of it.

A joint's rows are its equations in the middle of the runs, with columns of their own for each payload: so neither gains
nor the other joints matter. Gravity's part of a column is what the regressor has at rest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gtau.estimation.diagnostics.linearisation import window_motion
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.factors import triangle
from gtau.estimation.regression.rows import Rows, stream_rows
from gtau.robots.robot import INERTIAL
from gtau.signals.preparation.prepared_run import SampleWindow

REACH = 0.3  # s: lags beyond are other runs, or clocks that were never set
COARSE, FINE = 2, 16  # lags tried in the longest delay that the model describes, everywhere and about the best
RANK = 1e-8  # of the largest singular value: directions below it are left out
INDEPENDENT = 0.99  # largest autocorrelation that is believed


@dataclass(frozen=True, eq=False)
class JointRows:
    """The K rows of the joint ``index``.

    ``own`` (K, p) are its columns, ``weight`` (K, p) gravity's part of them, and ``names`` (p,) their numbers among
    ``base.standard``, from ``base.count`` on for a second payload, and so on. ``effort`` (K, n) are the columns of all
    joints, its own at the first of the ``lags`` (s): that which fits best of those which a delay of the model
    describes. ``shifted`` (K,) is its own at the second, which fits best of all. ``free`` are the rows without payload.
    """

    index: int
    own: np.ndarray
    weight: np.ndarray
    names: np.ndarray
    effort: np.ndarray
    lags: tuple[float, float]
    shifted: np.ndarray
    free: np.ndarray

    @cached_property
    def basis(self) -> np.ndarray:
        """Orthonormal basis of its columns (K, r)."""
        return basis_of(self.own)

    @property
    def mine(self) -> np.ndarray:
        """Its own column of effort, (K,)."""
        return np.asarray(self.effort[:, self.index])

    @property
    def independent(self) -> float:
        """Number of independent rows, by the autocorrelation of the residuals."""
        rest = self.mine - self.basis @ (self.basis.T @ self.mine)
        rho = float(np.clip(rest[1:] @ rest[:-1] / max(rest @ rest, 1e-300), 0.0, INDEPENDENT))
        return max(len(rest) * (1 - rho) / (1 + rho), 1.0)

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
    windows = [_streamed(dataset, window) for _, window in dataset.windows()]
    loads = [load.name if (load := dataset.runs[run].payload) else None for run, _ in dataset.windows()]
    count = len(dataset.model.actuated) if windows else 0
    joints = [_rows(j, windows, loads, dataset, reach, slowest) for j in range(count)]
    return [] if any(len(joint.own) < 2 * joint.basis.shape[1] for joint in joints) else joints


def _streamed(dataset: Dataset, window: SampleWindow) -> tuple[Rows, np.ndarray]:
    """Stream the rows along a window, and gravity's part of their entries (entries, K)."""
    model, names = dataset.model, dataset.base.standard
    regressor, decimator = model.columns(names), dataset.preparation.at(window.run.rate).decimator
    parts = list(stream_rows(model, regressor, window, decimator))
    entries, currents, keep = (
        np.concatenate([getattr(part, name) for part in parts], axis=-1) for name in ("entries", "currents", "keep")
    )
    motion = window_motion(model, window)
    rest = replace(motion, yd=np.zeros_like(motion.yd), ydd=np.zeros_like(motion.ydd))
    falling = np.array([name.kind in INERTIAL for name in names])[regressor.columns]
    weight = decimator.apply(regressor(model.layout, rest))[:, : entries.shape[1]] * falling[:, None]
    return replace(parts[0], entries=entries, currents=currents, keep=keep), weight


def _rows(
    j: int,
    windows: Sequence[tuple[Rows, np.ndarray]],
    loads: Sequence[str | None],
    dataset: Dataset,
    reach: float,
    slowest: float,
) -> JointRows:
    """Stack the rows of a joint in all windows, with margins of ``reach`` and ``slowest`` (s) for shifts."""
    regressor, n = dataset.model.columns(dataset.base.standard), len(dataset.model.actuated)
    mine, carried = regressor.rows == j, list(dict.fromkeys(loads))
    apart = [np.eye(len(carried))[[carried.index(load)]] for load in loads]  # each payload has columns of its own
    steps = [
        dataset.preparation.at(window.run.rate).decimator.factor / window.run.rate for _, window in dataset.windows()
    ]
    kept = []
    for (rows, _), step in zip(windows, steps, strict=True):
        margin, length = int(np.ceil((reach + slowest) / step)), rows.currents.shape[2]
        inner = np.arange(length)[margin : max(length - margin, 0)]
        kept.append(inner[rows.keep[j, inner]])

    def stacked(parts: Iterable[np.ndarray]) -> np.ndarray:
        windows_of = zip(apart, parts, kept, strict=True)
        return np.concatenate([np.kron(one, part[mine][:, at].T) for one, part, at in windows_of])

    def shifted(lags: np.ndarray, column: int = j) -> np.ndarray:
        """Compute a column of effort at the joint's rows ``lags`` later (K, lags)."""
        parts = []
        for (rows, _), at, step in zip(windows, kept, steps, strict=True):
            steps_late = np.round(lags / step).astype(int)
            rest = (lags - steps_late * step)[:, None]
            v, v_d, v_dd = rows.currents[:, column][:, at + steps_late[:, None]]
            parts.append((v + rest * v_d + rest**2 / 2 * v_dd).T)
        return np.concatenate(parts)

    own = stacked(rows.entries for rows, _ in windows)
    basis = basis_of(own)
    lags = _lags(lambda lags: unexplained(basis, shifted(lags)), reach, slowest)
    both = shifted(np.array(lags))
    return JointRows(
        j,
        own,
        stacked(weight for _, weight in windows),
        np.concatenate([regressor.columns[mine] + k * dataset.base.count for k in range(len(carried))]),
        np.column_stack([both[:, 0] if k == j else shifted(np.zeros(1), k)[:, 0] for k in range(n)]),
        lags,
        both[:, 1],
        np.concatenate([np.full(len(at), load is None) for at, load in zip(kept, loads, strict=True)]),
    )


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


def triangles(joints: list[JointRows]) -> list[np.ndarray]:
    """Reduce the rows of each joint to a triangle: its own columns, gravity's part of them, and all efforts."""
    return [triangle(np.hstack([joint.own, joint.weight, joint.effort])) for joint in joints]
