"""Currents with delays or advances too large for the derivative expansion of a delay."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.linalg import orth

from gtau.estimation.diagnostics.finding import Finding
from gtau.estimation.diagnostics.finding import FindingKind as F
from gtau.estimation.diagnostics.linearisation import central_windows
from gtau.estimation.regression.dataset import Dataset
from gtau.estimation.regression.rows import stream_rows
from gtau.estimation.thresholds.logs import LATE

REACH = 0.3  # s: lags beyond are other runs, or clocks that were never set
COARSE, FINE = 2, 16  # lags tried in the longest delay that the model describes, everywhere and about the best


@dataclass(frozen=True, eq=False)
class _Window:
    """Rows of a window, with margins for shifts: ``currents`` (3, n, K) with derivatives, every ``step`` (s).

    Of each joint the rows ``kept`` and its own columns there, (., k).
    """

    currents: np.ndarray
    step: float
    kept: list[np.ndarray]
    own: list[np.ndarray]

    def shifted(self, joint: int, lags: np.ndarray) -> np.ndarray:
        """Compute the currents of a joint's rows ``lags`` later (rows, lags)."""
        whole = np.round(lags / self.step).astype(int)
        rest = (lags - whole * self.step)[:, None]
        v, v_d, v_dd = self.currents[:, joint][:, self.kept[joint] + whole[:, None]]
        return np.asarray((v + rest * v_d + rest**2 / 2 * v_dd).T)


def late_currents(dataset: Dataset, slowest: float) -> tuple[Finding, ...]:
    """Find joints whose current (or torque) fits the motion only when it is shifted by more than ``slowest`` (s).

    Each joint is fitted by itself, with other parameters for each payload, at lags of either sign.
    """
    if not slowest:
        return ()
    reach = max(REACH, 2 * slowest)
    windows = list(_windows(dataset, reach + slowest))
    coarse = slowest / COARSE * np.arange(-round(COARSE * reach / slowest), round(COARSE * reach / slowest) + 1)
    found = []
    for j, joint in enumerate(dataset.model.actuated if windows else ()):
        W = np.concatenate([each.own[j] for each in windows])
        norms = np.linalg.norm(W, axis=0)
        U = orth(W / np.where(norms > 0, norms, 1.0))
        if len(W) < 2 * U.shape[1]:
            continue  # as many parameters fit any shift

        def left(lags: np.ndarray, j: int = j, U: np.ndarray = U) -> np.ndarray:
            V = np.concatenate([each.shifted(j, lags) for each in windows])
            return np.asarray(np.linalg.norm(V - U @ (U.T @ V), axis=0) / np.maximum(np.linalg.norm(V, axis=0), 1e-300))

        shares = left(coarse)
        k, as_logged = int(np.argmin(shares)), float(shares[np.abs(coarse) <= slowest].min())
        if not 0 < k < len(coarse) - 1 or shares[k] == as_logged:
            continue
        fine = coarse[k] + slowest / FINE * np.arange(-FINE // COARSE, FINE // COARSE + 1)
        shares = left(fine)
        k = int(np.argmin(shares))
        if abs(fine[k]) > slowest and shares[k] < LATE * as_logged:
            a, b, c = np.take(shares, [k - 1, k, k + 1], mode="clip") ** 2
            within = (a - c) / (2 * (a - 2 * b + c)) if min(a, c) > b else 0.0
            lag = float(fine[k] + slowest / FINE * within)
            values = {"kind": dataset.runs[0].kind, "lag": lag, "shifted": float(shares[k])}
            found.append(Finding(F.LATE, (joint,), values=values | {"as_logged": as_logged}, severity=as_logged))
    return tuple(found)


def _windows(dataset: Dataset, reach: float) -> Iterator[_Window]:
    """Iterate over the middle of the runs, with currents available up to ``reach`` (s) before and after."""
    joints, regressor = range(len(dataset.model.actuated)), dataset.model.columns(dataset.base.standard)
    loads = [None if run.payload is None else run.payload.name for run in dataset.runs]
    kinds = list(dict.fromkeys(loads))
    for run, piece in central_windows(dataset):
        mine = np.array([loads[run] == kind for kind in kinds], dtype=float)
        decimator = dataset.preparation.at(piece.run.rate).decimator
        parts = list(stream_rows(dataset.model, regressor, piece, decimator))
        currents = np.concatenate([part.currents for part in parts], axis=2)
        entries = np.concatenate([part.entries for part in parts], axis=1)
        step = decimator.factor / piece.run.rate
        margin = int(np.ceil(reach / step))
        inner = slice(margin, max(currents.shape[2] - margin, 0))
        kept = [np.arange(currents.shape[2])[inner][np.concatenate([p.keep[j] for p in parts])[inner]] for j in joints]
        own = [np.kron(mine, entries[regressor.rows == j][:, kept[j]].T) for j in joints]
        yield _Window(currents, step, kept, own)
