"""Time series in a page: packed as base64 float32, thinned to envelopes, drawn by uPlot."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from gtau.report.html.elements import escape

BUCKETS = 2000  # of a run, each drawn by its extremes: more than the pixels of a wide screen
BUDGET = 450_000  # numbers in all series of a page: 2.4 MB once packed
COLOURS = 8  # of lines in the style sheet


@dataclass
class Arrays:
    """The arrays of a page by the key that charts refer to them with; equal arrays are packed once."""

    packed: dict[str, str] = field(default_factory=dict)
    keys: dict[str, str] = field(default_factory=dict)
    drawn: bool = False

    def put(self, values: np.ndarray) -> str:
        """Pack an array (K,) as float32; return the key it can be found by."""
        text = b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode("ascii")
        key = self.keys.setdefault(text, f"a{len(self.keys)}")
        self.packed[key] = text
        return key

    def script(self) -> str:
        """Write the markup that holds the arrays for the script of the page."""
        packed = json.dumps(self.packed, separators=(",", ":"))
        return f'<script type="application/json" class="arrays">{packed}</script>'


@dataclass(frozen=True)
class Line:
    """A line of a chart: ``colour`` is a variable of the style sheet, ``width`` in pixels."""

    label: str
    values: np.ndarray
    colour: str
    width: float = 1.0
    dash: tuple[int, ...] = ()


def buckets_for(series: int) -> int:
    """Divide the buckets of a page among so many series, for the page to stay small."""
    return int(np.clip(BUDGET // max(2 * series, 1), 100, BUCKETS))


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


def stretches(time: np.ndarray, masked: np.ndarray, shortest: float) -> np.ndarray:
    """List beginnings and ends, s, of the stretches where ``masked`` (K,) holds; join those close together."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], masked, [False]]).astype(np.int8)))
    starts, stops = time[edges[::2]], time[np.minimum(edges[1::2], len(time) - 1)]
    found: list[list[float]] = []
    for start, stop in zip(starts, stops, strict=True):
        if found and start - found[-1][1] < shortest:
            found[-1][1] = stop
        else:
            found.append([start, stop])
    return np.array(found, dtype=float).reshape(-1)


def chart(
    arrays: Arrays,
    time: np.ndarray,
    lines: Sequence[Line],
    unit: str,
    group: str,
    height: int = 150,
    masked: np.ndarray | None = None,
    xlabel: str = "time from the start of the run, s",
    last: bool = True,
    from_zero: bool = False,
) -> str:
    """Draw a chart of lines over ``time`` (K,).

    Charts of one ``group`` zoom together; only the ``last`` of them writes what the horizontal axis is. ``masked`` are
    stretches that are shaded, see :func:`stretches`.
    """
    arrays.drawn = True
    spec = {
        "x": arrays.put(time),
        "series": [
            {
                "label": each.label,
                "data": arrays.put(each.values),
                "colour": each.colour,
                "width": each.width,
                **({"dash": list(each.dash)} if each.dash else {}),
            }
            for each in lines
        ],
        "unit": unit,
        "group": group,
        "height": height,
        "last": last,
        "xlabel": xlabel,
        **({"masked": arrays.put(masked)} if masked is not None and masked.size else {}),
        **({"from": 0} if from_zero else {}),
    }
    what = ", ".join(each.label for each in lines)
    return (
        f'<div class="chart" role="img" aria-label="{escape(what)}, {escape(unit)}" '
        f'style="min-height:{height}px" data-chart="{escape(json.dumps(spec))}"></div>'
    )


def zoom_tools(group: str) -> str:
    """Make buttons that zoom and move the charts of a group."""
    buttons = (("whole", "Whole run"), ("in", "Zoom in"), ("out", "Zoom out"), ("back", "←"), ("on", "→"))
    shown = "".join(
        f'<button type="button" data-zoom="{name}" data-group="{escape(group)}">{label}</button>'
        for name, label in buttons
    )
    hint = "Drag to zoom, double-click for the whole run; two fingers on a touch screen."
    return f'<div class="tools">{shown}<span class="soft">{hint}</span></div>'


def key(entries: Iterable[tuple[str, str]]) -> str:
    """Draw a key: labels with their colours (a variable of the style sheet, or ``shade``)."""
    shown = "".join(
        f"<span><i{' class=shade' if colour == 'shade' else f' style=background:var(--{colour})'}></i>"
        f"{escape(label)}</span>"
        for label, colour in entries
    )
    return f'<div class="key">{shown}</div>'
