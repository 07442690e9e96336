"""Judge a robot after a log: beyond tolerance, changed, odd by itself, repaired or healthy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gtau.estimation.results.result import Result
from gtau.signals.reading.statements import Tolerances
from gtau.watch.causes import Difference, causes_of
from gtau.watch.detectors import FEWEST, WINDOW, Evidence, evidence
from gtau.watch.history import Alarm, Settings
from gtau.watch.statistics import RESIDUAL, LogStatistics
from gtau.watch.table import WEEK, View, beyond, week_of

WEEKLY = 7  # logs that count as a week where they have one date


@dataclass(frozen=True, eq=False)
class Judgement:
    """The alarm after a log, None without one, from which log on the robot is repaired, and the leading evidence."""

    alarm: Alarm | None
    repaired: int | None = None
    log_e: float | None = None
    leading: str = ""


def judge(
    model: Result, settings: Settings, view: View, log: LogStatistics, row: int, previous: Alarm | None
) -> Judgement:
    """Judge the robot after the log in a ``row`` of the table, given the alarm before it."""
    tolerances = Tolerances.model_validate(settings.tolerances)
    if view.odd[row].any():
        if previous is not None and previous.kind != "log":
            return Judgement(previous)
        columns = np.flatnonzero(view.odd[row])
        return Judgement(_alarm("log", model, view, log, columns, (row, row, row), tolerances))
    previous = None if previous is not None and previous.kind == "log" else previous
    if previous is not None and (inside := _inside(view, previous)) is not None:
        return Judgement(None, inside)
    far = beyond(view, week_of(view, std_of_model(model, view)))
    if far.any():
        columns = np.flatnonzero(far)
        return Judgement(_alarm("tolerance", model, view, log, columns, _run_beyond(view, columns), tolerances))
    if view.baseline > settings.baseline:
        proof, rows = evidence_of(view, settings)
        limit, best = limit_of(settings, view), int(np.argmax(proof.log_e))
        log_e = float(proof.log_e[best] - limit + np.log(settings.limit))
        stated = (log_e, view.names[best]) if np.isfinite(log_e) else (None, "")
        if (columns := np.flatnonzero((proof.log_e >= limit) & proof.confirmed)).size:
            leading = columns[np.argmax(proof.log_e[columns])]
            start, earliest, latest = (int(rows[part[leading]]) for part in (proof.start, proof.earliest, proof.latest))
            changed = np.flatnonzero(proof.log_e > 0)
            changed = changed[np.argsort(-proof.log_e[changed])]
            span = start, earliest, latest
            return Judgement(_alarm("change", model, view, log, changed, span, tolerances), None, *stated)
        return Judgement(previous, None, *stated)
    return Judgement(previous)


def limit_of(settings: Settings, view: View) -> float:
    """Logarithm of the limit of each quantity's e-detector, which grows with their number."""
    return float(np.log(settings.limit * max(np.isfinite(view.values).any(axis=0).sum(), 1)))


def evidence_of(view: View, settings: Settings, more: np.ndarray | None = None) -> tuple[Evidence, np.ndarray]:
    """Compute the evidence of a change over the last logs, and ``more`` (n, m) imagined ones; and the rows of these."""
    x = view.compared
    rows = np.flatnonzero(np.isfinite(x).any(axis=1))[-WINDOW:]
    learning = settings.baseline if view.baseline <= WINDOW else FEWEST
    rising = np.array([quantity.kind == RESIDUAL for quantity in view.quantities])
    variances = view.std[rows] ** 2
    return evidence(x[rows], variances, learning, rising), rows


def std_of_model(model: Result, view: View) -> np.ndarray:
    """Take the standard deviations (m,) of the identified gains, to which changes are relative."""
    gains = model.drive_gains
    relative = [
        (gains[quantity.joint].std or 0.0) / abs(gains[quantity.joint].value or 1.0)
        if quantity.kind == "gain" and quantity.joint in gains
        else 0.0
        for quantity in view.quantities
    ]
    return np.array(relative)


def _inside(view: View, alarm: Alarm) -> int | None:
    """Find the log since which all quantities of an alarm have been back for a week, None if they are not."""
    columns = [k for k, name in enumerate(view.names) if name in alarm.charts]
    order = [alarm.charts.index(view.names[k]) for k in columns]
    healthy, changed = (np.array(part)[order] for part in (alarm.healthy, alarm.changed))
    x = view.compared[:, columns]
    rows = np.flatnonzero(np.isfinite(x).any(axis=1))
    far = np.nanmax(np.where(np.isfinite(x[rows]), np.abs(x[rows] - healthy) / np.abs(changed - healthy), 0.0), axis=1)
    outside = np.flatnonzero(far > 0.5)
    back = rows[outside[-1] + 1 :] if len(outside) else rows
    if len(back) < FEWEST or not len(columns):
        return None
    days = view.table.days[back]
    return int(view.table.ids[back[0]]) if np.ptp(days) >= WEEK or (np.ptp(days) < 1 and len(back) >= WEEKLY) else None


def _run_beyond(view: View, columns: np.ndarray) -> tuple[int, int, int]:
    """Find the first of the last logs that are all beyond tolerance."""
    x = view.counted[:, columns] - view.reference[columns]
    rows = np.flatnonzero(np.isfinite(x).any(axis=1))
    within = np.flatnonzero(~(np.abs(x[rows]) > view.tolerance[columns]).any(axis=1))
    at = rows[min(int(within[-1]) + 1, len(rows) - 1) if len(within) else 0]
    return int(at), int(at), int(at)


def _alarm(
    kind: str,
    model: Result,
    view: View,
    log: LogStatistics,
    columns: np.ndarray,
    span: tuple[int, int, int],
    tolerances: Tolerances,
) -> Alarm:
    """Make an alarm of the quantities ``columns``, and explain it."""
    table, start = view.table, span[0]
    counted = np.isfinite(view.values if kind == "log" else view.counted).any(axis=1)
    rows = np.flatnonzero(counted)
    after, before = rows[rows >= start], rows[rows < start]
    if kind == "log":
        after, before = np.array([start]), np.flatnonzero(np.isfinite(view.counted).any(axis=1))
    x = view.values if kind == "log" else view.compared
    by_model = kind == "tolerance" or len(before) < FEWEST
    healthy = view.reference if by_model else _means(x[before])
    difference = Difference(
        table.values[before],
        table.values[after],
        np.zeros(table.values.shape[1]) if by_model else _means(table.values[before]),
        np.nanmax(table.uneven[before], axis=0, initial=1.0) if len(before) else np.ones(table.uneven.shape[1]),
    )
    names, changed = view.names, _means(x[after])
    columns = columns[np.isfinite(healthy[columns]) & np.isfinite(changed[columns])]
    return Alarm.model_validate(
        {
            "kind": kind,
            "explanations": causes_of(model, log, difference, tolerances.rated_payload),
            "since": table.logs[start],
            "earliest": table.logs[span[1]],
            "latest": table.logs[span[2]],
            "date": table.dates[start],
            "charts": tuple(names[k] for k in columns),
            "healthy": tuple(healthy[columns].tolist()),
            "changed": tuple(changed[columns].tolist()),
        }
    )


def _means(x: np.ndarray) -> np.ndarray:
    """Average logs (N, k) without those that are NaN."""
    there = np.isfinite(x)
    count = there.sum(axis=0)
    return np.where(count > 0, np.where(there, x, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan)
