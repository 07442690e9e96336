"""The smallest changes that the logs of a watched robot would show."""

from __future__ import annotations

import numpy as np

from gtau.watch.alarms import limit_of, std_of_model
from gtau.watch.detectors import FEWEST, WINDOW, evidence, median
from gtau.watch.table import week_of
from gtau.watch.watch import Watch

SIZES = np.geomspace(0.5, 60.0, 25)  # tried changes, in standard deviations between logs
PERIODS = (7, 30)  # days
MOST = 120  # last logs that the imagined ones follow


def visible_changes(watch: Watch) -> np.ndarray:
    """Compute the smallest sudden change of each quantity (m, 2) found within a week and a month, NaN where none is.

    The last logs are followed by as many as such a period brings, with the healthy scatter of the last ones about the
    changed mean, and judged by the detector and by the tolerance.
    """
    view, settings = watch.view, watch.settings
    rows = np.flatnonzero(np.isfinite(view.compared).any(axis=1))[-MOST:]
    x, std = view.compared[rows], view.std[rows]
    smallest = np.full((x.shape[1], len(PERIODS)), np.inf)
    if len(rows) < FEWEST:
        return np.full(smallest.shape, np.nan)
    scale = 1.4826 * median(np.abs(x - median(x)))
    _, half = week_of(view, std_of_model(watch.model, view))
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
