"""Time series in a page: packed as base64 float32, thinned to envelopes, drawn by uPlot."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gtau.report.page import Chart, Item, Panel, Section

BUCKETS = 2000  # of a run, each drawn by its extremes: more than the pixels of a wide screen
BUDGET = 450_000  # numbers in all series of a page: 2.4 MB once packed
SHORTEST = 1e-3  # of the time: shaded stretches closer together are drawn as one
INCH = 96  # pixels


@dataclass
class Arrays:
    """The arrays of a page by the key that charts refer to them with; equal arrays are packed once."""

    buckets: int = BUCKETS
    keys: dict[str, str] = field(default_factory=dict)
    charts: int = 0

    def put(self, values: np.ndarray) -> str:
        """Pack an array (K,) as float32; return the key it can be found by."""
        text = b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode("ascii")
        return self.keys.setdefault(text, f"a{len(self.keys)}")

    @property
    def text(self) -> str:
        """The arrays as JSON."""
        return json.dumps({key: text for text, key in self.keys.items()}, separators=(",", ":"))


def arrays_for(items: tuple[Item, ...]) -> Arrays:
    """Divide the budget of a page among its series."""
    series = sum(len(panel.series) for chart in live_charts(items) for panel in chart.panels)
    return Arrays(int(np.clip(BUDGET // max(2 * series, 1), 100, BUCKETS)))


def live_charts(items: tuple[Item, ...]) -> Iterator[Chart]:
    """Yield the live charts of a page."""
    for item in items:
        if isinstance(item, Section):
            yield from live_charts(item.items)
        elif isinstance(item, Chart) and item.live:
            yield item


def spec_of(panel: Panel, arrays: Arrays, group: str, last: bool) -> dict[str, Any]:
    """Describe a panel for the script of the page, and pack its series."""
    time = panel.series[0].x
    thin_time, thin = envelope(time, np.column_stack([each.y for each in panel.series]), arrays.buckets)
    spec: dict[str, Any] = {
        "x": arrays.put(thin_time),
        "series": [
            {"label": each.label, "data": arrays.put(thin[:, k]), "colour": each.colour, "width": each.width}
            for k, each in enumerate(panel.series)
        ],
        "unit": panel.y.label,
        "group": group,
        "height": round(INCH * panel.height),
        "last": last,
        "xlabel": panel.x.label,
    }
    if panel.shaded is not None and panel.shaded.size:
        spec["masked"] = arrays.put(panel.shaded)
    if panel.y.limits[0] is not None:
        spec["from"] = panel.y.limits[0]
    return spec


def envelope(time: np.ndarray, values: np.ndarray, buckets: int) -> tuple[np.ndarray, np.ndarray]:
    """Thin series to the extremes of each bucket, in the order in which they occur.

    Parameters
    ----------
    time : ndarray
        (K,) instants.
    values : ndarray
        (K, m) series; NaN is left out.
    buckets : int
        Buckets of equal numbers of samples.

    Returns
    -------
    time, values : ndarray
        (2 buckets,) and (2 buckets, m): two instants a bucket, which all series share; the input itself where it is
        no longer than that.
    """
    samples, m = values.shape
    size = -(-samples // buckets)
    if size <= 2:
        return time, values
    count = -(-samples // size)
    padded = np.full((count * size, m), np.nan)
    padded[:samples] = values
    padded = padded.reshape(count, size, m)
    gaps = np.isnan(padded)
    low = np.where(gaps, np.inf, padded).argmin(axis=1)
    high = np.where(gaps, -np.inf, padded).argmax(axis=1)
    first, last = np.minimum(low, high), np.maximum(low, high)
    pairs = np.stack([np.take_along_axis(padded, at[:, None], axis=1)[:, 0] for at in (first, last)], axis=1)
    instants = np.full(count * size, time[-1])
    instants[:samples] = time
    instants = instants.reshape(count, size)
    shared = np.stack([instants[:, 0], instants[:, size // 2]], axis=1)
    return shared.reshape(-1), pairs.reshape(-1, m)


def stretches(time: np.ndarray, masked: np.ndarray) -> np.ndarray:
    """List beginnings and ends, s, (2 K,) of the stretches where ``masked`` (K,) holds; join those close together."""
    shortest = SHORTEST * float(time[-1] - time[0])
    edges = np.flatnonzero(np.diff(np.concatenate([[False], masked, [False]]).astype(np.int8)))
    starts, stops = time[edges[::2]], time[np.minimum(edges[1::2], len(time) - 1)]
    apart = np.concatenate([[True], starts[1:] - stops[:-1] >= shortest]) if len(starts) else np.zeros(0, bool)
    first = np.flatnonzero(apart)
    ends = stops[np.append(first[1:] - 1, len(stops) - 1)] if len(stops) else stops
    return np.column_stack([starts[first], ends]).reshape(-1).astype(float)
