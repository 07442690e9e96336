"""Statistics of a log: the size of each change, estimated one at a time with friction, and its standard deviation.

Friction of a healthy robot differs from day to day, so friction and offsets of all joints are always free. In addition
one change at a time is estimated: a drive gain at fixed inertia, an encoder zero, a delay, or the load. By the theorem
of Frisch and Waugh each estimate is a fixed linear combination ``x = C A^T y`` of the log's residual; the same
combinations of the columns, ``C A^T A``, give the signature of each kind of change in all estimates.

Standard deviations come from the block jackknife over blocks of the log, as residuals are autocorrelated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from gtau.estimation.estimators.estimator import jackknife
from gtau.estimation.results.result import IdentifiedModel
from gtau.signals.run import Run
from gtau.watch.quantities import Quantity, normal_equations, quantities_of

SPANNED = 1e-6  # of the square of a column: below this residual it depends linearly on the others
SHOWN = 0.03  # of a joint's rms torque: most that a change of one standard deviation may move it
LARGEST_ZERO = 1.0  # deg or mm: an encoder zero with a larger standard deviation is not observable
RESIDUAL = "rms"  # kind of the residual's charts
UNEVEN = 2.0  # times as uneven as any healthy log: intermittent forces, such as contacts
inverse_of = partial(np.linalg.pinv, rcond=1e-10, hermitian=True)  # directions without any effect are left out


@dataclass(frozen=True, eq=False)
class LogStatistics:
    """Statistics of one log.

    The k ``charts`` are quantities, then the residual of each joint (logarithm of its rms over the model's residual).
    They have ``values`` (k,), NaN where this motion does not show a change, and a ``covariance`` (k, k) from the
    jackknife, 0 there. ``response`` (k, p) is the change of each chart per unit of each of the ``quantities``, and
    ``formula`` (k, k) the covariance for independent residuals of unit variance, which is not singular. ``uneven``
    (n,) is the largest rms residual of a block over the median one of each joint, as contacts are brief. ``speed``
    (n,) is the mean absolute velocity, and ``run`` the log itself.
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
    run: Run

    @property
    def std(self) -> np.ndarray:
        """Standard deviations (k,), NaN where this motion does not show a change."""
        return np.where(self.shown, np.sqrt(np.diag(self.covariance)), np.nan)

    @property
    def shown(self) -> np.ndarray:
        """Mask (k,) of the charts that are observable in this motion."""
        return np.isfinite(self.values)


def unevenness(log: LogStatistics, healthy: np.ndarray) -> np.ndarray:
    """Compute how many times more uneven each joint's residual (n,) is along a log than in ``healthy`` logs."""
    return np.asarray(log.uneven / np.maximum(healthy, 1.0))


def charts_of(model: IdentifiedModel) -> tuple[Quantity, ...]:
    """List the charts of a model."""
    quantities, _ = quantities_of(model)
    residuals = (Quantity(RESIDUAL, joint, "log") for joint in model.robot.actuated)
    return (*(quantity for quantity in quantities if quantity.charted), *residuals)


def statistics_of(model: IdentifiedModel, run: Run) -> LogStatistics:
    """Compute the statistics of a finished log, the model loaded with its payload; raises GtauError."""
    G, rows, speed = normal_equations(model, run)
    (quantities, _), charts = quantities_of(model), charts_of(model)
    total, blocks, friction = G.sum(axis=(0, 1)), np.arange(len(G)), _columns_of(quantities, "friction")
    C, usable = _combinations(total, quantities)
    residual, uneven = residuals_of(G, rows, friction, blocks >= 0)
    k, p, K = len(C), len(quantities), len(charts)
    values, replicates = np.concatenate([C @ total[:p, p], residual]), []
    for block in np.flatnonzero(rows.any(axis=1)):
        rest = total - G[block].sum(axis=0)
        without, fine = _combinations(rest, quantities)
        residual, _ = residuals_of(G, rows, friction, blocks != block)
        replicates.append(np.concatenate([np.where(fine, without @ rest[:p, p], values[:k]), residual]))
    covariance = jackknife(np.array(replicates)) if len(replicates) > 1 else np.full((K, K), np.inf)
    std = np.sqrt(np.diag(covariance))
    response, formula = np.zeros((K, p)), np.zeros((K, K))
    response[:k] = C @ total[:p, :p]
    formula[:k, :k] = response[:k] @ C.T
    formula[k:, k:] = np.diag(0.5 / np.maximum(rows.sum(axis=0), 1))  # of the logarithm of an rms
    shown = np.isfinite(values) & (std > 0) & np.isfinite(std)
    shown[:k] &= usable & (np.sqrt(np.diag(formula)[:k]) < _limits(G, quantities))
    return LogStatistics(
        run.name,
        charts,
        np.where(shown, values, np.nan),
        np.where(shown[:, None] & shown, covariance, 0.0),
        quantities,
        response,
        formula,
        uneven,
        speed,
        run,
    )


def _columns_of(quantities: Sequence[Quantity], group: str) -> list[int]:
    return [k for k, quantity in enumerate(quantities) if quantity.group == group]


def _combinations(G: np.ndarray, quantities: Sequence[Quantity]) -> tuple[np.ndarray, np.ndarray]:
    """Find the combinations C (k, p) with ``x = C A^T y`` of the charted quantities, and whether each is usable."""
    friction, load = _columns_of(quantities, "friction"), _columns_of(quantities, "load")
    charted = [quantity.charted for quantity in quantities]
    norms = np.sqrt(np.diag(G)[:-1])
    scale = np.where(norms > 0, norms, 1.0)
    N = G[:-1, :-1] / scale / scale[:, None]
    friction_inverse = inverse_of(N[np.ix_(friction, friction)])
    projection = friction_inverse @ N[friction]  # (f, p)
    rest = N - N[:, friction] @ projection
    inverse = np.diag(1 / np.maximum(np.diag(rest), SPANNED))  # one by one, except the load
    inverse[np.ix_(load, load)] = inverse_of(rest[np.ix_(load, load)])
    inverse[friction] = 0.0
    usable = (norms > 0) & (np.diag(rest) > SPANNED) & (np.diag(inverse) < 1 / SPANNED)
    usable[friction] = (norms[friction] > 0) & (np.diag(friction_inverse) < 1 / SPANNED)
    inverse[:, friction] = -inverse @ projection.T
    inverse[np.ix_(friction, friction)] = friction_inverse
    return (inverse / scale / scale[:, None])[charted], usable[charted]


def residuals_of(
    G: np.ndarray, rows: np.ndarray, free: Sequence[int], used: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Compute each joint's log ratio of rms residuals in the blocks ``used``, columns ``free``, and its unevenness."""
    n = rows.shape[1]
    rms, uneven = np.full(n, np.nan), np.ones(n)
    for j in np.flatnonzero(rows[used].any(axis=0)):
        total, count = G[used, j].sum(axis=0), rows[:, j]
        x = np.zeros(len(total))
        scale = np.sqrt(np.maximum(np.diag(total)[free], 1e-300))
        N = total[np.ix_(free, free)] / scale / scale[:, None]
        x[free], x[-1] = -inverse_of(N) @ (total[free, -1] / scale) / scale, 1.0
        rms[j] = 0.5 * np.log(max(float(x @ total @ x), 1e-300) / count[used].sum())
        squares = np.einsum("p,spq,q->s", x, G[:, j], x)
        block_rms = np.sqrt(np.maximum(squares, 0.0) / np.maximum(count, 1))[count > 0]
        uneven[j] = block_rms.max() / max(np.median(block_rms), 1e-300)
    return rms, uneven


def _limits(G: np.ndarray, quantities: Sequence[Quantity]) -> np.ndarray:
    """Find the largest standard deviation of an observable chart: it moves no joint's torque by more than SHOWN.

    It depends on the motion and the model's residual alone, so that no fault makes a chart unobservable. The column of
    a joint's gain gives its rms torque.
    """
    squares = np.einsum("sjpp->jp", G)[:, :-1]
    torque_squares = np.diag(squares[:, _columns_of(quantities, "gain")])
    share = np.sqrt(squares / np.maximum(torque_squares, 1e-300)[:, None]).max(axis=0)
    largest = [LARGEST_ZERO if quantity.kind == "zero" else np.inf for quantity in quantities]
    return np.minimum(SHOWN / np.maximum(share, 1e-300), largest)[[quantity.charted for quantity in quantities]]
