"""Causes of a change: competing hypotheses of gain, load, friction, warming, zero, delay, clock, units and contact.

A single change of one kind moves all charts in a known way (``response``). Each hypothesis is fitted to the difference
between the logs after the change and those before it, or the model, by generalised least squares, with the covariance
between healthy logs; causes whose likelihood is close to that of the best one cannot be distinguished, and are listed
all. Two at once are tried where one does not explain the change. What no robot has is no cause: sizes are within
bounds, and their intervals do not hold 0.

With some ten logs and forty charts the empirical covariance has no full rank; it is shrunk towards the standard
deviations of the logs with the correlations that independent residuals would give (``formula``).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.stats import t as student

from gtau.estimation.results.result import Result
from gtau.robots.parameter import Parameter
from gtau.watch.detectors import FEWEST
from gtau.watch.history import Explained
from gtau.watch.quantities import Quantity
from gtau.watch.statistics import RESIDUAL, LogStatistics

CLOSE = 9.2  # 2 log(100): of two explanations one is a hundred times as likely
PER_PARAMETER = 2.0  # minimum improvement of the misfit per additional parameter, by Akaike's criterion
UNEVEN = 2.0  # times as uneven as any healthy log: intermittent forces, such as contacts
CERTAIN = 3.0  # standard deviations from zero of the parameter stated first: mass, Coulomb friction
EXPLAINED = 0.5  # minimum explained share of the squared change
POOR = 3.0  # misfit per chart of one cause, above which two are tried
SECOND = 0.3  # of its misfit, below which two explain the change
CORRELATED = 5.7  # logs that count as one: (1 + rho) / (1 - rho) of a correlation of 0.7
REACH = 1.0  # m from the flange to the centre of mass of a load
PER_UNIT = {"zero": 20.0, "delay": 0.2, "clock": 0.2}  # largest sizes, deg or mm and s
RESCALED = 2.0  # a gain that changes by a larger factor is a unit or a sign of the channel


@dataclass(frozen=True, eq=False)
class _Hypothesis:
    """A kind of change: combinations (p, c) of the quantities, and which of the c may be stated."""

    kind: str
    joint: str
    columns: np.ndarray
    stated: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class _Change:
    """Charts ``rows`` that changed, and their change whitened by ``L``; ``logs`` before it set the scatter."""

    rows: np.ndarray
    L: np.ndarray
    values: np.ndarray
    logs: int


def causes_of(
    model: Result, log: LogStatistics, before: np.ndarray, after: np.ndarray, healthy: np.ndarray, heaviest: float
) -> tuple[Explained, ...]:
    """Find the causes that fit a change and cannot be distinguished, the best one first.

    Charts (logs, k) ``after`` it are compared with ``healthy`` (k,), and those ``before`` it scatter. The motion of the
    newest ``log`` determines the signature of each change; a load is ``heaviest`` kg at most.
    """
    change = _whitened(log, before, after, healthy)
    if change is None:
        return ()
    bounds, hypotheses = (-log.payload, heaviest), list(_hypotheses(model, log.quantities))
    fits = [fit for one in hypotheses if (fit := _fit(model, log, change, [one], bounds)) is not None]
    squares = float(change.values @ change.values)
    single = min((fit.misfit for fit in fits), default=squares)
    if single > POOR * len(change.rows):
        pairs = [_fit(model, log, change, list(pair), bounds) for pair in combinations(hypotheses, 2)]
        fits = [fit for fit in pairs if fit is not None and fit.misfit < SECOND * single] or fits
    fits.sort(key=lambda fit: fit.misfit)
    if not fits or fits[0].misfit - PER_PARAMETER > (1 - EXPLAINED) * squares:
        return ()
    scale = max(1.0, fits[0].misfit / max(len(change.rows) - 1, 1))  # large changes are not exactly linear
    return tuple(fit for fit in fits if fit.misfit - fits[0].misfit < CLOSE * scale)


def _whitened(log: LogStatistics, before: np.ndarray, after: np.ndarray, healthy: np.ndarray) -> _Change | None:
    """Whiten the change of the charts that are linear in their quantities by the covariance between healthy logs."""
    usable = log.shown & np.isfinite(healthy) & np.isfinite(after).any(axis=0)
    usable &= (np.isfinite(before).sum(axis=0) >= FEWEST) | (len(before) < FEWEST)
    rows = np.flatnonzero(usable & [chart.kind != RESIDUAL for chart in log.charts])
    if not len(rows):
        return None
    complete = before[:, rows][np.isfinite(before[:, rows]).all(axis=1)]
    share = sum(1 / max(len(logs) / CORRELATED, 1.0) for logs in (complete, after))
    sigma = share * _covariance(complete, log.formula[np.ix_(rows, rows)])
    L = np.linalg.cholesky(sigma + 1e-12 * np.diag(np.diag(sigma)))
    change = np.nanmean(after[:, rows], axis=0) - healthy[rows]
    return _Change(rows, L, np.linalg.solve(L, change), len(complete))


def _fit(
    model: Result, log: LogStatistics, change: _Change, several: list[_Hypothesis], bounds: tuple[float, float]
) -> Explained | None:
    """Fit one hypothesis or two at once; None where a size is not plausible."""
    columns = np.hstack([one.columns for one in several])
    S = np.linalg.solve(change.L, log.response[change.rows] @ columns)
    norms = np.linalg.norm(S, axis=0)
    there = norms > 0
    if not there.any():
        return None
    S, norms = S[:, there] / norms[there], np.where(there, norms, np.inf)
    x, _, rank, _ = np.linalg.lstsq(S, change.values, rcond=1e-6)
    misfit = float(np.sum((change.values - S @ x) ** 2))
    freedom = max(len(change.rows) - int(rank), 1)
    factor = float(student.ppf(0.975, max(change.logs - 1, FEWEST)))
    size, std = np.zeros(columns.shape[1]), np.full(columns.shape[1], np.inf)
    size[there] = x / norms[there]
    std[there] = np.sqrt(np.diag(np.linalg.pinv(S.T @ S, rcond=1e-8)) * max(1.0, misfit / freedom)) / norms[there]
    said, first = None, 0
    for one in reversed(several):
        first = columns.shape[1] - one.columns.shape[1] if one is several[-1] else 0
        part = slice(first, first + one.columns.shape[1])
        stated = _stated(model, log, one, size[part], factor * std[part], misfit + PER_PARAMETER * int(rank))
        if stated is None or not _plausible(stated, bounds):
            return None
        said = stated.model_copy(update={"and_also": said})
    return said


def _stated(
    model: Result, log: LogStatistics, one: _Hypothesis, sizes: np.ndarray, halves: np.ndarray, misfit: float
) -> Explained | None:
    """State the parameter of a hypothesis whose interval does not hold 0: the first, unless only another is certain."""
    certain = [k for k in one.stated if abs(sizes[k]) > halves[k]]
    if not certain:
        return None
    t = np.abs(sizes) / halves
    at = certain[0] if t[certain[0]] > CERTAIN / 2 else max(certain, key=lambda k: t[k])
    size, half, kind = float(sizes[at]), float(halves[at]), one.kind
    quantity = log.quantities[int(np.argmax(np.abs(one.columns[:, at])))]
    if kind == "gain":  # the apparent torque of the current is that of the model over 1 + delta
        apparent = 1 - size
        if not 1 / RESCALED < apparent < RESCALED:
            kind, size = "units", apparent
        else:
            size, half = size / apparent, half / apparent**2
    known = {**model.parameters, **model.friction_parameters}.get(Parameter(quantity.kind, quantity.joint))
    relative = size / known.value if kind == "friction" and known is not None and known.value else None
    unit = "1" if kind in ("warming", "units") else quantity.unit
    return Explained(
        kind=kind,
        joint=one.joint,
        quantity=quantity.kind,
        size=size,
        half=half,
        unit=unit,
        relative=relative,
        misfit=misfit,
    )


def _plausible(stated: Explained, bounds: tuple[float, float]) -> bool:
    """Return whether a robot can have a change of this size."""
    if stated.kind == "load":
        least, most = bounds if stated.quantity == "m" else (-bounds[1] * REACH, bounds[1] * REACH)
        return least - stated.half <= stated.size <= most
    if stated.kind in ("friction", "warming"):
        return (stated.size if stated.kind == "warming" else stated.relative or 0.0) > -1.1
    return abs(stated.size) < PER_UNIT.get(stated.kind, np.inf)


def _hypotheses(model: Result, quantities: tuple[Quantity, ...]) -> Iterator[_Hypothesis]:
    """List the hypotheses on the watched quantities."""
    eye = np.eye(len(quantities))
    load = [k for k, quantity in enumerate(quantities) if quantity.group == "load"]
    if load:
        kinds = [quantities[k].kind for k in load]
        of_load = tuple(kinds.index(kind) for kind in ("m", "mx", "my", "mz") if kind in kinds)
        yield _Hypothesis("load", "", eye[:, load], of_load)
    for k, quantity in enumerate(quantities):
        if quantity.kind in ("gain", "zero", "delay"):
            yield _Hypothesis(quantity.kind, quantity.joint, eye[:, [k]], (0,))
    places = {(quantity.joint, quantity.kind): k for k, quantity in enumerate(quantities)}
    known, warming = {**model.parameters, **model.friction_parameters}, np.zeros((len(quantities), 1))
    joints = [joint for joint in dict.fromkeys(quantity.joint for quantity in quantities) if joint]
    for joint in joints:
        friction = [places[joint, kind] for kind in ("fs", "fv") if (joint, kind) in places]
        for k in friction:
            warming[k] = getattr(known.get(Parameter(quantities[k].kind, joint)), "value", None) or 0.0
        if friction:
            yield _Hypothesis("friction", joint, eye[:, friction], tuple(range(len(friction))))
    if len(joints) > 1:
        for kind, column in (("clock", "delay"), ("gain", "gain")):
            of_kind = [k for k, quantity in enumerate(quantities) if quantity.kind == column]
            yield _Hypothesis(kind, "", eye[:, of_kind].sum(axis=1, keepdims=True), (0,))
        yield _Hypothesis("warming", "", warming, (0,))


def contacts_of(log: LogStatistics, uneven: np.ndarray) -> tuple[Explained, ...]:
    """Suspect a contact where the residual of a joint is far more uneven along the log than it ever was."""
    ratio = log.uneven / np.maximum(uneven, 1.0)
    j = int(np.argmax(ratio))
    if ratio[j] < UNEVEN:
        return ()
    size = float(ratio[j])
    return (Explained(kind="contact", joint=log.joints[j], quantity=RESIDUAL, size=size, half=0, unit="1", misfit=0),)


def _covariance(values: np.ndarray, formula: np.ndarray) -> np.ndarray:
    """Estimate the covariance (k, k) between healthy logs (logs, k), positive definite however few they are.

    Correlations are shrunk to those of one log (``formula``), below half of whose standard deviations none scatter.
    """
    logs, k = values.shape
    deviations = values - (values.mean(axis=0) if logs else 0.0)
    S = deviations.T @ deviations / max(logs - 1, 1)
    sizes = np.sqrt(np.maximum(np.diag(S), np.diag(formula) / 4))
    of_formula = np.sqrt(np.maximum(np.diag(formula), 1e-300))
    target = formula / of_formula / of_formula[:, None]
    share = k / (k + max(logs - 1, 0))
    R = share * (0.9 * target + 0.1 * np.eye(k)) + (1 - share) * (S / sizes / sizes[:, None])
    np.fill_diagonal(R, 1.0)
    return np.asarray(R * sizes * sizes[:, None])
