"""Explain an alarm by competing hypotheses: gain, load, friction, encoder zero, delay, clock or contact.

A single change of one kind moves all charts in a known way (``response``). Each hypothesis is fitted to the difference
between the logs after the change and those before it by generalised least squares, with the covariance between healthy
logs; explanations whose likelihood is close to that of the best one cannot be distinguished, and are listed all.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gtau.watch.detectors import MEMORY
from gtau.watch.quantities import Quantity
from gtau.watch.statistics import RESIDUAL, LogStatistics

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


@dataclass(frozen=True, eq=False)
class Change:
    """Difference of the charts (k,) after and before, with the numbers of logs; ``latest``, that of the last log."""

    difference: np.ndarray
    latest: np.ndarray
    covariance: np.ndarray
    before: int
    after: int

    @property
    def scaled(self) -> np.ndarray:
        """Covariance of the difference: neighbouring logs are correlated."""
        share = (1 + MEMORY) / (1 - MEMORY)
        return self.covariance * sum(1 / max(count / share, 1.0) for count in (self.before, self.after))


@dataclass(frozen=True, eq=False)
class Healthy:
    """Residuals of the healthy logs: the largest unevenness and the mean logarithm of the rms of each joint, (n,)."""

    uneven: np.ndarray
    rms: np.ndarray


def explain(change: Change, log: LogStatistics, kept: np.ndarray, healthy: Healthy) -> tuple[Explanation, ...]:
    """Find the explanations that fit a change, the best one first.

    Parameters
    ----------
    change : Change
        Change of the charts ``kept``.
    log : LogStatistics
        Statistics of the last log, whose motion determines the signature of each change.
    kept : ndarray
        Numbers of the charts that all logs show.
    healthy : Healthy
        Residuals before.

    Returns
    -------
    tuple of Explanation
        None of them if nothing fits.
    """
    linear = np.array([log.charts[k].kind != RESIDUAL for k in kept], dtype=bool)
    if not linear.any():
        return _contacts(log, healthy)
    rows = kept[linear]
    d = change.difference[linear]
    sigma = change.scaled[np.ix_(linear, linear)]
    L = np.linalg.cholesky(sigma + 1e-12 * np.diag(np.diag(sigma)))
    y, latest = np.linalg.solve(L, d), np.linalg.solve(L, change.latest[linear])
    total = float(y @ y)
    before = float(log.rows @ np.exp(2 * healthy.rms))
    excess = float(log.rows @ _power(log)) - before
    found = []
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
        if excess > EXPLAINED * before and cause @ log.information @ cause < (1 - EXPLAINED) * excess:
            continue  # the residual has grown far more than this hypothesis predicts
        freedom = max(len(y) - int(rank), 1)
        spread = np.sqrt(np.diag(np.linalg.pinv(S.T @ S, rcond=1e-8)) * max(1.0, left / freedom))
        places = np.cumsum(there) - 1
        at = _stated([int(places[k]) for k in stated if there[k]], np.abs(x) / np.maximum(spread, 1e-300))
        of = log.quantities[int(np.argmax(np.abs(columns[:, at])))]
        size, std = float(x[at] / norms[at]), float(spread[at] / norms[at])
        if kind == "gain":  # the apparent torque of the current is that of the model over 1 + delta
            size, std = size / (1 - size), std / (1 - size) ** 2
        misfit = left + PER_PARAMETER * int(rank)
        found.append(Explanation(kind, joint, of.kind, size, std, of.unit, misfit, freedom))
    found.sort(key=lambda each: each.misfit)
    if not found or found[0].misfit - PER_PARAMETER > (1 - EXPLAINED) * total:
        return _contacts(log, healthy)
    best = found[0]
    scale = max(1.0, (best.misfit - PER_PARAMETER) / best.freedom)  # large changes are not exactly linear
    return tuple(each for each in found if each.misfit - best.misfit < CLOSE * scale)


def _stated(candidates: list[int], t: np.ndarray) -> int:
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


def _contacts(log: LogStatistics, healthy: Healthy) -> tuple[Explanation, ...]:
    """Suspect a contact where the residual of a joint is far more uneven along the log than it ever was."""
    ratio = log.uneven / np.maximum(healthy.uneven, 1.0)
    j = int(np.argmax(ratio))
    if ratio[j] < UNEVEN:
        return ()
    return (Explanation("contact", log.joints[j], RESIDUAL, float(ratio[j]), 0.0, "1", 0.0, 1.0),)
