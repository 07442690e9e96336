"""Statistics of a log: the size of each change, estimated one at a time with friction, and its standard deviation.

Friction of a healthy robot differs from day to day, so friction and offsets of all joints are always free. Beside them
one change is estimated at a time: a drive gain at fixed inertia, an encoder zero, a delay, or the load. By the theorem
of Frisch and Waugh each is a fixed linear combination ``x = C A^T y`` of the log's residual; the same combinations of
the columns, ``C A^T A``, are the signature of each kind of change in all of them, by which explanations are compared.

Standard deviations are those of the block jackknife over blocks of the log, as residuals are autocorrelated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gtau.estimation.estimators.estimator import jackknife
from gtau.estimation.results.result import Result
from gtau.robots.parameter import torque_unit
from gtau.robots.robot import PLAIN_FRICTION
from gtau.signals.run import Run
from gtau.watch.quantities import NormalEquations, Quantity, normal_equations

SPANNED = 1e-6  # of the square of a column: a smaller residual is linear dependence on the others
SHOWN = 0.03  # of a joint's rms torque, by which a change of one standard deviation may at most move it
LARGEST_ZERO = 1.0  # deg or mm: an encoder zero with a larger standard deviation is not observable
RESIDUAL = "rms"  # kind of the residual's charts


@dataclass(frozen=True, eq=False)
class LogStatistics:
    """Statistics of one log.

    Attributes
    ----------
    name : str
        Name of the run.
    charts : tuple of Quantity
        The charts: quantities, then the residual of each joint (logarithm of its rms over that of the model).
    values : ndarray
        (k,) in the units of ``charts``; NaN where this motion does not show a change.
    covariance : ndarray
        (k, k) by the jackknife, 0 for charts that are not observable.
    quantities : tuple of Quantity
        All columns.
    response : ndarray
        (k, p): change of each chart per unit of each quantity.
    formula : ndarray
        (k, k) covariance for independent residuals of unit variance, which has the full rank that the jackknife lacks.
    uneven : ndarray
        (n,) largest rms residual of a block over the median one, of each joint: contacts are brief.
    information : ndarray
        (p, p): the squared residual, friction free, that changes x of the quantities add is ``x^T information x``.
    rows : ndarray
        (n,) number of rows of each joint.
    """

    name: str
    charts: tuple[Quantity, ...]
    values: np.ndarray
    covariance: np.ndarray
    quantities: tuple[Quantity, ...]
    response: np.ndarray
    formula: np.ndarray
    uneven: np.ndarray
    information: np.ndarray
    rows: np.ndarray

    @property
    def std(self) -> np.ndarray:
        """Standard deviations (k,), NaN where this motion does not show a change."""
        return np.where(self.shown, np.sqrt(np.diag(self.covariance)), np.nan)

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the n joints, those of the residuals."""
        return tuple(chart.joint for chart in self.charts if chart.kind == RESIDUAL)

    @property
    def shown(self) -> np.ndarray:
        """Mask (k,) of the charts that are observable in this motion."""
        return np.isfinite(self.values)

    @property
    def not_shown(self) -> tuple[str, ...]:
        """Names of the charts that are not observable in this motion."""
        return tuple(chart.name for chart, there in zip(self.charts, self.shown, strict=True) if not there)


def statistics_of(model: Result, run: Run) -> LogStatistics:
    """Compute the statistics of a finished log, whose payload is part of what is expected; raises GtauError."""
    normal = normal_equations(model, run)
    columns = _Columns.of(normal.quantities)
    total = normal.G.sum(axis=(0, 1))
    C, usable = _combinations(total, columns)
    p = len(normal.quantities)
    k = len(columns.charts)
    values = C @ total[:p, p]
    residual, uneven = _residuals(normal, columns)
    replicates = []
    for s in np.flatnonzero(normal.rows.sum(axis=1)):
        left = total - normal.G[s].sum(axis=0)
        without, fine = _combinations(left, columns)
        own, _ = _residuals(normal, columns, without=int(s))
        replicates.append(np.concatenate([np.where(fine, without @ left[:p, p], values), own]))
    every = np.concatenate([values, residual])
    covariance = jackknife(np.array(replicates)) if len(replicates) > 1 else np.full((len(every),) * 2, np.inf)
    std = np.sqrt(np.diag(covariance))
    joints = model.robot.actuated
    charts = (
        *(normal.quantities[c] for c in columns.charts),
        *(Quantity(RESIDUAL, joint, torque_unit(model.robot, joint)) for joint in joints),
    )
    response = np.vstack([C @ total[:p, :p], np.zeros((len(joints), p))])
    formula = np.zeros((len(every),) * 2)
    formula[:k, :k] = C @ total[:p, :p] @ C.T
    formula[k:, k:] = np.diag(0.5 / np.maximum(normal.rows.sum(axis=0), 1))  # of the logarithm of an rms
    visible = np.sqrt(np.diag(formula)[:k]) < _limits(normal, columns)
    shown = np.concatenate([usable & visible, np.isfinite(residual)]) & (std > 0) & np.isfinite(std)
    seen = np.where(shown[:, None] & shown, covariance, 0.0)
    return LogStatistics(
        run.name,
        charts,
        np.where(shown, every, np.nan),
        seen,
        normal.quantities,
        response,
        formula,
        uneven,
        _beside_friction(total, columns),
        normal.rows.sum(axis=0),
    )


@dataclass(frozen=True, eq=False)
class _Columns:
    """Numbers of the columns: of friction, of the load, of the others that are tried one by one, and of the charts."""

    friction: tuple[int, ...]
    load: tuple[int, ...]
    single: tuple[int, ...]
    charts: tuple[int, ...]

    @staticmethod
    def of(quantities: tuple[Quantity, ...]) -> _Columns:
        friction = tuple(k for k, each in enumerate(quantities) if each.group in PLAIN_FRICTION)
        load = tuple(k for k, each in enumerate(quantities) if each.group == "load")
        single = tuple(k for k in range(len(quantities)) if k not in friction and k not in load)
        charts = tuple(  # inertia of the load and offsets are estimated with the others
            k
            for k, each in enumerate(quantities)
            if each.kind != "off" and (each.joint or each.kind in ("m", "mx", "my", "mz"))
        )
        return _Columns(friction, load, single, charts)


def _combinations(G: np.ndarray, columns: _Columns) -> tuple[np.ndarray, np.ndarray]:
    """Find the combinations C (k, p) with ``x = C A^T y`` of the charted quantities, and whether each is usable."""
    p = len(G) - 1
    every = np.zeros((p, p))
    norms = np.sqrt(np.diag(G)[:p])
    scale = np.where(norms > 0, norms, 1.0)
    N = G[:p, :p] / scale / scale[:, None]
    friction = list(columns.friction)
    inverse = _inverse(N[np.ix_(friction, friction)])
    every[np.ix_(friction, friction)] = inverse
    usable = norms > 0
    usable[friction] &= np.diag(inverse) < 1 / SPANNED
    of_friction = inverse @ N[friction]  # (f, p)
    left = N - N[:, friction] @ of_friction
    for group in (*([each] for each in columns.single), list(columns.load)):
        M = left[np.ix_(group, group)]
        inverse = _inverse(M)
        usable[group] &= (np.diag(M) > SPANNED) & (np.diag(inverse) < 1 / SPANNED)
        every[np.ix_(group, group)] = inverse
        every[np.ix_(group, friction)] = -inverse @ of_friction[:, group].T
    chosen = list(columns.charts)
    return (every / scale / scale[:, None])[chosen], usable[chosen]


def _inverse(M: np.ndarray) -> np.ndarray:
    """Invert a symmetric matrix, directions without any effect left out."""
    values, vectors = np.linalg.eigh(M)
    kept = values > 1e-10 * max(values[-1], 1e-300) if len(values) else np.zeros(0, dtype=bool)
    return np.asarray((vectors[:, kept] / values[kept]) @ vectors[:, kept].T)


def _beside_friction(G: np.ndarray, columns: _Columns) -> np.ndarray:
    """Compute the information (p, p) on all quantities with friction free."""
    N, friction = G[:-1, :-1], list(columns.friction)
    scale = np.sqrt(np.diag(N))
    scale[scale == 0] = 1.0
    M = N / scale / scale[:, None]
    left = M - M[:, friction] @ _inverse(M[np.ix_(friction, friction)]) @ M[friction]
    return np.asarray(left * scale * scale[:, None])


def _residuals(normal: NormalEquations, columns: _Columns, without: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Compute for each joint the log ratio of the rms residual to the model's, friction free, and its unevenness."""
    p, friction = len(normal.quantities), list(columns.friction)
    left_in = [s for s in range(len(normal.G)) if s != without]
    rms, uneven = [], []
    for j in range(normal.G.shape[1]):
        total, count = normal.G[left_in, j].sum(axis=0), int(normal.rows[left_in, j].sum())
        if not count:
            rms.append(np.nan)
            uneven.append(1.0)
            continue
        x = np.zeros(p + 1)
        x[friction], x[p] = -_inverse(total[np.ix_(friction, friction)]) @ total[friction, p], 1.0
        rms.append(0.5 * np.log(max(float(x @ total @ x), 1e-300) / count))
        squares = np.einsum("p,spq,q->s", x, normal.G[:, j], x)
        own = np.sqrt(np.maximum(squares, 0.0) / np.maximum(normal.rows[:, j], 1))[normal.rows[:, j] > 0]
        uneven.append(float(own.max() / max(np.median(own), 1e-300)))
    return np.array(rms), np.array(uneven)


def _limits(normal: NormalEquations, columns: _Columns) -> np.ndarray:
    """Find the largest standard deviation of an observable chart: it moves no joint's torque by more than SHOWN.

    It depends on the motion and the model's residual alone, so that a fault does not hide what the motion shows.
    """
    count = np.maximum(normal.rows.sum(axis=0), 1)
    squares = np.einsum("sjpp->jp", normal.G)[:, list(columns.charts)] / count[:, None]  # in units of sigma
    share = np.sqrt(squares) * (normal.sigma / np.maximum(normal.tau, 1e-300))[:, None]
    of_zeros = [LARGEST_ZERO if normal.quantities[k].kind == "zero" else np.inf for k in columns.charts]
    return np.minimum(SHOWN / np.maximum(share.max(axis=0), 1e-300), of_zeros)
