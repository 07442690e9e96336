"""Triangular factors: all that the estimators need to know of a run, however long.

Each joint's decimated rows ``[W_j  terms_j  v_j  v_j'  v_j'']`` are reduced by QR to a small triangle, one for
each of the stretches that the jackknife leaves out in turn. Factors of more runs merge by one more QR.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from idim.estimation.friction import TERMS
from idim.estimation.rows import stream_rows
from idim.estimation.triangle import triangle
from idim.model.inverse_dynamics import InverseDynamics
from idim.signals.decimation import Decimator
from idim.signals.preparation import Prepared

STRETCHES = 20
ROWS = 512  # merged into a triangle at once
CURRENTS = 3  # columns of a joint's current: v, v', v''
EXTRA = len(TERMS) + CURRENTS
Weigh = Callable[[int, np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class Factors:
    """A run, reduced.

    Attributes
    ----------
    R : ndarray
        (stretches, n, p, p) triangles of ``[W_j terms_j v_j v_j' v_j'']``, p = columns + 5.
    rows : ndarray
        (stretches, n) number of rows behind each.
    condition : float
        Largest condition number of the closures along the run.
    """

    R: np.ndarray
    rows: np.ndarray
    condition: float


def reduce_run(
    idm: InverseDynamics,
    columns: tuple[str, ...],
    prepared: Prepared,
    decimator: Decimator,
    load: np.ndarray | None = None,
    progress: Callable[[int], None] = lambda outputs: None,
    weigh: Weigh | None = None,
) -> Factors:
    """Reduce a prepared run to its triangular factors over the standard ``columns``; see :func:`stream_rows`.

    ``weigh`` gives the rows of a joint their weights (K,), from the joint's number, the rows (K, p), and which of
    them are kept (K,).

    Raises
    ------
    IdimError
        Where the closures refuse a sample.
    """
    regressor = idm.columns(columns)
    outputs = len(decimator.instants(len(prepared.time)))
    n, p = len(idm.actuated), len(columns) + EXTRA
    own = [np.append(np.unique(regressor.columns[regressor.rows == j]), np.arange(p - EXTRA, p)) for j in range(n)]
    R, rows = np.zeros((STRETCHES, n, p, p)), np.zeros((STRETCHES, n), dtype=int)
    small = [[np.zeros((0, columns.size)) for columns in own] for _ in range(STRETCHES)]  # the triangles of own columns
    waiting: list[list[np.ndarray]] = [[] for _ in range(n)]
    condition, now, held = 0.0, 0, 0

    def merge() -> None:
        for j in range(n):
            if waiting[j]:
                small[now][j] = triangle(small[now][j], *waiting[j])
                waiting[j].clear()

    for part in stream_rows(idm, regressor, prepared, decimator, load):
        condition = max(condition, part.condition)
        stretch = np.arange(part.outputs.start, part.outputs.stop) * STRETCHES // outputs
        A = np.zeros((n, len(part.time), p))
        A[regressor.rows, :, regressor.columns] = part.entries
        A[:, :, -EXTRA:-CURRENTS] = part.terms.transpose(1, 2, 0)
        A[:, :, -CURRENTS:] = part.currents.transpose(1, 2, 0)
        if weigh is not None:
            for j in range(n):
                A[j] *= np.sqrt(weigh(j, A[j], part.keep[j]))[:, None]
        for s in range(stretch[0], stretch[-1] + 1):
            if s > now or held >= ROWS:
                merge()
                now, held = s, 0
            held += int((stretch == s).sum())
            for j in range(n):
                chosen = A[j, (stretch == s) & part.keep[j]]
                if len(chosen):
                    waiting[j].append(chosen[:, own[j]])
                    rows[s, j] += len(chosen)
        progress(len(part.time))
    merge()
    for s in range(STRETCHES):
        for j in range(n):
            # in the columns of all joints a triangle's rows still begin at the diagonal or right of it
            R[s, j, : len(small[s][j]), own[j]] = small[s][j].T
    return Factors(R, rows, condition)
