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
from gtau.signals.run import Run
from gtau.watch.quantities import NormalEquations, Quantity, normal_equations, quantities_of

SPANNED = 1e-6  # of the square of a column: a smaller residual is linear dependence on the others
SHOWN = 0.03  # of a joint's rms torque, by which a change of one standard deviation may at most move it
LARGEST_ZERO = 1.0  # deg or mm: an encoder zero with a larger standard deviation is not observable
RESIDUAL = "rms"  # kind of the residual's charts


@dataclass(frozen=True, eq=False)
class LogStatistics:
    """Statistics of one log.

    The k ``charts`` are quantities, then the residual of each joint (logarithm of its rms over that of the model):
    ``values`` (k,) in their units, NaN where this motion does not show a change, ``covariance`` (k, k) by the
    jackknife, 0 for these. ``response`` (k, p) is the change of each chart per unit of each of the ``quantities``, all
    columns; ``formula`` (k, k) the covariance for independent residuals of unit variance, which has the full rank that
    the jackknife lacks. ``uneven`` (n,) is the largest rms residual of a block over the median one, of each joint:
    contacts are brief. ``speed`` (n,) is the mean absolute velocity, ``payload`` the mass that the log is stated to
    carry, kg.
    """

    name: str
    charts: tuple[Quantity, ...]
    values: np.ndarray
    covariance: np.ndarray
    quantities: tuple[Quantity, ...]
    response: np.ndarray
    formula: np.ndarray
    uneven: np.ndarray
    speed: np.ndarray
    payload: float = 0.0

    @property
    def std(self) -> np.ndarray:
        """Standard deviations (k,), NaN where this motion does not show a change."""
        return np.where(self.shown, np.sqrt(np.diag(self.covariance)), np.nan)

    @property
    def shown(self) -> np.ndarray:
        """Mask (k,) of the charts that are observable in this motion."""
        return np.isfinite(self.values)


def charts_of(model: Result) -> tuple[Quantity, ...]:
    """List the charts of a model."""
    quantities, _ = quantities_of(model)
    residuals = (Quantity(RESIDUAL, joint, "log") for joint in model.robot.actuated)
    return (*(quantity for quantity in quantities if quantity.charted), *residuals)


def statistics_of(model: Result, run: Run) -> LogStatistics:
    """Compute the statistics of a finished log, whose payload is part of what is expected; raises GtauError."""
    normal, charts = normal_equations(model, run), charts_of(model)
    total, blocks = normal.G.sum(axis=(0, 1)), np.arange(len(normal.G))
    C, usable = _combinations(total, normal)
    residual, uneven = _residuals(normal, blocks >= 0)
    k, p, K = len(C), len(total) - 1, len(charts)
    values, replicates = np.concatenate([C @ total[:p, p], residual]), []
    for block in np.flatnonzero(normal.rows.any(axis=1)):
        rest = total - normal.G[block].sum(axis=0)
        without, fine = _combinations(rest, normal)
        residual, _ = _residuals(normal, blocks != block)
        replicates.append(np.concatenate([np.where(fine, without @ rest[:p, p], values[:k]), residual]))
    covariance = jackknife(np.array(replicates)) if len(replicates) > 1 else np.full((K, K), np.inf)
    std = np.sqrt(np.diag(covariance))
    response, formula = np.zeros((K, p)), np.zeros((K, K))
    response[:k] = C @ total[:p, :p]
    formula[:k, :k] = response[:k] @ C.T
    formula[k:, k:] = np.diag(0.5 / np.maximum(normal.rows.sum(axis=0), 1))  # of the logarithm of an rms
    shown = np.isfinite(values) & (std > 0) & np.isfinite(std)
    shown[:k] &= usable & (np.sqrt(np.diag(formula)[:k]) < _limits(normal))
    return LogStatistics(
        run.name,
        charts,
        np.where(shown, values, np.nan),
        np.where(shown[:, None] & shown, covariance, 0.0),
        normal.quantities,
        response,
        formula,
        uneven,
        normal.speed,
        0.0 if run.payload is None else run.payload.mass or model.payload(run.payload.name)["m"],
    )


def _combinations(G: np.ndarray, normal: NormalEquations) -> tuple[np.ndarray, np.ndarray]:
    """Find the combinations C (k, p) with ``x = C A^T y`` of the charted quantities, and whether each is usable."""
    p, friction, load = len(G) - 1, normal.columns("friction"), normal.columns("load")
    combinations, norms = np.zeros((p, p)), np.sqrt(np.diag(G)[:p])
    scale = np.where(norms > 0, norms, 1.0)
    N = G[:p, :p] / scale / scale[:, None]
    inverse = _inverse(N[np.ix_(friction, friction)])
    combinations[np.ix_(friction, friction)] = inverse
    usable = norms > 0
    usable[friction] &= np.diag(inverse) < 1 / SPANNED
    of_friction = inverse @ N[friction]  # (f, p)
    rest = N - N[:, friction] @ of_friction
    for group in (*([k] for k in range(p) if k not in (*friction, *load)), load):
        M = rest[np.ix_(group, group)]
        inverse = _inverse(M)
        usable[group] &= (np.diag(M) > SPANNED) & (np.diag(inverse) < 1 / SPANNED)
        combinations[np.ix_(group, group)] = inverse
        combinations[np.ix_(group, friction)] = -inverse @ of_friction[:, group].T
    return (combinations / scale / scale[:, None])[normal.charts], usable[normal.charts]


def _inverse(M: np.ndarray) -> np.ndarray:
    """Invert a symmetric matrix, directions without any effect left out."""
    values, vectors = np.linalg.eigh(M)
    kept = values > 1e-10 * values.max(initial=1e-290)
    return np.asarray((vectors[:, kept] / values[kept]) @ vectors[:, kept].T)


def _residuals(normal: NormalEquations, used: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute each joint's log ratio of rms residuals, friction free, in the blocks ``used``, and its unevenness."""
    friction, n = normal.columns("friction"), len(normal.speed)
    rms, uneven = np.full(n, np.nan), np.ones(n)
    for j in np.flatnonzero(normal.rows[used].sum(axis=0)):
        total, rows = normal.G[used, j].sum(axis=0), normal.rows[:, j]
        x = np.zeros(len(total))
        x[friction], x[-1] = -_inverse(total[np.ix_(friction, friction)]) @ total[friction, -1], 1.0
        rms[j] = 0.5 * np.log(max(float(x @ total @ x), 1e-300) / rows[used].sum())
        squares = np.einsum("p,spq,q->s", x, normal.G[:, j], x)
        of_blocks = np.sqrt(np.maximum(squares, 0.0) / np.maximum(rows, 1))[rows > 0]
        uneven[j] = of_blocks.max() / max(np.median(of_blocks), 1e-300)
    return rms, uneven


def _limits(normal: NormalEquations) -> np.ndarray:
    """Find the largest standard deviation of an observable chart: it moves no joint's torque by more than SHOWN.

    It depends on the motion and the model's residual alone, so that a fault does not hide what the motion shows. The
    rms torque of a joint is that of the column of its gain.
    """
    squares = np.einsum("sjpp->jp", normal.G)[:, :-1]
    of_torque = np.diag(squares[:, normal.columns("gain")])
    share = np.sqrt(squares / np.maximum(of_torque, 1e-300)[:, None]).max(axis=0)
    largest = [LARGEST_ZERO if quantity.kind == "zero" else np.inf for quantity in normal.quantities]
    return np.minimum(SHOWN / np.maximum(share, 1e-300), largest)[normal.charts]
