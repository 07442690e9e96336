"""Judge a robot after a log: beyond tolerance, changed, odd by itself, repaired or healthy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gtau.estimation.results.result import Result
from gtau.signals.reading.statements import Tolerances
from gtau.watch.causes import causes_of, contacts_of
from gtau.watch.detectors import FEWEST, WINDOW, ChangeEvidence, evidence, mean_of, median
from gtau.watch.history import Alarm, Explained, WatchSettings
from gtau.watch.statistics import RESIDUAL, LogStatistics
from gtau.watch.table import WEEK, View, beyond, week_of

HEAVIEST = 100.0  # kg of a load, where the rated payload is not stated
SIZES = np.geomspace(0.5, 60.0, 25)  # changes of which the smallest visible is one, in standard deviations
PERIODS = (7, 30)  # days in which it is visible
MOST = 120  # last logs that the imagined ones follow
WEEKLY = 7  # logs that count as a week where they have one date


def judge(
    model: Result, settings: WatchSettings, view: View, log: LogStatistics, row: int, previous: Alarm | None
) -> tuple[Alarm | None, int | None]:
    """Judge the robot after the log in a ``row``, given the alarm before it.

    Return the alarm, None without one, and the number of the log since which the robot is repaired, if it is.
    """

    def alarm_of(kind: str, columns: np.ndarray, start: int) -> Alarm:
        alarm = _alarm(kind, model, settings, view, log, columns, start)
        since = {} if previous is None else {"since": previous.since, "date": previous.date}
        return alarm.model_copy(update=since)

    if previous is not None and previous.kind == "log":
        previous = None
    if view.odd[row].any():
        return previous or alarm_of("log", np.flatnonzero(view.odd[row]), row), None
    if previous is not None and len(back := _back(view, previous)):
        spent = np.ptp(view.days[back])
        repaired = spent >= WEEK or (spent < 1 and len(back) >= WEEKLY)
        return (None, int(view.ids[back[0]])) if repaired else (previous, None)
    changed, start = _changes(settings, view)
    week = week_of(view, std_of_model(model, view), start)
    far = np.flatnonzero(beyond(view, week))
    if len(far):
        alarm = alarm_of("tolerance", far, _run_beyond(view, far))
        twice = beyond(replace(view, tolerance=2 * view.tolerance), week)  # where no cause fits, it may be the motion
        if any(_is_beyond(view, cause, far) for cause in alarm.explanations) or (
            not alarm.explanations and twice.any()
        ):
            return alarm, None
    return alarm_of("change", changed, start) if len(changed) else previous, None


def _is_beyond(view: View, cause: Explained, far: np.ndarray) -> bool:
    """Return whether a cause, or that beside it, is beyond tolerance, and so is its own quantity among ``far`` (m,)."""
    kind = {"load": cause.quantity, "clock": "delay", "warming": "friction", "units": "gain"}.get(
        cause.kind, cause.kind
    )
    size = np.inf if cause.kind == "units" else abs(cause.size if cause.relative is None else cause.relative)
    concerned = [view.quantities[k] for k in far if size > view.tolerance[k]]
    if any(quantity.kind == kind and cause.joint in ("", quantity.joint) for quantity in concerned):
        return True
    return cause.and_also is not None and _is_beyond(view, cause.and_also, far)


def _changes(settings: WatchSettings, view: View) -> tuple[np.ndarray, int]:
    """Find the quantities that have changed, the leading one first, and the first log of its change."""
    if view.baseline > settings.baseline:
        proof, rows = evidence_of(view, settings)
        columns = np.flatnonzero((proof.log_e >= limit_of(settings, view)) & proof.confirmed)
        if len(columns):
            columns = columns[np.argsort(-proof.log_e[columns])]
            return columns, int(rows[proof.start[columns[0]]])
    return np.zeros(0, dtype=int), 0


def limit_of(settings: WatchSettings, view: View) -> float:
    """Logarithm of the limit of each quantity's e-detector, which grows with their number."""
    return float(np.log(settings.limit * max(np.isfinite(view.values).any(axis=0).sum(), 1)))


def evidence_of(view: View, settings: WatchSettings) -> tuple[ChangeEvidence, np.ndarray]:
    """Compute the evidence of a change over the last logs, and list the rows of these."""
    x = view.compared
    rows = np.flatnonzero(np.isfinite(x).any(axis=1))[-WINDOW:]
    learning = settings.baseline if view.baseline <= WINDOW else FEWEST
    return evidence(x[rows], view.std[rows] ** 2, learning, view.of_kind(RESIDUAL)), rows


def std_of_model(model: Result, view: View) -> np.ndarray:
    """Take the standard deviations (m,) of the identified gains, to which changes are relative."""
    known = [model.drive_gains.get(quantity.joint) if quantity.kind == "gain" else None for quantity in view.quantities]
    return np.array([(gain.std or 0.0) / abs(gain.value or 1.0) if gain else 0.0 for gain in known])


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
    kind: str, model: Result, settings: WatchSettings, view: View, log: LogStatistics, columns: np.ndarray, start: int
) -> Alarm:
    """Make an alarm of the quantities ``columns`` since the row ``start``, and explain it."""
    x, rows = view.compared, np.flatnonzero(np.isfinite(view.counted).any(axis=1))
    after, before = rows[rows >= start], rows[rows < start]
    if kind == "log":
        x, after, before = view.values, np.array([start]), rows
    by_model = kind == "tolerance" or len(before) < FEWEST
    healthy, changed = view.reference if by_model else mean_of(x[before]), mean_of(x[after])
    of_charts = np.zeros(view.charts.shape[1]) if by_model else mean_of(view.charts[before])
    uneven = np.nanmax(view.uneven[before], axis=0, initial=1.0)
    columns = columns[np.isfinite(healthy[columns]) & np.isfinite(changed[columns])]
    rated = Tolerances.model_validate(settings.tolerances).rated_payload
    causes: tuple[Explained, ...] = ()
    if not view.of_kind(RESIDUAL)[columns].all():
        heaviest = 2 * rated if rated else HEAVIEST
        causes = causes_of(model, log, view.charts[before], view.charts[after], of_charts, heaviest)
    return Alarm(
        kind=kind,  # type: ignore[arg-type]  # pydantic checks it
        explanations=causes or contacts_of(log, uneven),
        since=view.logs[start],
        date=view.dates[start],
        charts=tuple(view.names[k] for k in columns),
        healthy=tuple(healthy[columns].tolist()),
        changed=tuple(changed[columns].tolist()),
    )


def visible_changes(model: Result, settings: WatchSettings, view: View) -> np.ndarray:
    """Compute the smallest sudden change of each quantity (m, 2) found within a week and a month, NaN where none is.

    The last logs are followed by as many as such a period brings, with the same scatter about the changed mean, and
    judged by the detector and by the tolerance.
    """
    rows = np.flatnonzero(np.isfinite(view.compared).any(axis=1))[-MOST:]
    x, std = view.compared[rows], view.std[rows]
    smallest = np.full((x.shape[1], len(PERIODS)), np.inf)
    if len(rows) < FEWEST:
        return np.full(smallest.shape, np.nan)
    scale = 1.4826 * median(np.abs(x - median(x)))
    _, half = week_of(view, std_of_model(model, view))
    smallest[:, :] = (view.tolerance + np.nan_to_num(half, nan=np.inf))[:, None]
    limit = limit_of(settings, view)
    columns = np.flatnonzero(np.isfinite(scale) & (scale > 0))
    before = np.repeat(x[:, columns], len(SIZES), axis=1)
    sizes = np.outer(scale[columns], SIZES).ravel()
    for p, days in enumerate(PERIODS):
        logs = int(np.clip(round(days * settings.logs_per_year / 365), 2, WINDOW // 2))
        values = np.vstack([before, np.resize(before[-logs:], (logs, before.shape[1])) + sizes])
        variances = np.resize(np.repeat(std[:, columns], len(SIZES), axis=1), values.shape) ** 2
        proof = evidence(values, variances, FEWEST)
        found = ((proof.log_e >= limit) & proof.confirmed).reshape(len(columns), len(SIZES))
        change = np.where(found, sizes.reshape(found.shape), np.inf).min(axis=1)
        smallest[columns, p] = np.minimum(smallest[columns, p], change)
    return np.where(np.isfinite(smallest), smallest, np.nan)
