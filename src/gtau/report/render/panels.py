"""Panels as sketches: axes, round ticks and series laid out on a sheet; Matplotlib takes longer to be imported."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil, floor, log10

import numpy as np

from gtau.report.chart import Axis, Panel, Series
from gtau.report.render.sketch import Item, Mark, Path, Sketch, Word

MINUS = "\N{MINUS SIGN}"
INCH = 72.0  # points
NARROW, WIDE = 3.3, 4.5  # inches, of panels beside each other on a page, and of one alone
NAMES = 220.0  # points, that the names at an axis share
TEXT = 7.5  # points
BUCKETS = 600  # of a line, each drawn by its extremes
DASHES: tuple[tuple[float, ...], ...] = ((), (5, 1.6), (5, 1.4, 1, 1.4), (1, 1.3), (8, 2), (3, 1, 1, 1))
"""How lines of the colours c0, c1, ... are dashed, in widths of the line, so that they differ in grey too."""
STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)  # of a decade, between ticks
SHADES = 10  # of the two colours of a matrix


@dataclass(frozen=True)
class Scale:
    """An axis laid out: its range of values, the range on the sheet, points, and whether it is logarithmic."""

    low: float
    high: float
    start: float
    stop: float
    log: bool

    def __call__(self, values: np.ndarray | float) -> np.ndarray:
        """Map values to the sheet; what has no place on it, such as zero on a logarithmic axis, is NaN."""
        with np.errstate(divide="ignore", invalid="ignore"):
            at, low, high = (
                np.log(each) if self.log else np.asarray(each, dtype=float) for each in (values, self.low, self.high)
            )
            return np.asarray(self.start + (at - low) / (high - low) * (self.stop - self.start))


def sketch_of(panel: Panel, alone: bool = False) -> Sketch:
    """Lay out a panel on a sheet: one ``alone`` is wider than those beside each other."""
    width = INCH * (WIDE if alone else NARROW)
    inches = 0.8 * width / INCH if panel.equal else panel.height if panel.matrix is None else width / INCH
    height = INCH * inches
    longest = max((len(name) for name in panel.y.names.values()), default=0)
    left = min((3.75 if alone else 4.3) * longest + 7.0, 0.45 * width) if longest else 40.0
    bottom, right, top = (left if panel.x.names else 26.0), width - 8.6, height - 5.8
    if panel.matrix is not None:
        side = min(right - left, top - bottom)
        right, bottom = left + side, top - side
    spans = [_span(panel, axis, which) for which, axis in enumerate((panel.x, panel.y))]
    if panel.equal:
        spans = _equal(spans, right - left, top - bottom)
    x = Scale(*spans[0], left, right, panel.x.log)
    y = Scale(*spans[1], bottom, top, panel.y.log)
    inside = [item for part in (_ground(panel, x, y), *(_series(each, x, y) for each in panel.series)) for item in part]
    return Sketch((width, height), tuple(_frame(panel, x, y)), tuple(inside), (left, bottom, right, top))


def _span(panel: Panel, axis: Axis, which: int) -> tuple[float, float]:
    """Return the ends of an axis, 0 for x or 1 for y: its limits, or the values on it with a margin beside marks."""
    if panel.matrix is not None:
        ends = (-0.5, len(panel.matrix) - 0.5)
        return ends if which == 0 else ends[::-1]
    parts = [_extent(each, which) for each in panel.series]
    rules = (rule.y if which else rule.x for rule in panel.rules)
    parts += [np.array([rule]) for rule in rules if rule is not None]
    parts += [np.array(panel.band)] if which and panel.band is not None else []
    parts += [panel.shaded.reshape(-1)] if not which and panel.shaded is not None else []
    values = np.concatenate([np.asarray(part, dtype=float).reshape(-1) for part in parts] or [np.zeros(0)])
    values = values[np.isfinite(values) & ((values > 0) if axis.log else True)]
    low, high = (float(values.min()), float(values.max())) if len(values) else (1.0, 10.0) if axis.log else (0.0, 1.0)
    marks = {each.mark for each in panel.series}
    margin = (
        (0.0, 0.05)
        if marks <= {"line", "steps", "spans"}
        else (0.03, 0.05)
        if marks <= {"line", "points"}
        else (0.06, 0.1)
    )
    if axis.log:
        spare = (high / low) ** margin[which] if high > low else 2.0
        found = (low / spare, high * spare)
    else:
        spare = margin[which] * (high - low) if high > low else 0.05 * abs(high) or 0.5
        base = which and marks == {"steps"} and low == 0.0  # bars stand on the axis
        found = (low if base else low - spare, high + spare)
    fixed = [given if given is not None else end for given, end in zip(axis.limits, found, strict=True)]
    return fixed[0], fixed[1]


def _extent(series: Series, which: int) -> np.ndarray:
    """Return the values of a series along x (0) or y (1), with its intervals."""
    values = series.y if which else series.x
    if which and series.mark in ("steps", "spans"):
        return np.append(values, 0.0) if series.mark == "steps" else np.array([values[0] - 0.35, values[0] + 0.35])
    if series.half is None or bool(which) != series.upright:
        return values
    return np.concatenate([values - series.half, values + series.half])


def _equal(spans: list[tuple[float, float]], width: float, height: float) -> list[tuple[float, float]]:
    """Widen one of two ranges until a unit is as long on both axes."""
    unit = max((spans[0][1] - spans[0][0]) / width, (spans[1][1] - spans[1][0]) / height)
    middles = [(low + high) / 2 for low, high in spans]
    return [
        (middle - unit * size / 2, middle + unit * size / 2)
        for middle, size in zip(middles, (width, height), strict=True)
    ]


def ticks(low: float, high: float, most: int = 6) -> list[float]:
    """List round numbers between two others, at most ``most`` intervals apart."""
    if not high > low:
        return [low]
    decade = 10.0 ** floor(log10((high - low) / most))
    step = next(each * decade for each in (*STEPS, 20.0) if (high - low) / (each * decade) <= most * (1 + 1e-9))
    return [k * step for k in range(ceil(low / step - 1e-9), floor(high / step + 1e-9) + 1)]


def _ticks(scale: Scale) -> list[tuple[float, str]]:
    """List the ticks of an axis and what is written there."""
    low, high = sorted((scale.low, scale.high))
    if scale.log:
        first, last = ceil(log10(low) - 1e-9), floor(log10(high) + 1e-9)
        if last > first:
            every = -(-(last - first + 1) // 6)
            found = [10.0**k for k in range(first, last + 1, every)]
        else:
            found = ticks(low, high, 3)
        return [(each, _number(f"{each:g}")) for each in found]
    found = ticks(low, high)
    step = found[1] - found[0] if len(found) > 1 else 1.0
    decimals = next((k for k in range(7) if abs(round(step, k) - step) < 1e-6 * step), None)
    if decimals is None or max(map(abs, found)) >= 1e6:
        return [(each, _number(f"{0.0 if abs(each) < 1e-9 * step else each:.4g}")) for each in found]
    return [(each, _number(f"{each + 0.0:.{decimals}f}")) for each in found]


def _number(text: str) -> str:
    text = text.replace("e-0", "e-").replace("e+0", "e")
    return text.lstrip("-") if not text.strip("-0.") else text.replace("-", MINUS)


def _frame(panel: Panel, x: Scale, y: Scale) -> Iterator[Item]:
    """Draw the axes, their ticks and labels."""
    bounds = np.array([(x.start, y.stop), (x.start, y.start), (x.stop, y.start)])
    yield Path(bounds[1:] if panel.y.names and panel.matrix is None else bounds, "soft", 0.8)
    for axis, scale in ((panel.x, x), (panel.y, y)):
        size = min(TEXT, NAMES / max(len(axis.names), 1))
        for value, name in axis.names.items() or _ticks(scale):
            at = float(scale(value))
            if scale is y:
                yield Word(name, np.array([x.start - 4.0, at]), "end", size=size)
            elif axis.names:
                yield Word(name, np.array([at, y.start - 4.0]), "end", size=size, upright=True)
            else:
                yield Word(name, np.array([at, y.start - 7.5]))
    if panel.x.label:
        yield Word(panel.x.label, np.array([(x.start + x.stop) / 2, y.start - 21.0 if not panel.x.names else 5.0]))
    if panel.y.label:
        yield Word(panel.y.label, np.array([5.5, (y.start + y.stop) / 2]), upright=True)
    for rule in panel.rules:
        if rule.label and rule.x is not None:
            yield Word(rule.label, np.array([float(x(rule.x)) - 5.0, y.stop - 2.0]), "end", upright=True)


def _ground(panel: Panel, x: Scale, y: Scale) -> Iterator[Item]:
    """Draw what lies below the series: matrix, band, shades, grid and rules."""

    def box(left: float, right: float, low: float, high: float) -> np.ndarray:
        return np.array([(left, low), (right, low), (right, high), (left, high)])

    if panel.matrix is not None:
        yield from _matrix(panel.matrix, x, y)
        return
    if panel.band is not None:
        low, high = y(np.array(panel.band)).tolist()
        yield Path(box(x.start, x.stop, low, high), fill="shade")
    for left, right in () if panel.shaded is None else x(panel.shaded).reshape(-1, 2).tolist():
        yield Path(box(left, right, y.start, y.stop), fill="shade")
    for scale, other, named, turn in ((x, y, panel.x.names, 1), (y, x, panel.y.names, -1)):
        for value, _ in () if named else _ticks(scale):
            at = float(scale(value))
            yield Path(np.array([(at, other.start), (at, other.stop)])[:, ::turn], "grid", 0.7)
    for rule in panel.rules:
        for scale, other, at_rule, turn in ((x, y, rule.x, 1), (y, x, rule.y, -1)):
            if at_rule is not None:
                at = float(scale(at_rule))
                line = np.array([(at, other.start), (at, other.stop)])[:, ::turn]
                yield Path(line, "soft", 0.8, dash=(2.4, 2.4))


def _matrix(values: np.ndarray, x: Scale, y: Scale) -> Iterator[Item]:
    """Draw values from -1 to 1 by the strength of two colours: all cells of a shade as one path, runs as lines."""
    shade = np.round(SHADES * values).astype(int)
    starts = np.diff(shade, axis=1, prepend=SHADES + 1) != 0
    row, first = np.nonzero(starts)
    stop = first + np.diff(np.append(np.flatnonzero(starts), shade.size))
    up = y(row)
    ends = np.stack([x(first - 0.5), up, x(stop - 0.5), up, np.full(len(row), np.nan), up], axis=1)
    for level in np.unique(shade[shade != 0]).tolist():
        lines = ends[shade[row, first] == level].reshape(-1, 2)
        colour = "positive" if level > 0 else "negative"
        yield Path(lines, colour, abs(float(y(1) - y(0))), opacity=abs(level) / SHADES)


def _series(series: Series, x: Scale, y: Scale) -> Iterator[Item]:
    """Draw a series."""
    colour, width = series.colour, series.width
    if series.mark == "steps":
        edges, heights = np.repeat(series.x, 2), np.concatenate([[0.0], np.repeat(series.y, 2), [0.0]])
        yield Path(np.column_stack([x(edges), y(heights)]), colour, width)
    elif series.mark == "spans":
        low, high = y(np.array([series.y[0] - 0.35, series.y[0] + 0.35])).tolist()
        for start, stop in x(series.x).reshape(-1, 2).tolist():
            yield Path(np.array([(start, low), (stop, low), (stop, high), (start, high)]), fill=colour)
    elif series.mark == "line":
        across, up = thinned(series)
        dash = tuple(width * each for each in dashes_of(series))
        yield Path(np.column_stack([x(across), y(up)]), colour, width, dash=dash)
    else:
        yield from _marks(series, x, y)


def dashes_of(series: Series) -> tuple[float, ...]:
    """Return strokes and gaps of a line, in widths of the line; none for a solid one."""
    return DASHES[int(series.colour[1:]) % len(DASHES)] if series.colour[1:].isdigit() else ()


def thinned(series: Series) -> tuple[np.ndarray, np.ndarray]:
    """Return the points (K,) and (K,) of a line, thinned along time or frequency, not along a path."""
    if not np.all(np.diff(series.x) >= 0):
        return series.x, series.y
    x, y = envelope(series.x, series.y[:, None], BUCKETS)
    return x, y.reshape(-1)


def _marks(series: Series, x: Scale, y: Scale) -> Iterator[Item]:
    """Draw points, and intervals around them."""
    colour = series.colour
    half = np.zeros(len(series.x)) if series.half is None else series.half
    along, turn = (series.y, -1) if series.upright else (series.x, 1)
    scale, other = (y, x) if series.upright else (x, y)
    at = np.column_stack([x(series.x), y(series.y)])
    stroke = {"disc": 1.2, "thick": 4.0}.get(series.mark, 0.0)
    for low, high, across in zip(
        scale(along - half), scale(along + half), other(series.x if series.upright else series.y), strict=True
    ):
        if stroke and np.isfinite((low, high, across)).all():
            yield Path(np.array([(low, across), (high, across)])[:, ::turn], colour, stroke)
            for end in (low, high) if series.mark == "disc" and high - low > 1 else ():
                yield Path(np.array([(end, across - 3.0), (end, across + 3.0)])[:, ::turn], colour, stroke)
    for place in at[np.isfinite(at).all(axis=1)] if series.mark != "thick" else ():
        if series.mark == "points":
            yield Mark(place, size=2.0 + series.width, fill=colour)
        elif series.mark == "disc":
            yield Mark(place, size=5.5, fill=colour)
        else:
            yield Mark(place, "diamond", 5.5, "page", colour, 1.2)


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
