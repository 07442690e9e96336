"""Explain an alarm: its onset, and competing hypotheses: gain, load, friction, encoder zero, delay, clock or contact.

A single change of one kind moves all charts in a known way (``response``). Each hypothesis is fitted to the difference
between the logs after the change and those before it by generalised least squares, with the covariance between healthy
logs; explanations whose likelihood is close to that of the best one cannot be distinguished, and are listed all.

With some ten logs and forty charts the empirical covariance has no full rank; it is shrunk towards the standard
deviations of the logs with the correlations that independent residuals would give (``formula``).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gtau.estimation.results.result import Result
from gtau.robots.parameter import Parameter
from gtau.watch.detectors import FEWEST, MEMORY, Chart, Evidence
from gtau.watch.quantities import Quantity
from gtau.watch.state import Alarm, Entry, Explained
from gtau.watch.statistics import RESIDUAL, LogStatistics

LISTED = 5  # charts that changed most
CLOSE = 9.2  # 2 log(100): of two explanations one is a hundred times as likely
PER_PARAMETER = 2.0  # minimum improvement of the misfit per additional parameter, by Akaike's criterion
UNEVEN = 2.0  # times as uneven as any healthy log: intermittent forces, such as contacts
CERTAIN = 3.0  # standard deviations from zero of the parameter stated first: mass, Coulomb friction
EXPLAINED = 0.5  # minimum explained share of the squared change


@dataclass(frozen=True, eq=False)
class Explanation:
    """A hypothesis fitted to a change: ``size`` and ``std`` in ``unit``, and its misfit.

    ``kind`` is gain, load, friction, zero, delay, clock or contact, ``quantity`` what is stated of it, as ``fs`` of
    friction; ``misfit`` the squared standard deviations that are left, with what its parameters cost.
    """

    kind: str
    joint: str
    quantity: str
    size: float
    std: float
    unit: str
    misfit: float
    freedom: float


def alarm_of(
    model: Result,
    entries: Sequence[Entry],
    charts: Mapping[str, Chart],
    evidences: Mapping[str, Evidence],
    log: LogStatistics,
    uneven: Mapping[str, float],
) -> Alarm:
    """Explain the change indicated by the charts.

    ``entries`` are the last logs, ``log`` the statistics of the newest, the last one; ``uneven`` the largest
    unevenness of each joint's residual in healthy logs.
    """
    leading = max(evidences, key=lambda name: evidences[name].log_e)
    shown = [k for k, entry in enumerate(entries) if leading in entry.values]
    first = charts[leading].total - len(shown)  # number of the first of these in its chart
    of = evidences[leading]

    def at(number: int | None) -> int:
        """Find the index among the entries of the log with this number in the leading chart."""
        return max(shown[min(max((number or 0) - first, 0), len(shown) - 1)], 1)

    start, names = at(of.start), [chart.name for chart in log.charts]
    table = np.array([[entry.values.get(name, np.nan) for name in names] for entry in entries], dtype=float)
    found, logs = explain(table[:start], table[start:], log, uneven)
    from scipy.stats import t

    factor = float(t.ppf(0.975, max(logs - 1, 1)))
    loud = sorted((name for name, each in evidences.items() if each.log_e > 0), key=lambda name: -evidences[name].log_e)
    return Alarm(
        explanations=tuple(_stated(each, model, factor) for each in found),
        since=entries[start].log,
        earliest=entries[at(of.earliest)].log,
        latest=entries[at(of.latest)].log,
        charts=tuple(loud[:LISTED]),
    )


def explain(
    before: np.ndarray, after: np.ndarray, log: LogStatistics, uneven: Mapping[str, float]
) -> tuple[tuple[Explanation, ...], int]:
    """Find the explanations that fit a change, the best one first, and the number of logs behind the scatter.

    ``before`` and ``after`` (logs, k) are charts of the logs before and after the change, NaN where a log does not
    show one; the motion of the newest, ``log``, determines the signature of each change. Returned are those that
    cannot be distinguished, none if nothing fits.
    """
    enough = (np.isfinite(before).sum(axis=0) >= FEWEST) & np.isfinite(after).any(axis=0) & log.shown
    kept = np.flatnonzero(enough)
    whole = before[:, kept][np.isfinite(before[:, kept]).all(axis=1)]
    if not len(kept) or len(whole) < 2:
        return (), len(whole)
    rows = np.array([k for k in kept if log.charts[k].kind != RESIDUAL], dtype=int)
    if not len(rows):
        return _contacts(log, uneven), len(whole)
    linear = np.isin(kept, rows)
    covariance = covariance_between(whole, log.formula[np.ix_(kept, kept)], np.sqrt(np.diag(log.formula))[kept])
    independent = (1 + MEMORY) / (1 - MEMORY)  # logs that count as one: neighbouring ones are correlated
    sigma = covariance * sum(1 / max(len(logs) / independent, 1.0) for logs in (whole, after))
    sigma = sigma[np.ix_(linear, linear)]
    L = np.linalg.cholesky(sigma + 1e-12 * np.diag(np.diag(sigma)))
    healthy = np.nanmean(before[:, rows], axis=0)
    y = np.linalg.solve(L, np.nanmean(after[:, rows], axis=0) - healthy)
    latest = np.linalg.solve(L, log.values[rows] - healthy)
    rms = {
        chart.joint: float(np.nanmean(before[:, k])) if np.isfinite(before[:, k]).any() else 0.0
        for k, chart in enumerate(log.charts)
        if chart.kind == RESIDUAL
    }
    power = float(log.rows @ np.exp(2 * np.array([rms[joint] for joint in log.joints])))
    found = sorted(_fitted(log, rows, L, y, latest, power), key=lambda each: each.misfit)
    if not found or found[0].misfit - PER_PARAMETER > (1 - EXPLAINED) * float(y @ y):
        return _contacts(log, uneven), len(whole)
    best = found[0]
    scale = max(1.0, (best.misfit - PER_PARAMETER) / best.freedom)  # large changes are not exactly linear
    return tuple(each for each in found if each.misfit - best.misfit < CLOSE * scale), len(whole)


def _fitted(
    log: LogStatistics, rows: np.ndarray, L: np.ndarray, y: np.ndarray, latest: np.ndarray, power: float
) -> Iterator[Explanation]:
    """Fit each hypothesis to the charts ``rows``.

    ``L`` whitens them; ``y`` and ``latest`` are the whitened changes of all later logs and of the newest one, and
    ``power`` the squared residual of the healthy ones.
    """
    excess = float(log.rows @ _power(log)) - power
    for kind, joint, columns, stated in _hypotheses(log.quantities):
        S = np.linalg.solve(L, log.response[rows] @ columns)
        there = np.linalg.norm(S, axis=0) > 0
        if not there[stated].any():
            continue
        S, columns = S[:, there], columns[:, there]
        norms = np.linalg.norm(S, axis=0)
        S = S / norms
        x, _, rank, _ = np.linalg.lstsq(S, y, rcond=1e-6)
        left = float(np.sum((y - S @ x) ** 2))
        cause = columns @ (np.linalg.lstsq(S, latest, rcond=1e-6)[0] / norms)
        if excess > EXPLAINED * power and cause @ log.information @ cause < (1 - EXPLAINED) * excess:
            continue  # the residual has grown far more than this hypothesis predicts
        freedom = max(len(y) - int(rank), 1)
        spread = np.sqrt(np.diag(np.linalg.pinv(S.T @ S, rcond=1e-8)) * max(1.0, left / freedom))
        places = np.cumsum(there) - 1
        at = _reported([int(places[k]) for k in stated if there[k]], np.abs(x) / np.maximum(spread, 1e-300))
        of = log.quantities[int(np.argmax(np.abs(columns[:, at])))]
        size, std = float(x[at] / norms[at]), float(spread[at] / norms[at])
        if kind == "gain":  # the apparent torque of the current is that of the model over 1 + delta
            size, std = size / (1 - size), std / (1 - size) ** 2
        misfit = left + PER_PARAMETER * int(rank)
        yield Explanation(kind, joint, of.kind, size, std, of.unit, misfit, freedom)


def _reported(candidates: list[int], t: np.ndarray) -> int:
    """Choose the reported parameter of a hypothesis: the first one, unless it may be zero and another is not."""
    return candidates[0] if t[candidates[0]] > CERTAIN else max(candidates, key=lambda k: t[k])


def _hypotheses(quantities: tuple[Quantity, ...]) -> Iterator[tuple[str, str, np.ndarray, list[int]]]:
    """List kind, joint, combinations (p, k) of the quantities, and which of the k may be stated."""
    p, eye = len(quantities), np.eye(len(quantities))
    load = [k for k, each in enumerate(quantities) if each.group == "load"]
    if load:
        kinds = [quantities[k].kind for k in load]
        yield "load", "", eye[:, load], [kinds.index(kind) for kind in ("m", "mx", "my", "mz") if kind in kinds]
    for k, each in enumerate(quantities):
        if each.kind in ("gain", "zero", "delay"):
            yield each.kind, each.joint, eye[:, [k]], [0]
    joints = dict.fromkeys(each.joint for each in quantities if each.joint)
    for joint in joints:
        own = [k for kind in ("fs", "fv") for k, q in enumerate(quantities) if q.joint == joint and q.kind == kind]
        if own:
            yield "friction", joint, eye[:, own], list(range(len(own)))
    delays = [k for k, each in enumerate(quantities) if each.kind == "delay"]
    if len(delays) > 1:
        together = np.zeros((p, 1))
        together[delays] = 1.0
        yield "clock", "", together, [0]


def _power(log: LogStatistics) -> np.ndarray:
    """Return the mean squared residual of each joint (n,), relative to that of the identification."""
    named = {chart.joint: value for chart, value in zip(log.charts, log.values, strict=True) if chart.kind == RESIDUAL}
    logarithms = np.array([named.get(joint, np.nan) for joint in log.joints])
    return np.where(np.isfinite(logarithms), np.exp(2 * np.nan_to_num(logarithms)), 0.0)


def _contacts(log: LogStatistics, uneven: Mapping[str, float]) -> tuple[Explanation, ...]:
    """Suspect a contact where the residual of a joint is far more uneven along the log than it ever was."""
    ratio = log.uneven / np.maximum([uneven.get(joint, 1.0) for joint in log.joints], 1.0)
    j = int(np.argmax(ratio))
    if ratio[j] < UNEVEN:
        return ()
    return (Explanation("contact", log.joints[j], RESIDUAL, float(ratio[j]), 0.0, "1", 0.0, 1.0),)


def _stated(each: Explanation, model: Result, factor: float) -> Explained:
    """State an explanation with its interval, and its share of the model's friction."""
    relative = None
    if each.kind == "friction":
        friction = model.friction_parameters
        known = {**model.parameters, **friction}.get(Parameter(each.quantity, each.joint))
        if known is not None and known.value:
            relative = each.size / known.value
    return Explained(
        kind=each.kind,
        joint=each.joint,
        quantity=each.quantity,
        size=each.size,
        half=factor * each.std,
        unit=each.unit,
        relative=relative,
        misfit=each.misfit,
    )


def covariance_between(values: np.ndarray, formula: np.ndarray, least: np.ndarray) -> np.ndarray:
    """Estimate the covariance (k, k) between healthy logs, positive definite however few they are.

    ``values`` (logs, k) are those of charts that every log shows; correlations are shrunk to those of ``formula`` (k,
    k), the covariance of one log for independent residuals, below whose standard deviations ``least`` (k,) logs do not
    scatter.
    """
    logs, k = values.shape
    deviations = values - values.mean(axis=0)
    S = deviations.T @ deviations / max(logs - 1, 1)
    sizes = np.sqrt(np.maximum(np.diag(S), least**2 / 4))
    of_formula = np.sqrt(np.maximum(np.diag(formula), 1e-300))
    target = formula / of_formula / of_formula[:, None]
    empirical = S / sizes / sizes[:, None]
    share = k / (k + max(logs - 1, 0))
    R = share * (0.9 * target + 0.1 * np.eye(k)) + (1 - share) * empirical
    np.fill_diagonal(R, 1.0)
    return np.asarray(R * sizes * sizes[:, None])
