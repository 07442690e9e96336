"""Charts and sketches as data: what is drawn in which colour; :mod:`gtau.report.render` draws them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

MINUS = "\N{MINUS SIGN}"
BUCKETS = 600  # of a line, each drawn by its extremes
DASHES: tuple[tuple[float, ...], ...] = ((), (5, 1.6), (5, 1.4, 1, 1.4), (1, 1.3), (8, 2), (3, 1, 1, 1))
"""How lines of the colours c0, c1, ... are dashed, in widths of the line, so that they differ in grey too."""


@dataclass(frozen=True)
class Axis:
    """An axis: label with unit, whether logarithmic, its limits where they are fixed, and names at values."""

    label: str
    log: bool = False
    limits: tuple[float | None, float | None] = (None, None)
    names: Mapping[float, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Series:
    """A series of a panel: ``x`` and ``y`` (K,), a ``colour`` of the palette, and how it is drawn.

    ``half`` (K,) are half the widths of intervals of discs and diamonds, along x, or y where ``upright``. Of ``steps``,
    ``x`` (K + 1,) are edges; of ``spans``, ``x`` (K, 2) are beginnings and ends, and ``y`` (1,) is their height.
    """

    label: str
    x: np.ndarray
    y: np.ndarray
    colour: str = "predicted"
    mark: Literal["line", "points", "disc", "diamond", "thick", "steps", "spans"] = "line"
    width: float = 1.3
    half: np.ndarray | None = None
    upright: bool = False

    @property
    def dashes(self) -> tuple[float, ...]:
        """Strokes and gaps of a line, in its widths; none of a solid one."""
        return DASHES[int(self.colour[1:]) % len(DASHES)] if self.colour[1:].isdigit() else ()

    def thinned(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the points (K,) and (K,) of a line, thinned along time or frequency, not along a path."""
        if not np.all(np.diff(self.x) >= 0):
            return self.x, self.y
        x, y = envelope(self.x, self.y[:, None], BUCKETS)
        return x, y.reshape(-1)


@dataclass(frozen=True)
class Rule:
    """A straight line across a panel at one ``x`` or one ``y``, with its label."""

    x: float | None = None
    y: float | None = None
    label: str = ""


@dataclass(frozen=True, eq=False)
class Panel:
    """A pair of axes with series.

    ``shaded`` are beginnings and ends along x that are left out, ``band`` a range of y, ``matrix`` (m, m) values from
    -1 to 1 in place of series, ``height`` in inches, and ``equal`` whether both axes have the same scale.
    """

    x: Axis
    y: Axis
    series: tuple[Series, ...] = ()
    title: str = ""
    rules: tuple[Rule, ...] = ()
    band: tuple[float, float] | None = None
    shaded: np.ndarray | None = None
    matrix: np.ndarray | None = None
    height: float = 1.6
    equal: bool = False


@dataclass(frozen=True, eq=False)
class Chart:
    """Panels below or beside each other with one key.

    The panels of a ``live`` chart are time series over one time: a page lets them zoom together.
    """

    panels: tuple[Panel, ...]
    title: str = ""
    live: bool = False
    columns: int = 1
    caption: str = ""

    @property
    def key(self) -> dict[str, Series]:
        """Series by label, each once; those of a single unnamed one have no key."""
        return {series.label: series for panel in self.panels for series in panel.series if series.label}


@dataclass(frozen=True, eq=False)
class Shape:
    """A line through ``points`` (K, 2), or an area where it is ``closed``; colours are names of the palette."""

    points: np.ndarray
    stroke: str
    width: float = 1.2
    closed: bool = False
    fill: str = ""
    opacity: float = 1.0


@dataclass(frozen=True, eq=False)
class Word:
    """Words at a place (2,), which is at their ``side`` and at their middle height."""

    text: str
    place: np.ndarray
    side: Literal["start", "middle", "end"] = "middle"
    colour: str = "ink"
    size: float = 7.5
    bold: bool = False


@dataclass(frozen=True, eq=False)
class Sketch:
    """What is drawn on a sheet, points, the later above the earlier; ``corner`` is its lower left, y points up."""

    corner: np.ndarray
    size: np.ndarray
    items: tuple[Shape | Word, ...]


def colour(k: int) -> str:
    """Choose the colour of the k-th line; a ninth begins again."""
    return f"c{k % 8}"


def intervals(
    names: Sequence[str],
    values: Sequence[float | None],
    halves: Sequence[float | None],
    axis: str,
    inner: Sequence[float | None] = (),
    other: tuple[str, Sequence[float | None]] = ("", ()),
    zero: bool = False,
) -> Panel:
    """Make a panel with a row for each name: a value and half the width of its 95 % interval, None where there is none.

    ``axis`` is the label of the horizontal axis, with unit; ``inner`` are half the widths of the random parts, and
    ``other`` what the values are compared with, and its values. Zero is marked where asked for.
    """
    rows = np.arange(len(names), dtype=float)
    columns = [[*column, *[None] * (len(names) - len(column))] for column in (values, halves, inner, other[1])]
    x, half, part, compared = np.array(columns, dtype=float).reshape(4, -1)
    shown, there = np.isfinite(x), np.isfinite(compared)
    drawn = (x[shown], rows[shown], "predicted")
    series = [Series("value, 95 % interval", *drawn, "disc", half=np.nan_to_num(half[shown]))]
    if np.isfinite(part).any():
        series.append(Series("random part", *drawn, "thick", half=np.nan_to_num(part[shown])))
    if there.any():
        series.append(Series(other[0], compared[there], rows[there], "prior", "diamond", half=np.zeros(there.sum())))
    places = Axis("", limits=(len(names) - 0.4, -0.6), names=dict(zip(rows.tolist(), names, strict=True)))
    rules, height = (Rule(x=0.0),) if zero else (), 0.62 + 0.27 * len(names)
    return Panel(Axis(axis), places, tuple(series), rules=rules, height=height)


def envelope(time: np.ndarray, values: np.ndarray, buckets: int) -> tuple[np.ndarray, np.ndarray]:
    """Thin series (K, m) over ``time`` (K,) to the extremes of each bucket, in the order in which they occur.

    Returns two instants a bucket, which all series share, (2 buckets,), and (2 buckets, m); the input itself where it
    is no longer than that. NaN is left out.
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
