"""Panels as inline SVG: axes, round ticks and series as text, in the colours and the font of the page around them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from html import escape
from math import ceil, floor, log10
from typing import Any

import numpy as np

from gtau.report.chart import MINUS, Axis, Panel, Series, Sketch, Word
from gtau.report.page import number

NARROW, WIDE = 300.0, 360.0  # units of a drawing: panels beside each other, and one alone
INCH = 90.0  # units of the height of a panel
TEXT, LETTER = 10.0, 5.9  # units: height of words, width of a letter
SMALLEST = 6.0  # units: height of names that all fit
STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)  # of a decade, between ticks
SHADES = 10  # of the two colours of a matrix
CAP, HALF = 4.0, 0.35  # units: half an end of an interval; rows: half a bar

Span = tuple[float, float]


@dataclass(frozen=True)
class Scale:
    """An axis laid out: the values at its ends, where these are on the drawing, and whether it is logarithmic."""

    low: float
    high: float
    start: float
    stop: float
    log: bool = False

    def __call__(self, values: np.ndarray | float) -> np.ndarray:
        """Locate values on the drawing; what has no place on it, such as zero on a logarithmic axis, is not finite."""
        low, high = (log10(self.low), log10(self.high)) if self.log else (self.low, self.high)
        with np.errstate(divide="ignore", invalid="ignore"):
            values = np.log10(values) if self.log else np.asarray(values, dtype=float)
        return np.asarray(self.start + (values - low) / (high - low) * (self.stop - self.start))

    def ticks(self, upright: bool) -> list[tuple[float, str]]:
        """List where ticks are and what is written there; no word touches the next."""
        low, high = sorted((self.low, self.high))
        for most in range(6, 0, -1):
            values = _decades(low, high, most) if self.log else ticks(low, high, most)
            digits = 4 + ceil(log10(max(1.0, np.abs(values).max(initial=0.0) / (high - low))))
            words = [number(value, digits).replace("-", MINUS) for value in values.tolist()]
            places = self(values)
            needed = 1.4 * TEXT if upright else LETTER * (max(map(len, words), default=0) + 1)
            if len(words) < 2 or np.abs(np.diff(places)).min() >= needed:
                break
        return list(zip(places.tolist(), words, strict=True))


def ticks(low: float, high: float, most: int) -> np.ndarray:
    """List round numbers between two others, at most ``most`` steps."""
    least = (high - low) / most
    decade = 10.0 ** floor(log10(least))
    step = next(step for step in (share * decade for share in STEPS) if step >= least * (1 - 1e-9))
    return np.asarray(step * np.arange(ceil(low / step - 1e-9), floor(high / step + 1e-9) + 1))


def _decades(low: float, high: float, most: int) -> np.ndarray:
    """List powers of ten between two numbers; where these are close, with their double and half or round numbers."""
    first, last = floor(log10(low)), ceil(log10(high))
    decades = 10.0 ** np.arange(first, last + 1)
    for values in (decades, np.outer(decades, (1.0, 2.0, 5.0)).ravel()):
        inside = values[(values >= low * (1 - 1e-9)) & (values <= high * (1 + 1e-9))]
        if len(inside) > 1:
            return inside[:: -(-len(inside) // most)]
    return ticks(low, high, most)


def svg_of(panel: Panel, alone: bool, title: str = "") -> str:
    """Draw a panel without its title: one ``alone`` is wider than those beside each other.

    The ``title`` is what a screen reader says before the axes and series.
    """
    width = WIDE if alone else NARROW
    height = width if panel.matrix is not None else 0.8 * width if panel.equal else INCH * panel.height
    x_span, y_span = _span(panel, panel.x, 0), _span(panel, panel.y, 1)
    top, right = 18.0 if panel.y.label and panel.matrix is None else 6.0, width - 8.0
    bottom = height - (16.0 if panel.x.label else 2.0) - (_room(panel.x, width) if _turned(panel.x, width) else 14.0)
    left = 0.0
    for _ in range(1 + panel.equal):  # ticks of axes that are widened may be longer
        words = [word for _, word in Scale(*y_span, bottom, top, panel.y.log).ticks(upright=True)]
        left = max(left, _room(panel.y, width) if panel.y.names else _length(words) + 6.0)
        if panel.equal:
            unit = max((x_span[1] - x_span[0]) / (right - left), (y_span[1] - y_span[0]) / (bottom - top))
            x_span, y_span = _widened(x_span, unit * (right - left)), _widened(y_span, unit * (bottom - top))
    if panel.matrix is not None:
        side = min(right - left, bottom - top)
        right, bottom = left + side, top + side
    x = Scale(*x_span, left, right, panel.x.log)
    y = Scale(*y_span, bottom, top, panel.y.log)
    inside = (*_ground(panel, x, y), *(mark for series in panel.series for mark in _series(series, x, y)))
    axes = " over ".join(filter(None, (panel.y.label, panel.x.label)))
    key = ", ".join(series.label for series in panel.series if series.label)
    label = escape("; ".join(filter(None, (title, axes, key))))
    window = (round(left, 1), round(top, 1), round(right - left, 1), round(bottom - top, 1))
    place = 'x="{}" y="{}" width="{}" height="{}" viewBox="{} {} {} {}"'.format(*window, *window)
    return (
        f'<svg viewBox="0 0 {width:.0f} {height:.0f}" role="img" aria-label="{label}" stroke-linejoin="round" '
        f'style="fill:var(--soft);font-size:{TEXT:g}px"><svg {place}>{"".join(inside)}</svg>'
        f"{''.join(_frame(panel, x, y, width, height))}</svg>"
    )


def svg_of_sketch(sketch: Sketch, title: str) -> str:
    """Draw a sketch; ``title`` says what it shows to those who do not see it."""
    (left, _), top = sketch.corner, sketch.corner[1] + sketch.size[1]
    drawn = []
    for item in sketch.items:
        if isinstance(item, Word):
            word = _word(item.text, item.place[0] - left, top - item.place[1], item.side)
            weight = ";font-weight:bold" if item.bold else ""
            style = f'style="fill:var(--{item.colour});font-size:{item.size:g}px{weight}"'
            drawn.append(word.replace("<text", f"<text {style}"))
        else:
            course = _course(*(item.points * (1.0, -1.0) + (-left, top)).T) + "z" * item.closed
            path = _path(course, item.stroke, item.width, fill=item.fill)
            drawn.append(path.replace('"/>', f';stroke-linecap:round;opacity:{item.opacity:g}"/>'))
    return (
        f'<svg viewBox="0 0 {sketch.size[0]:.0f} {sketch.size[1]:.0f}" role="img" aria-label="{escape(title)}" '
        f'stroke-linejoin="round">{"".join(drawn)}</svg>'
    )


def _length(words: Iterable[str]) -> float:
    """Return how long the longest of words is."""
    return LETTER * max(map(len, words), default=1)


def _room(axis: Axis, width: float) -> float:
    """Return the room that the names at an axis take."""
    share = min(1.0, max(SMALLEST, 0.7 * width / max(len(axis.names), 1)) / TEXT)
    return min(share * _length(axis.names.values()) + 6.0, 0.42 * width)


def _turned(axis: Axis, width: float) -> bool:
    """Whether the names at a horizontal axis are too long to stand beside each other."""
    return len(axis.names) * (_length(axis.names.values()) + LETTER) > 0.7 * width


def _widened(span: Span, size: float) -> Span:
    middle = (span[0] + span[1]) / 2
    return middle - size / 2, middle + size / 2


def _span(panel: Panel, axis: Axis, which: int) -> Span:
    """Return the ends of an axis, 0 for x or 1 for y: its limits, or the values on it with a margin beside marks."""
    if panel.matrix is not None:
        ends = (-0.5, len(panel.matrix) - 0.5)
        return ends if which == 0 else ends[::-1]
    parts: list[Any] = [_extent(series, which) for series in panel.series]
    parts += [rule.y if which else rule.x for rule in panel.rules]
    parts.append(panel.band if which else panel.shaded)
    values = np.concatenate([np.zeros(0), *(np.ravel(part) for part in parts if part is not None)])
    values = values[np.isfinite(values) & (values > 0 if axis.log else True)]
    low, high = (values.min(), values.max()) if len(values) else (1.0, 10.0) if axis.log else (0.0, 1.0)
    marks = {series.mark for series in panel.series}
    drawn = marks <= {"line", "steps", "spans"}, marks <= {"line", "steps", "spans", "points"}
    margin = 0.05 if which and drawn[1] else 0.1 if which else 0.0 if drawn[0] else 0.03 if drawn[1] else 0.06
    if axis.log:
        spare = (high / low) ** margin if high > low else 2.0
        ends = low / spare, high * spare
    else:
        spare = margin * (high - low) if high > low else 0.05 * abs(high) or 0.5
        on_axis = which and marks == {"steps"} and low == 0.0
        ends = (low if on_axis else low - spare), high + spare
    return tuple(float(end if fixed is None else fixed) for fixed, end in zip(axis.limits, ends, strict=True))  # type: ignore[return-value]


def _extent(series: Series, which: int) -> np.ndarray:
    """Return the values of a series along x (0) or y (1), with its intervals."""
    values = series.y if which else series.x
    if which and series.mark == "steps":
        return np.append(values, 0.0)
    if which and series.mark == "spans":
        return values + np.array([-HALF, HALF])
    if series.half is None or bool(which) != series.upright:
        return values
    return np.concatenate([values - series.half, values + series.half])


def _ground(panel: Panel, x: Scale, y: Scale) -> Iterator[str]:
    """Draw what lies below the series: matrix, band, shades, grid and rules."""
    if panel.matrix is not None:
        yield from _matrix(panel.matrix, x, y)
        return
    if panel.band is not None:
        yield _boxes(np.array([[x.start, x.stop]]), y(np.array(panel.band)), "shade")
    if panel.shaded is not None and panel.shaded.size:
        yield _boxes(x(panel.shaded.reshape(-1, 2)), np.array([y.start, y.stop]), "shade")
    up, across = (f"V{y.stop:.1f}", y.start), (f"H{x.stop:.1f}", x.start)
    grid = [f"M{at:.1f} {up[1]:.1f}{up[0]}" for at, _ in ([] if panel.x.names else x.ticks(upright=False))]
    grid += [f"M{across[1]:.1f} {at:.1f}{across[0]}" for at, _ in ([] if panel.y.names else y.ticks(upright=True))]
    yield _path("".join(grid), "grid", 0.9)
    rules = [f"M{x(rule.x):.1f} {up[1]:.1f}{up[0]}" for rule in panel.rules if rule.x is not None]
    rules += [f"M{across[1]:.1f} {y(rule.y):.1f}{across[0]}" for rule in panel.rules if rule.y is not None]
    yield _path("".join(rules), "soft", 1.0, (3.0, 3.0))


def _frame(panel: Panel, x: Scale, y: Scale, width: float, height: float) -> Iterator[str]:
    """Draw the axes, their ticks and labels, and the labels of rules."""
    ordinate = f"M{x.start:.1f} {y.stop:.1f}V{y.start:.1f}" if panel.matrix is not None or not panel.y.names else ""
    yield _path(f"{ordinate}M{x.start:.1f} {y.start:.1f}H{x.stop:.1f}", "soft", 0.9)
    for axis, scale in ((panel.x, x), (panel.y, y)):
        pitch = abs(scale.stop - scale.start) / max(len(axis.names), 1)
        names = list(axis.names.items())[:: ceil(SMALLEST / pitch)]
        named = [(float(scale(value)), name) for value, name in names]
        size = min(TEXT, max(SMALLEST, pitch), (_room(axis, width) - 6.0) / _length(axis.names.values()) * TEXT)
        for at, word in named or scale.ticks(upright=scale is y):
            if scale is y:
                yield _word(word, x.start - 4.0, at, "end", size)
            elif _turned(axis, width):
                yield _word(word, at, y.start + 5.0, "end", size, turned=True)
            else:
                yield _word(word, min(at, width - LETTER * len(word) / 2), y.start + 9.0)
    if panel.x.label:
        yield _word(panel.x.label, (x.start + x.stop) / 2, height - 6.0)
    if panel.y.label and panel.matrix is None:
        yield _word(panel.y.label, 0.0, 7.0, "start")
    end = -TEXT
    labelled = [(float(x(rule.x)), rule.label) for rule in panel.rules if rule.label and rule.x is not None]
    for at, label in sorted(labelled):
        before = at - TEXT > max(x.start, end)
        yield _word(label, at - 6.0 if before else at + 6.0, y.stop + 2.0, "end", 0.9 * TEXT, turned=True)
        end = at if before else at + TEXT


def _matrix(values: np.ndarray, x: Scale, y: Scale) -> Iterator[str]:
    """Draw values from -1 to 1 by the strength of two colours: all cells of a shade as one path, runs as lines."""
    shade = np.round(SHADES * values).astype(int)
    starts = np.diff(shade, axis=1, prepend=SHADES + 1) != 0
    row, first = np.nonzero(starts)
    stop = first + np.diff(np.append(np.flatnonzero(starts), shade.size))
    ends, up = np.column_stack([x(first - 0.5), x(stop - 0.5)]), y(row + np.array([[-0.5], [0.5]])).T
    for level in np.unique(shade[shade != 0]).tolist():
        shown = shade[row, first] == level
        colour = "positive" if level > 0 else "negative"
        yield _boxes(ends[shown], up[shown], colour, abs(level) / SHADES)


def _series(series: Series, x: Scale, y: Scale) -> Iterator[str]:
    """Draw a series."""
    colour, width = series.colour, series.width
    if series.mark == "steps":
        heights = np.concatenate([[0.0], np.repeat(series.y, 2), [0.0]])
        yield _path(_course(x(np.repeat(series.x, 2)), y(heights)), colour, width)
    elif series.mark == "spans":
        yield _boxes(x(series.x), y(series.y + np.array([-HALF, HALF])), colour)
    elif series.mark == "line":
        across, up = series.thinned()
        yield _path(_course(x(across), y(up)), colour, width, series.dashes)
    else:
        yield from _marks(series, x, y)


def _marks(series: Series, x: Scale, y: Scale) -> Iterator[str]:
    """Draw points, and intervals around them."""
    at = np.column_stack([x(series.x), y(series.y)])
    if series.half is not None and series.mark != "diamond":
        along = int(series.upright)
        scale, values = (y, series.y) if along else (x, series.x)
        ends = np.stack([at, at])
        ends[0, :, along], ends[1, :, along] = scale(values - series.half), scale(values + series.half)
        course = "".join(_course(*pair.T) for pair in ends.swapaxes(0, 1))
        if series.mark == "disc":
            cap = np.array([CAP, 0.0] if along else [0.0, CAP])
            wide = np.abs(ends[1, :, along] - ends[0, :, along]) > 1.0
            caps = np.stack([ends[:, wide] - cap, ends[:, wide] + cap], axis=2).reshape(-1, 2, 2)
            course += "".join(_course(*pair.T) for pair in caps)
        yield _path(course, series.colour, 1.4 if series.mark == "disc" else 5.0)
    places = at[np.isfinite(at).all(axis=1)].tolist()
    if series.mark == "diamond":
        diamonds = "".join(f"M{a - 4.5:.1f} {b:.1f}l4.5 -4.5 4.5 4.5 -4.5 4.5z" for a, b in places)
        yield _path(diamonds, series.colour, 1.3, fill="page")
    elif series.mark in ("disc", "points"):  # lines without length, with round ends
        size = 7.0 if series.mark == "disc" else 2.2 + series.width
        dots = "".join(f"M{a:.1f} {b:.1f}h0" for a, b in places)
        yield _path(dots, series.colour, size).replace('"/>', ';stroke-linecap:round"/>')


def _course(x: np.ndarray, y: np.ndarray) -> str:
    """Write the commands of a line through points, broken where one is not finite."""
    there = np.isfinite(x) & np.isfinite(y)
    pens = np.where(there[1:] & there[:-1], "L", "M").tolist()
    points = zip(["M", *pens], x.tolist(), y.tolist(), there.tolist(), strict=True)
    return "".join(f"{pen}{across:.1f} {up:.1f}" for pen, across, up, shown in points if shown)


def _path(course: str, stroke: str, width: float, dashes: tuple[float, ...] = (), fill: str = "") -> str:
    """Draw lines; ``dashes`` are strokes and gaps in widths of the line."""
    if not course:
        return ""
    style = f"fill:{f'var(--{fill})' if fill else 'none'};stroke:var(--{stroke});stroke-width:{width:.3g}"
    style += f";stroke-dasharray:{' '.join(f'{width * part:.1f}' for part in dashes)}" if dashes else ""
    return f'<path d="{course}" style="{style}"/>'


def _boxes(x: np.ndarray, y: np.ndarray, fill: str, opacity: float = 1.0) -> str:
    """Fill boxes between ends (K, 2) along x and (K, 2) or (2,) along y."""
    corners = np.column_stack([x, np.broadcast_to(y, (len(x), 2))]).tolist()
    course = "".join(f"M{a:.1f} {c:.1f}H{b:.1f}V{d:.1f}H{a:.1f}z" for a, b, c, d in corners)
    return f'<path d="{course}" style="fill:var(--{fill});opacity:{opacity:.2g}"/>'


def _word(text: str, x: float, y: float, side: str = "middle", size: float = TEXT, turned: bool = False) -> str:
    """Write words whose ``side`` is at a place, at half their height, ``turned`` to be read from below."""
    turn = f' transform="rotate(-90 {x:.1f} {y:.1f})"' if turned else ""
    small = f' style="font-size:{size:.1f}px"' if size < TEXT else ""
    return f'<text x="{x:.1f}" y="{y:.1f}" dy=".35em" text-anchor="{side}"{turn}{small}>{escape(text)}</text>'
