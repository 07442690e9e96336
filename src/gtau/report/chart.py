"""Charts and sketches as data; Matplotlib (:mod:`gtau.report.charts`), SVG and the script of a page draw them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

MINUS = "\N{MINUS SIGN}"
NOT_USED = "not used: near reversals, gaps, repairs"
BUCKETS = 600  # intervals into which a line is divided; the extremes in each are drawn
DASHES: tuple[tuple[float, ...], ...] = ((), (5, 1.6), (5, 1.4, 1, 1.4), (1, 1.3), (8, 2), (3, 1, 1, 1))
"""Dashes of lines in the colours c0, c1, ..., in line widths, so that lines differ in grey print too."""


@dataclass(frozen=True)
class Axis:
    """An axis: label with unit, scale, fixed limits if any, and names to write at values."""

    label: str
    log: bool = False
    limits: tuple[float | None, float | None] = (None, None)
    names: Mapping[float, str] = field(default_factory=dict)


TIME = Axis("time from the start of the run, s")


@dataclass(frozen=True, eq=False)
class Series:
    """A series of a panel: ``x`` and ``y`` (K,), a ``colour`` of the palette, and the way to draw it.

    ``half`` (K,) holds half-widths of intervals around discs and diamonds, along y if ``upright``, else along x. For
    ``steps``, ``x`` (K + 1,) holds edges; for ``spans``, ``x`` (K, 2) holds starts and ends, and ``y`` (1,) the height.
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
        """Lengths of strokes and gaps in line widths; empty for a solid line."""
        return DASHES[int(self.colour[1:]) % len(DASHES)] if self.colour[1:].isdigit() else ()

    def thinned(self) -> tuple[np.ndarray, np.ndarray]:
        """Return x and y of a line, thinned along time or frequency."""
        x, y = envelope(self.x, self.y[:, None], BUCKETS)
        return x, y.reshape(-1)


@dataclass(frozen=True)
class Rule:
    """A straight line across a panel at one ``x`` or one ``y``, with a label."""

    x: float | None = None
    y: float | None = None
    label: str = ""


@dataclass(frozen=True, eq=False)
class Panel:
    """A pair of axes with series.

    ``shaded`` holds starts and ends of excluded stretches of x (of live charts), ``band`` is a range of y, and
    ``matrix`` (m, m) holds values from -1 to 1, drawn in place of series. ``height`` is in inches.
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


@dataclass(frozen=True, eq=False)
class Chart:
    """Panels in ``columns`` with one key.

    A ``live`` chart holds time series over the same time, which readers of a page can zoom together.
    """

    panels: tuple[Panel, ...]
    title: str = ""
    live: bool = False
    columns: int = 1
    caption: str = ""

    @property
    def key(self) -> dict[str, Series]:
        """Series by label."""
        return {series.label: series for panel in self.panels for series in panel.series if series.label}


@dataclass(frozen=True, eq=False)
class Shape:
    """A line through ``points`` (K, 2), or an area if ``closed``; colours are names of the palette."""

    points: np.ndarray
    stroke: str
    width: float = 1.2
    closed: bool = False
    fill: str = ""
    opacity: float = 1.0


@dataclass(frozen=True, eq=False)
class Word:
    """Words whose ``side`` is at a ``place`` (2,), vertically centred."""

    text: str
    place: np.ndarray
    side: Literal["start", "middle", "end"] = "middle"
    colour: str = "ink"
    size: float = 7.5
    bold: bool = False


@dataclass(frozen=True, eq=False)
class Sketch:
    """Shapes and words on a sheet, in points, drawn in order; ``corner`` is the lower left one, y points up."""

    corner: np.ndarray
    size: np.ndarray
    items: tuple[Shape | Word, ...]


def colour(k: int) -> str:
    """Return the colour of the k-th line; the ninth repeats the first."""
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
    """Make a panel with one row per name: a value and the half-width of its 95 % interval, None if unknown.

    ``axis`` labels the horizontal axis, ``inner`` holds half-widths of the random parts, and ``other`` a label and
    values to compare with. ``zero`` marks zero.
    """
    rows = np.arange(len(names), dtype=float)
    columns = [[*column, *[None] * (len(names) - len(column))] for column in (values, halves, inner, other[1])]
    x, half, part, compared = np.array(columns, dtype=float).reshape(4, -1)
    known, given = np.isfinite(x), np.isfinite(compared)
    points = (x[known], rows[known], "predicted")
    series = [Series("value, 95 % interval", *points, "disc", half=np.nan_to_num(half[known]))]
    if np.isfinite(part).any():
        series.append(Series("random part", *points, "thick", half=np.nan_to_num(part[known])))
    if given.any():
        series.append(Series(other[0], compared[given], rows[given], "prior", "diamond"))
    places = Axis("", limits=(len(names) - 0.4, -0.6), names=dict(zip(rows.tolist(), names, strict=True)))
    rules, height = (Rule(x=0.0),) if zero else (), 0.62 + 0.27 * len(names)
    return Panel(Axis(axis), places, tuple(series), rules=rules, height=height)


def envelope(time: np.ndarray, values: np.ndarray, buckets: int) -> tuple[np.ndarray, np.ndarray]:
    """Reduce series (K, m) over ``time`` (K,) to the minimum and maximum in each of ``buckets`` intervals, in order.

    Returns two instants per bucket, (2 buckets,), which the series share, and their values (2 buckets, m); a short
    input is returned unchanged. NaN is skipped.
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
