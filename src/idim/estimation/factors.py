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
    R, rows = np.zeros((STRETCHES, n, p, p)), np.zeros((STRETCHES, n), dtype=int)
    condition = 0.0
    for part in stream_rows(idm, regressor, prepared, decimator, load):
        condition = max(condition, part.condition)
        stretch = np.arange(part.outputs.start, part.outputs.stop) * STRETCHES // outputs
        for j in range(n):
            mine = np.flatnonzero(regressor.rows == j)
            A = np.zeros((len(part.time), p))
            A[:, regressor.columns[mine]] = part.entries[mine].T
            A[:, -EXTRA:-CURRENTS] = part.terms[:, j].T
            A[:, -CURRENTS:] = part.currents[:, j].T
            if weigh is not None:
                A *= np.sqrt(weigh(j, A, part.keep[j]))[:, None]
            for s in np.unique(stretch):
                chosen = A[(stretch == s) & part.keep[j]]
                if len(chosen):
                    merged = triangle(R[s, j, : min(rows[s, j], p)], chosen)
                    R[s, j, : len(merged)] = merged
                    rows[s, j] += len(chosen)
        progress(len(part.time))
    return Factors(R, rows, condition)
