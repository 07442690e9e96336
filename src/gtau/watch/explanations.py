"""What explains an alarm: gain, load, friction, encoder zero, delay, clock or contact, as competing hypotheses.

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
PER_PARAMETER = 2.0  # what a further parameter must improve the misfit by, as Akaike's criterion has it
UNEVEN = 2.0  # times as uneven as any healthy log: forces that come and go, such as contacts
EXPLAINED = 0.5  # of the squared change: an explanation of less is none


@dataclass(frozen=True, eq=False)
class Explanation:
    """A hypothesis fitted to a change: ``size`` and ``std`` in ``unit``, and what it leaves of the change.

    ``kind`` is gain, load, friction, zero, delay, clock or contact; ``misfit`` the squared standard deviations that
    are left, with what its parameters cost.
    """

    kind: str
    joint: str
    size: float
    std: float
    unit: str
    misfit: float
    freedom: float


@dataclass(frozen=True, eq=False)
class Change:
    """Difference of the charts before and after, of ``before`` and ``after`` logs."""

    difference: np.ndarray
    covariance: np.ndarray
    before: int
    after: int

    @property
    def scaled(self) -> np.ndarray:
        """Covariance of the difference: neighbouring logs are correlated."""
        share = (1 + MEMORY) / (1 - MEMORY)
        return self.covariance * sum(1 / max(count / share, 1.0) for count in (self.before, self.after))


def explain(change: Change, log: LogStatistics, kept: np.ndarray, uneven_before: np.ndarray) -> tuple[Explanation, ...]:
    """Find the explanations that fit a change, the best one first.

    Parameters
    ----------
    change : Change
        Of the charts ``kept``.
    log : LogStatistics
        Of the last log, whose motion says what each change looks like.
    kept : ndarray
        Numbers of the charts that all logs show.
    uneven_before : ndarray
        (n,) how uneven the residual of each joint was at most while the robot was healthy.

    Returns
    -------
    tuple of Explanation
        None of them if nothing fits.
    """
    linear = np.array([log.charts[k].kind != RESIDUAL for k in kept], dtype=bool)
    if not linear.any():
        return _contacts(log, uneven_before)
    rows = kept[linear]
    d = change.difference[linear]
    sigma = change.scaled[np.ix_(linear, linear)]
    L = np.linalg.cholesky(sigma + 1e-12 * np.diag(np.diag(sigma)))
    y = np.linalg.solve(L, d)
    total = float(y @ y)
    found = []
    for kind, joint, unit, columns, of in _hypotheses(log.quantities):
        S = np.linalg.solve(L, log.response[np.ix_(rows, range(len(log.quantities)))] @ columns)
        norms = np.linalg.norm(S, axis=0)
        if not norms[of] > 0:
            continue
        S = S[:, norms > 0] / norms[norms > 0]
        x, _, rank, _ = np.linalg.lstsq(S, y, rcond=1e-6)
        left = float(np.sum((y - S @ x) ** 2))
        at = int(np.count_nonzero(norms[:of] > 0))
        spread = np.linalg.pinv(S.T @ S, rcond=1e-8)
        freedom = max(len(y) - int(rank), 1)
        std = np.sqrt(spread[at, at] * max(1.0, left / freedom)) / norms[of]
        misfit = left + PER_PARAMETER * int(rank)
        found.append(Explanation(kind, joint, float(x[at] / norms[of]), float(std), unit, misfit, freedom))
    found.sort(key=lambda each: each.misfit)
    contacts = _contacts(log, uneven_before)
    if not found or found[0].misfit - PER_PARAMETER > (1 - EXPLAINED) * total:
        return contacts
    best = found[0]
    scale = max(1.0, (best.misfit - PER_PARAMETER) / best.freedom)  # large changes are not linear to the last digit
    return tuple(each for each in found if each.misfit - best.misfit < CLOSE * scale)


def _hypotheses(quantities: tuple[Quantity, ...]) -> Iterator[tuple[str, str, str, np.ndarray, int]]:
    """List kind, joint, unit, combinations (p, k) of the quantities, and which of the k is stated."""
    p, eye = len(quantities), np.eye(len(quantities))
    load = [k for k, each in enumerate(quantities) if each.group == "load"]
    if load:
        mass = next((i for i, k in enumerate(load) if quantities[k].kind == "m"), 0)
        yield "load", "", quantities[load[mass]].unit, eye[:, load], mass
    for k, each in enumerate(quantities):
        if each.kind in ("gain", "zero", "delay"):
            yield each.kind, each.joint, each.unit, eye[:, [k]], 0
    joints = dict.fromkeys(each.joint for each in quantities if each.joint)
    for joint in joints:
        own = [k for kind in ("fs", "fv") for k, q in enumerate(quantities) if q.joint == joint and q.kind == kind]
        if own:
            yield "friction", joint, quantities[own[0]].unit, eye[:, own], 0
    delays = [k for k, each in enumerate(quantities) if each.kind == "delay"]
    if len(delays) > 1:
        together = np.zeros((p, 1))
        together[delays] = 1.0
        yield "clock", "", "s", together, 0


def _contacts(log: LogStatistics, before: np.ndarray) -> tuple[Explanation, ...]:
    """Suspect a contact where the residual of a joint is far more uneven along the log than it ever was."""
    ratio = log.uneven / np.maximum(before, 1.0)
    j = int(np.argmax(ratio))
    if ratio[j] < UNEVEN:
        return ()
    return (Explanation("contact", log.joints[j], float(ratio[j]), 0.0, "1", 0.0, 1.0),)
