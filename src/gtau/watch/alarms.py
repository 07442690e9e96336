"""Judge a robot after a log: beyond tolerance, changed, odd by itself, repaired or healthy."""

from __future__ import annotations

from typing import Any

import numpy as np

from gtau.estimation.results.result import Result
from gtau.robots.robot import PLAIN_FRICTION
from gtau.watch.causes import causes_of, contacts_of
from gtau.watch.detectors import FEWEST, WINDOW, ChangeEvidence, evidence, mean_of, median
from gtau.watch.history import Alarm, Explained
from gtau.watch.statistics import RESIDUAL, LogStatistics
from gtau.watch.table import WEEK, View, beyond, week_of

HEAVIEST = 100.0  # kg of a load, where the rated payload is not stated
SIZES = np.geomspace(0.5, 60.0, 25)  # changes of which the smallest visible is one, in standard deviations
PERIODS = (7, 30)  # days in which it is visible
MOST = 120  # last logs that the imagined ones follow
WEEKLY = 7  # logs that count as a week where they have one date


def judge(
    model: Result, view: View, log: LogStatistics, row: int, previous: Alarm | None
) -> tuple[Alarm | None, int | None]:
    """Judge the robot after the log in a ``row``, given the alarm before it.

    Return the alarm, None without one, and the row since which the robot is repaired, if it is.
    """
    if previous is not None and previous.kind == "log":
        previous = None
    if view.odd[row].any():
        return previous or _alarm("log", model, view, log, np.flatnonzero(view.odd[row]), row), None
    if previous is not None and len(back := _back(view, previous)):
        spent = np.ptp(view.logs.days[back])
        repaired = spent >= WEEK or (spent < 1 and len(back) >= WEEKLY)
        return (None, int(back[0])) if repaired else (previous, None)
    since = {} if previous is None else {"since": previous.since, "date": previous.date}
    changed, start = _changes(view)
    if (far := beyond(view, start)).any():
        x = np.abs(view.counted - view.reference)[:, far]
        rows = _last(x, ~(x > view.tolerance[far]).any(axis=1))
        first = int(rows[0]) if len(rows) else int(view.there[-1])
        alarm = _alarm("tolerance", model, view, log, np.flatnonzero(far), first)
        causes = alarm.explanations  # where none fits, it may be the motion
        if any(_is_beyond(view, cause, far) for cause in causes) or (not causes and beyond(view, start, 2.0).any()):
            return alarm.model_copy(update=since), None
    if len(changed):
        return _alarm("change", model, view, log, changed, start).model_copy(update=since), None
    return previous, None


def _is_beyond(view: View, cause: Explained, far: np.ndarray) -> bool:
    """Return whether a cause, or that beside it, is beyond tolerance, and so is its own quantity by ``far`` (m,)."""
    kind = "friction" if cause.quantity in PLAIN_FRICTION else cause.quantity
    size = np.inf if cause.kind == "units" else abs(cause.size if cause.relative is None else cause.relative)
    concerned = [cause.joint in ("", quantity.joint) for quantity in view.quantities] & view.of_kind(kind)
    second = cause.and_also is not None and _is_beyond(view, cause.and_also, far)
    return second or bool((concerned & far & (size > view.tolerance)).any())


def evidence_of(view: View) -> ChangeEvidence:
    """Compute the evidence of a change over the last logs."""
    rows = view.there[-WINDOW:]
    learning = view.settings.baseline if view.baseline <= WINDOW else FEWEST
    return evidence(view.compared[rows], view.std[rows] ** 2, learning, view.of_kind(RESIDUAL))


def _changes(view: View) -> tuple[np.ndarray, int]:
    """Find the quantities that have changed, the leading one first, and the first log of its change."""
    columns, start = np.zeros(0, dtype=int), 0
    if view.baseline > view.settings.baseline:
        proof = evidence_of(view)
        changed = (proof.log_e >= view.limit) & proof.confirmed
        columns = np.array([k for k in np.argsort(-proof.log_e) if changed[k]], dtype=int)
        if len(columns):
            start = int(view.there[-WINDOW:][proof.start[columns[0]]])
    return columns, start


def accepted(view: View, alarm: Alarm) -> dict[str, Any]:
    """Take what has changed as the new reference: the first log of an alarm, and the means by quantity since then."""
    first = view.logs.place(alarm)
    moved, means = evidence_of(view).log_e > 0, mean_of(view.counted[first:])
    changed = [k for k, name in enumerate(view.names) if moved[k] or name in alarm.charts]
    known = {view.names[k]: float(means[k]) for k in changed if np.isfinite(means[k])}
    return {"first": int(view.logs.ids[first]), "changed": known}


def _back(view: View, alarm: Alarm) -> np.ndarray:
    """Find the last logs whose quantities are all nearer to their healthy means than to those of an alarm."""
    healthy, changed = np.array(alarm.healthy), np.array(alarm.changed)
    x = view.compared[:, [view.names.index(name) for name in alarm.charts]]
    far = np.abs(x - healthy) / np.abs(changed - healthy) > 0.5
    return _last(x, far.any(axis=1))


def _last(x: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Find the last rows of ``x`` with a value, behind those that are ``other``."""
    rows = np.flatnonzero(np.isfinite(x).any(axis=1))
    return rows[len(rows) - int(np.argmax([*other[rows][::-1], True])) :]


def _alarm(kind: str, model: Result, view: View, log: LogStatistics, columns: np.ndarray, start: int) -> Alarm:
    """Make an alarm of the quantities ``columns`` since the row ``start``, and explain it."""
    logs, rows, x = view.logs, view.there, view.compared
    before, after = rows[rows < start], rows[rows >= start]
    if kind == "log":
        x, before, after = view.values, rows, np.array([start])
    by_model = kind == "tolerance" or len(before) < FEWEST
    healthy, changed = view.reference if by_model else mean_of(x[before]), mean_of(x[after])
    columns = columns[np.isfinite(healthy[columns]) & np.isfinite(changed[columns])]
    causes: tuple[Explained, ...] = ()
    if not view.of_kind(RESIDUAL)[columns].all():
        of_charts = np.zeros(logs.charts.shape[1]) if by_model else mean_of(logs.charts[before])
        rated = view.settings.tolerances.rated_payload
        heaviest = 2 * rated if rated else HEAVIEST
        causes = causes_of(model, log, logs.charts[before], logs.charts[after], of_charts, heaviest)
    return Alarm(
        kind=kind,  # type: ignore[arg-type]  # pydantic checks it
        explanations=causes or contacts_of(log, np.nanmax(logs.uneven[before], axis=0, initial=1.0)),
        since=logs.names[start],
        date=logs.dates[start],
        charts=tuple(view.names[k] for k in columns),
        healthy=tuple(healthy[columns].tolist()),
        changed=tuple(changed[columns].tolist()),
    )


def visible_changes(view: View) -> np.ndarray:
    """Compute the smallest sudden change of each quantity (m, 2) found within a week and a month, NaN where none is.

    The last logs are followed by as many as such a period brings, with the same scatter about the changed mean, and
    judged by the detector and by the tolerance.
    """
    rows = view.there[-MOST:]
    x, std = view.compared[rows], view.std[rows]
    if len(rows) < FEWEST:
        return np.full((x.shape[1], len(PERIODS)), np.nan)
    scale = 1.4826 * median(np.abs(x - median(x)))
    _, half = week_of(view)
    smallest = np.tile((view.tolerance + np.nan_to_num(half, nan=np.inf))[:, None], len(PERIODS))
    columns = np.flatnonzero(scale > 0)
    sizes = np.outer(scale[columns], SIZES)
    before, white = (np.repeat(part[:, columns], len(SIZES), axis=1) for part in (x, std))
    for p, days in enumerate(PERIODS):
        logs = int(np.clip(round(days * view.settings.logs_per_year / 365), 2, WINDOW // 2))
        after = np.resize(before[-logs:], (logs, before.shape[1])) + sizes.ravel()
        values = np.vstack([before, after])
        proof = evidence(values, np.resize(white, values.shape) ** 2, FEWEST)
        found = ((proof.log_e >= view.limit) & proof.confirmed).reshape(sizes.shape)
        change = np.where(found, sizes, np.inf).min(axis=1)
        smallest[columns, p] = np.minimum(smallest[columns, p], change)
    return np.where(np.isfinite(smallest), smallest, np.nan)
