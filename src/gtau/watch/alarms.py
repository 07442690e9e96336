"""Derive an alarm from the evidence of the charts: its onset and the explanations that fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gtau.estimation.results.identified_model import IdentifiedModel
from gtau.watch.baseline import FEWEST, covariance_between
from gtau.watch.detectors import Chart, Evidence
from gtau.watch.explanations import Change, Explanation, Healthy, explain
from gtau.watch.state import Alarm, Entry, Explained
from gtau.watch.statistics import RESIDUAL, LogStatistics

LISTED = 5  # charts that changed most


def alarm_of(
    model: IdentifiedModel,
    entries: Sequence[Entry],
    charts: Mapping[str, Chart],
    evidences: Mapping[str, Evidence],
    log: LogStatistics,
    uneven: Mapping[str, float],
) -> Alarm:
    """Explain the change indicated by the charts.

    Parameters
    ----------
    model : IdentifiedModel
        Of the robot.
    entries : sequence of Entry
        Last logs, the newest one last.
    charts, evidences : mapping
        By name.
    log : LogStatistics
        Statistics of the newest log.
    uneven : mapping
        Joint to the largest unevenness of its residual in healthy logs.
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
    found, logs = _explanations(table[:start], table[start:], log, uneven)
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


def _explanations(
    before: np.ndarray, after: np.ndarray, log: LogStatistics, uneven: Mapping[str, float]
) -> tuple[tuple[Explanation, ...], int]:
    """Explain the difference of the charts (logs, k) before and after, with the number of logs behind the scatter."""
    enough = (np.isfinite(before).sum(axis=0) >= FEWEST) & np.isfinite(after).any(axis=0) & log.shown
    kept = np.flatnonzero(enough)
    whole = before[:, kept][np.isfinite(before[:, kept]).all(axis=1)]
    if not len(kept) or len(whole) < 2:
        return (), len(whole)
    covariance = covariance_between(whole, log.formula[np.ix_(kept, kept)], np.sqrt(np.diag(log.formula))[kept])
    difference = np.nanmean(after[:, kept], axis=0) - np.nanmean(before[:, kept], axis=0)
    latest = log.values[kept] - np.nanmean(before[:, kept], axis=0)
    rms = {
        chart.joint: float(np.nanmean(before[:, k])) if np.isfinite(before[:, k]).any() else 0.0
        for k, chart in enumerate(log.charts)
        if chart.kind == RESIDUAL
    }
    healthy = Healthy(
        np.array([uneven.get(joint, 1.0) for joint in log.joints]), np.array([rms[joint] for joint in log.joints])
    )
    return explain(Change(difference, latest, covariance, len(whole), len(after)), log, kept, healthy), len(whole)


def _stated(each: Explanation, model: IdentifiedModel, factor: float) -> Explained:
    """State an explanation with its interval, and its share of the model's friction."""
    relative = None
    if each.kind == "friction":
        friction = model.friction_parameters
        known = {**model.parameters, **friction}.get(f"{each.quantity}_{each.joint}")
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
