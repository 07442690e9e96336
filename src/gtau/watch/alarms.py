"""Explain an alarm: its onset, and competing hypotheses: gain, load, friction, encoder zero, delay, clock or contact.

A single change of one kind moves all charts in a known way (``response``). Each hypothesis is fitted to the difference
between the logs after the change and those before it by generalised least squares, with the covariance between healthy
logs; explanations whose likelihood is close to that of the best one cannot be distinguished, and are listed all.

With some ten logs and forty charts the empirical covariance has no full rank; it is shrunk towards the standard
deviations of the logs with the correlations that independent residuals would give (``formula``).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

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


def alarm_of(
    model: Result,
    entries: Sequence[Entry],
    charts: Mapping[str, Chart],
    evidences: Mapping[str, Evidence],
    log: LogStatistics,
    uneven: Mapping[str, float],
) -> Alarm:
    """Explain the change of the last logs, the newest ``log`` included; ``uneven`` is by joint that of healthy ones."""
    leading = max(evidences, key=lambda name: evidences[name].log_e)
    change = evidences[leading]
    shown = [k for k, entry in enumerate(entries) if leading in entry.values]
    first = charts[leading].total - len(shown)  # number of the first of these in its chart

    def at(number: int | None) -> int:
        """Find the index among the entries of the log with this number in the leading chart."""
        return max(shown[min(max((number or 0) - first, 0), len(shown) - 1)], 1)

    start, names = at(change.start), [chart.name for chart in log.charts]
    table = np.array([[entry.values.get(name, np.nan) for name in names] for entry in entries], dtype=float)
    loud = [name for name, evidence in evidences.items() if evidence.log_e > 0]
    return Alarm(
        explanations=_explained(model, table[:start], table[start:], log, uneven),
        since=entries[start].log,
        earliest=entries[at(change.earliest)].log,
        latest=entries[at(change.latest)].log,
        charts=tuple(sorted(loud, key=lambda name: -evidences[name].log_e)[:LISTED]),
    )


def _explained(
    model: Result, before: np.ndarray, after: np.ndarray, log: LogStatistics, uneven: Mapping[str, float]
) -> tuple[Explained, ...]:
    """Find the explanations that fit a change and cannot be distinguished, the best one first.

    The logs ``before`` and ``after`` it (logs, k) are NaN where they do not show a chart; the motion of the newest,
    ``log``, determines the signature of each change.
    """
    enough = (np.isfinite(before).sum(axis=0) >= FEWEST) & np.isfinite(after).any(axis=0) & log.shown
    kept = np.flatnonzero(enough)
    complete = before[:, kept][np.isfinite(before[:, kept]).all(axis=1)]
    if not len(kept) or len(complete) < 2:
        return ()
    linear = np.array([log.charts[k].kind != RESIDUAL for k in kept])
    rows = kept[linear]
    if not len(rows):
        return _contacts(log, uneven)
    independent = (1 + MEMORY) / (1 - MEMORY)  # logs that count as one: neighbouring ones are correlated
    share = sum(1 / max(len(logs) / independent, 1.0) for logs in (complete, after))
    sigma = share * _covariance(complete, log.formula[np.ix_(kept, kept)])[np.ix_(linear, linear)]
    L = np.linalg.cholesky(sigma + 1e-12 * np.diag(np.diag(sigma)))
    healthy = np.nanmean(before[:, rows], axis=0)
    changes = np.linalg.solve(
        L, np.stack([np.nanmean(after[:, rows], axis=0), log.values[rows]], axis=1) - healthy[:, None]
    )
    fits = sorted(
        _fitted(model, log, rows, L, changes, _grown(log, before), len(complete)), key=lambda fit: fit[0].misfit
    )
    squares = float(changes[:, 0] @ changes[:, 0])
    if not fits or fits[0][0].misfit - PER_PARAMETER > (1 - EXPLAINED) * squares:
        return _contacts(log, uneven)
    best, freedom = fits[0]
    scale = max(1.0, (best.misfit - PER_PARAMETER) / freedom)  # large changes are not exactly linear
    return tuple(fit for fit, _ in fits if fit.misfit - best.misfit < CLOSE * scale)


def _grown(log: LogStatistics, before: np.ndarray) -> tuple[float, float]:
    """Compute the squared residual of healthy logs, and by how much that of the newest log exceeds it."""
    charts = {chart.joint: k for k, chart in enumerate(log.charts) if chart.kind == RESIDUAL}
    columns = [charts[joint] for joint in log.joints]
    values = before[:, columns]
    counts = np.isfinite(values).sum(axis=0)
    rms = np.nansum(values, axis=0) / np.maximum(counts, 1)
    latest = log.values[columns]
    power = float(log.rows @ np.exp(2 * rms))
    return power, float(log.rows @ np.where(np.isfinite(latest), np.exp(2 * np.nan_to_num(latest)), 0.0)) - power


def _fitted(
    model: Result,
    log: LogStatistics,
    rows: np.ndarray,
    L: np.ndarray,
    changes: np.ndarray,
    grown: tuple[float, float],
    logs: int,
) -> Iterator[tuple[Explained, int]]:
    """Fit each hypothesis to the charts ``rows``, which ``L`` whitens, and return its degrees of freedom too.

    ``changes`` (rows, 2) are whitened, of all later logs and of the newest one; ``logs`` is their number, from which
    the intervals follow.
    """
    from scipy.stats import t as student

    factor, (power, excess) = float(student.ppf(0.975, max(logs - 1, 1))), grown
    for kind, joint, columns, stated in _hypotheses(log.quantities):
        S = np.linalg.solve(L, log.response[rows] @ columns)
        norms = np.linalg.norm(S, axis=0)
        there = norms > 0
        if not there[stated].any():
            continue
        S, columns, norms = S[:, there] / norms[there], columns[:, there], norms[there]
        x, _, rank, _ = np.linalg.lstsq(S, changes, rcond=1e-6)
        cause = columns @ (x[:, 1] / norms)
        if excess > EXPLAINED * power and cause @ log.information @ cause < (1 - EXPLAINED) * excess:
            continue  # the residual has grown far more than this hypothesis predicts
        misfit = float(np.sum((changes[:, 0] - S @ x[:, 0]) ** 2))
        freedom = max(len(changes) - int(rank), 1)
        std = np.sqrt(np.diag(np.linalg.pinv(S.T @ S, rcond=1e-8)) * max(1.0, misfit / freedom))
        places = np.cumsum(there) - 1
        at = _reported([int(places[k]) for k in stated if there[k]], np.abs(x[:, 0]) / np.maximum(std, 1e-300))
        quantity = log.quantities[int(np.argmax(np.abs(columns[:, at])))]
        size, half = float(x[at, 0] / norms[at]), factor * float(std[at] / norms[at])
        if kind == "gain":  # the apparent torque of the current is that of the model over 1 + delta
            size, half = size / (1 - size), half / (1 - size) ** 2
        explained = Explained(
            kind=kind,
            joint=joint,
            quantity=quantity.kind,
            size=size,
            half=half,
            unit=quantity.unit,
            relative=_share_of_friction(model, quantity, size) if kind == "friction" else None,
            misfit=misfit + PER_PARAMETER * int(rank),
        )
        yield explained, freedom


def _reported(candidates: list[int], t: np.ndarray) -> int:
    """Choose the reported parameter of a hypothesis: the first one, unless it may be zero and another is not."""
    return candidates[0] if t[candidates[0]] > CERTAIN else max(candidates, key=lambda k: t[k])


def _share_of_friction(model: Result, quantity: Quantity, size: float) -> float | None:
    """Compare a change of friction with the model's."""
    known = {**model.parameters, **model.friction_parameters}
    friction = known.get(Parameter(quantity.kind, quantity.joint))
    return size / friction.value if friction is not None and friction.value else None


def _hypotheses(quantities: tuple[Quantity, ...]) -> Iterator[tuple[str, str, np.ndarray, list[int]]]:
    """List kind, joint, combinations (p, k) of the quantities, and which of the k may be stated."""
    eye = np.eye(len(quantities))
    load = [k for k, quantity in enumerate(quantities) if quantity.group == "load"]
    if load:
        kinds = [quantities[k].kind for k in load]
        yield "load", "", eye[:, load], [kinds.index(kind) for kind in ("m", "mx", "my", "mz") if kind in kinds]
    for k, quantity in enumerate(quantities):
        if quantity.kind in ("gain", "zero", "delay"):
            yield quantity.kind, quantity.joint, eye[:, [k]], [0]
    places = {(quantity.joint, quantity.kind): k for k, quantity in enumerate(quantities)}
    for joint in dict.fromkeys(quantity.joint for quantity in quantities if quantity.joint):
        friction = [places[joint, kind] for kind in ("fs", "fv") if (joint, kind) in places]
        if friction:
            yield "friction", joint, eye[:, friction], list(range(len(friction)))
    delays = [k for k, quantity in enumerate(quantities) if quantity.kind == "delay"]
    if len(delays) > 1:
        yield "clock", "", eye[:, delays].sum(axis=1, keepdims=True), [0]


def _contacts(log: LogStatistics, uneven: Mapping[str, float]) -> tuple[Explained, ...]:
    """Suspect a contact where the residual of a joint is far more uneven along the log than it ever was."""
    ratio = log.uneven / np.maximum([uneven.get(joint, 1.0) for joint in log.joints], 1.0)
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
    deviations = values - values.mean(axis=0)
    S = deviations.T @ deviations / max(logs - 1, 1)
    sizes = np.sqrt(np.maximum(np.diag(S), np.diag(formula) / 4))
    of_formula = np.sqrt(np.maximum(np.diag(formula), 1e-300))
    target = formula / of_formula / of_formula[:, None]
    share = k / (k + max(logs - 1, 0))
    R = share * (0.9 * target + 0.1 * np.eye(k)) + (1 - share) * (S / sizes / sizes[:, None])
    np.fill_diagonal(R, 1.0)
    return np.asarray(R * sizes * sizes[:, None])
