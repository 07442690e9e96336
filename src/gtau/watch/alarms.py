"""Judge a robot after a log: beyond tolerance, changed, odd by itself, repaired or healthy."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gtau.estimation.results.result import Result
from gtau.signals.reading.statements import Tolerances
from gtau.watch.causes import Difference, causes_of
from gtau.watch.detectors import FEWEST, WINDOW, Evidence, evidence
from gtau.watch.history import Alarm, Explained, Settings
from gtau.watch.statistics import RESIDUAL, LogStatistics
from gtau.watch.table import WEEK, View, beyond, week_of

WEEKLY = 7  # logs that count as a week where they have one date


@dataclass(frozen=True, eq=False)
class Judgement:
    """The alarm after a log, None without one, and from which log on the robot is repaired, if it is."""

    alarm: Alarm | None
    repaired: int | None = None


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
    if previous is not None and len(back := _back(view, previous)):
        days = view.table.days[back]
        week = np.ptp(days) >= WEEK or (np.ptp(days) < 1 and len(back) >= WEEKLY)
        return Judgement(None, int(view.table.ids[back[0]])) if week else Judgement(previous)
    changed, span = _changes(settings, view)
    week = week_of(view, std_of_model(model, view), span[0])
    far = np.flatnonzero(beyond(view, week))
    twice = beyond(replace(view, tolerance=2 * view.tolerance), week)  # where no cause fits, it may be the motion
    if len(far):
        alarm = _alarm("tolerance", model, view, log, far, (_run_beyond(view, far),) * 3, tolerances)
        if any(_is_beyond(view, cause) for cause in alarm.explanations) or (not alarm.explanations and twice.any()):
            return Judgement(_since(alarm, previous))
    if len(changed):
        alarm = _alarm("change", model, view, log, changed, span, tolerances)
        return Judgement(_since(alarm, previous))
    return Judgement(previous)


def _since(alarm: Alarm, previous: Alarm | None) -> Alarm:
    """Date an alarm that goes on from its beginning."""
    if previous is None:
        return alarm
    return alarm.model_copy(update={name: getattr(previous, name) for name in ("since", "earliest", "latest", "date")})


def _is_beyond(view: View, cause: Explained) -> bool:
    """Return whether a cause, or that beside it, is beyond its tolerance: one quantity alone may follow another."""
    kind = {"load": cause.quantity, "clock": "delay", "warming": "friction"}.get(cause.kind, cause.kind)
    limits = [
        view.tolerance[k]
        for k, quantity in enumerate(view.quantities)
        if quantity.kind == kind and cause.joint in ("", quantity.joint)
    ]
    size = cause.size if cause.relative is None else cause.relative
    far = cause.kind == "units" or abs(size) > min(limits, default=np.inf)
    return far or (cause.and_also is not None and _is_beyond(view, cause.and_also))


def _changes(settings: Settings, view: View) -> tuple[np.ndarray, tuple[int, int, int]]:
    """Find the quantities that have changed, and the first log of the leading change with its interval."""
    if view.baseline > settings.baseline:
        proof, rows = evidence_of(view, settings)
        columns = np.flatnonzero((proof.log_e >= limit_of(settings, view)) & proof.confirmed)
        if len(columns):
            columns = columns[np.argsort(-proof.log_e[columns])]
            start, *ends = (int(rows[part[columns[0]]]) for part in (proof.start, proof.earliest, proof.latest))
            return columns, (start, ends[0], ends[1])
    return np.zeros(0, dtype=int), (0, 0, 0)


def limit_of(settings: Settings, view: View) -> float:
    """Logarithm of the limit of each quantity's e-detector, which grows with their number."""
    return float(np.log(settings.limit * max(np.isfinite(view.values).any(axis=0).sum(), 1)))


def evidence_of(view: View, settings: Settings) -> tuple[Evidence, np.ndarray]:
    """Compute the evidence of a change over the last logs, and list the rows of these."""
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


def _back(view: View, alarm: Alarm) -> np.ndarray:
    """Find the last logs whose quantities are all nearer to their healthy means than to those of an alarm."""
    columns = [view.names.index(name) for name in alarm.charts]
    healthy, changed = np.array(alarm.healthy), np.array(alarm.changed)
    x = view.compared[:, columns]
    rows = np.flatnonzero(np.isfinite(x).any(axis=1))
    if not len(rows):
        return rows
    far = np.abs(x[rows] - healthy) / np.abs(changed - healthy) > 0.5
    outside = np.flatnonzero(far.any(axis=1))
    return rows[outside[-1] + 1 :] if len(outside) else rows


def _run_beyond(view: View, columns: np.ndarray) -> int:
    """Find the first of the last logs that are all beyond tolerance."""
    x = view.counted[:, columns] - view.reference[columns]
    rows = np.flatnonzero(np.isfinite(x).any(axis=1))
    within = np.flatnonzero(~(np.abs(x[rows]) > view.tolerance[columns]).any(axis=1))
    return int(rows[min(int(within[-1]) + 1, len(rows) - 1) if len(within) else 0])


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
    healthy = view.reference if by_model else means_of(x[before])
    difference = Difference(
        table.values[before],
        table.values[after],
        np.zeros(table.values.shape[1]) if by_model else means_of(table.values[before]),
        np.nanmax(table.uneven[before], axis=0, initial=1.0) if len(before) else np.ones(table.uneven.shape[1]),
    )
    names, changed = view.names, means_of(x[after])
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


def means_of(x: np.ndarray) -> np.ndarray:
    """Average logs (N, k) without those that are NaN."""
    there = np.isfinite(x)
    count = there.sum(axis=0)
    return np.where(count > 0, np.where(there, x, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan)
