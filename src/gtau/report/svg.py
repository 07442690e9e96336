"""Panels and sketches as inline SVG, whose colours and font come from the page around it.

Drawn by Matplotlib, the charts of a report took a seventh of the time of an identification.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from html import escape
from math import ceil

import numpy as np

from gtau.report.chart import MINUS, Axis, Panel, Series, Sketch, Word
from gtau.report.page import number
from gtau.report.robot_figure import sketch_of
from gtau.robots.robot import Robot

NARROW, WIDE = 300.0, 360.0  # points, width of panels of a page, side by side or alone
INCH = 90.0  # points, an inch of height
NAMES, SMALLEST = 220.0, 5.5  # points: room for the names along an axis, and their smallest size
SIZE = 10.0  # of the font, points
LETTER = 0.56  # width of a letter over the size of its font
LEVEL = 36  # letters of names that fit side by side below an axis
STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)  # of a decade, between ticks
ROOM = {"points": (0.03, 0.05), **dict.fromkeys(("disc", "diamond", "thick"), (0.06, 0.1))}
"""Shares of the axes that are free around some marks."""
TINTS = 10  # strengths of the colours of a matrix


@dataclass(frozen=True)
class Scale:
    """Map of an axis to the page: values from ``low`` to ``high``, their logarithms if ``axis.log``, in points."""

    axis: Axis
    low: float
    high: float
    start: float
    stop: float

    def at(self, values: np.ndarray) -> np.ndarray:
        """Return the places of values; NaN where a logarithmic axis has none."""
        return self.start + (self._scaled(values) - self.low) / (self.high - self.low) * (self.stop - self.start)

    def _scaled(self, values: np.ndarray) -> np.ndarray:
        values = np.asarray(values, dtype=float)
        return np.log10(np.where(values > 0, values, np.nan)) if self.axis.log else values

    def around(self, values: np.ndarray, room: float, floor: bool = False) -> Scale:
        """Fit the scale to values with some ``room`` around them, none below a ``floor``; fixed limits stay."""
        scaled = self._scaled(values)
        scaled = scaled[np.isfinite(scaled)]
        low, high = (scaled.min(), scaled.max()) if scaled.size else (0.0, 1.0)
        if high - low <= 1e-9 * max(abs(low), abs(high)):
            half = 1.0 if self.axis.log else 0.05 * abs(low) or 0.05
            low, high = low - half, high + half
        ends = [low if floor else low - room * (high - low), high + room * (high - low)]
        for k, limit in enumerate(self.axis.limits):
            if limit is not None:
                ends[k] = float(self._scaled(np.array(limit)))
        return replace(self, low=ends[0], high=ends[1])

    def ticks(self) -> dict[float, str]:
        """Choose values to mark, with their words."""
        if self.axis.names:
            return dict(list(self.axis.names.items())[:: ceil(SMALLEST * len(self.axis.names) / NAMES)])
        low, high = sorted(10.0**end if self.axis.log else end for end in (self.low, self.high))
        if self.axis.log and high > 5 * low:
            decades = np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1)[:: ceil(np.log10(high / low) / 6)]
            marks = 10.0 ** decades[:, None] * ([1, 2, 5] if high < 100 * low else [1])
            words = {value: number(value).replace("-", MINUS) for value in marks.ravel().tolist()}
        else:
            unit = 10 ** np.floor(np.log10((high - low) / 5))
            step = next(k * unit for k in STEPS if k * unit >= (high - low) / 5 * (1 - 1e-9))
            values = step * np.arange(np.ceil(low / step - 1e-6), np.floor(high / step + 1e-6) + 1) + 0.0
            words = dict(zip(values.tolist(), _words(values, step), strict=True))
        margin = 1e-9 * (high - low)
        return {value: text for value, text in words.items() if low - margin <= value <= high + margin}


def _words(values: np.ndarray, step: float) -> list[str]:
    """Write values with as many digits as one ``step`` needs."""
    plain = np.abs(values).max() < 1e6
    ways = [f".{k}f" for k in range(5) if plain] + [f".{k}g" for k in range(1, 16)]
    for way in ways:
        words = [format(value, way) for value in values.tolist()]
        if np.abs(np.array(words, dtype=float) - values).max() < 1e-6 * step:
            break
    return [word.replace("e-0", "e-").replace("e+0", "e").replace("-", MINUS) for word in words]


def svg_of(panel: Panel, alone: bool, title: str = "") -> str:
    """Draw a panel without its title as SVG, wider where it stands ``alone``; screen readers read ``title`` first."""
    width = WIDE if alone else NARROW
    columns, rows = panel.x.names.values(), panel.y.names.values()
    words = rows or _scales(panel, (0.0, 1.0), (1.0, 0.0))[1].ticks().values()
    letters = (size_of_names(panel.y) if rows else SIZE) * max(map(len, words), default=0)
    left = 10 + LETTER * (letters if rows else max(letters, 55))
    left, right, top = min(left, 0.6 * width), width - 10, 22.0 if panel.y.label else 8.0
    upright = sum(len(name) + 1 for name in columns) > LEVEL
    below = LETTER * size_of_names(panel.x) * max(map(len, columns)) if upright else 10
    below += 28 if panel.x.label else 14
    height = INCH * panel.height if panel.matrix is None else top + right - left + below
    x, y = _scales(panel, (left, right), (height - below, top))
    inner = f"{left:.1f} {top:.1f} {right - left:.1f} {height - below - top:.1f}".split()
    frame = " ".join(f'{name}="{value}"' for name, value in zip(("x", "y", "width", "height"), inner, strict=True))
    parts = [*_grid(panel, x, y, upright), f'<svg {frame} viewBox="{" ".join(inner)}">', *_drawn(panel, x, y), "</svg>"]
    if panel.y.label:
        parts.append(_word(panel.y.label, left, top - 8, "start"))
    if panel.x.label:
        parts.append(_word(panel.x.label, (left + right) / 2, height - 13))
    key = ", ".join(series.label for series in panel.series if series.label)
    axes = " over ".join(filter(None, (panel.y.label, panel.x.label)))
    return _page(parts, width, height, "; ".join(filter(None, (title, axes, key))))


def svg_of_robot(robot: Robot) -> str:
    """Draw a robot at home as SVG."""
    sketch = sketch_of(robot)
    width, height = sketch.size.tolist()
    return _page(_sketched(sketch), width, height, f"robot {robot.name} at home")


def size_of_names(axis: Axis, largest: float = SIZE) -> float:
    """Choose the font size at which the names along an axis fit, points."""
    return min(largest, max(SMALLEST, NAMES / len(axis.names)))


def _page(parts: Iterable[str], width: float, height: float, label: str) -> str:
    view = f'viewBox="0 0 {width:.0f} {height:.0f}" role="img" aria-label="{escape(label)}"'
    return f"<svg {view}>{''.join(parts)}</svg>"


def _scales(panel: Panel, across: tuple[float, float], up: tuple[float, float]) -> tuple[Scale, Scale]:
    x, y = [np.zeros(0)], [np.zeros(0)]
    for series in panel.series:
        half = np.zeros(1) if series.half is None else np.array([[-1.0], [1.0]]) * series.half
        x.append((series.x + half * (not series.upright)).ravel())
        y.append((series.y + (np.array([-0.35, 0.35]) if series.mark == "spans" else half * series.upright)).ravel())
    floor = any(series.mark == "steps" for series in panel.series)
    y += [np.zeros(1)] if floor else []
    if panel.matrix is not None:
        x, y, up = [np.array([-0.5, len(panel.matrix) - 0.5])], [np.array([-0.5, len(panel.matrix) - 0.5])], up[::-1]
    x += [np.array([rule.x]) for rule in panel.rules if rule.x is not None]
    y += [np.array([rule.y]) for rule in panel.rules if rule.y is not None]
    y += [] if panel.band is None else [np.array(panel.band)]
    room = np.max([ROOM.get(series.mark, (0.0, 0.05)) for series in panel.series] or [(0.0, 0.0)], axis=0).tolist()
    x_scale = Scale(panel.x, 0.0, 1.0, *across).around(np.concatenate(x), room[0])
    return x_scale, Scale(panel.y, 0.0, 1.0, *up).around(np.concatenate(y), room[1], floor)


def _grid(panel: Panel, x: Scale, y: Scale, upright: bool) -> Iterator[str]:
    below = max(y.start, y.stop)
    for scale in (x, y):
        size = size_of_names(scale.axis) if scale.axis.names else SIZE
        for value, text in scale.ticks().items():
            at = float(scale.at(np.array(value)))
            if panel.matrix is None and not scale.axis.names:
                ends = ([at, at], [y.start, y.stop]) if scale is x else ([x.start, x.stop], [at, at])
                yield _line(*ends, "grid", 0.7)
            if scale is y:
                yield _word(text, x.start - 3.5, at + 0.37 * size, "end", size)
            elif upright:
                yield _word(text, at + size / 3, below + 4, "end", size, turned=True)
            else:
                yield _word(text, at, below + 11.5, size=size)
    yield _line([x.start, x.stop], [below, below], "soft", 0.8)
    if not panel.y.names:
        yield _line([x.start, x.start], [y.start, y.stop], "soft", 0.8)


def _drawn(panel: Panel, x: Scale, y: Scale) -> Iterator[str]:
    if panel.matrix is not None:
        yield from _matrix(panel.matrix, x, y)
    if panel.band is not None:
        yield _area([(x.start, x.stop)], y.at(np.array(panel.band)), "shade")
    dashed = "; stroke-dasharray: 2.4 2.4"
    # the first label is left of its line, further ones right, so that all show
    for k, (value, label) in enumerate(sorted((rule.x, rule.label) for rule in panel.rules if rule.x is not None)):
        at = float(x.at(np.array(value)))
        yield _line([at, at], [y.start, y.stop], "soft", 0.8, dashed)
        yield _word(label, at + (9 if k else -3), min(y.start, y.stop) + 2, "end", 8.3, turned=True)
    for rule in panel.rules:
        if rule.y is not None:
            yield _line([x.start, x.stop], y.at(np.array([rule.y] * 2)), "soft", 0.8, dashed)
    for series in panel.series:
        yield from _series(series, x, y)


def _series(series: Series, x: Scale, y: Scale) -> Iterator[str]:
    hue, width = series.colour, series.width
    if series.mark == "steps":
        yield _line(x.at(np.repeat(series.x, 2)), y.at(np.r_[0.0, np.repeat(series.y, 2), 0.0]), hue, width)
    elif series.mark == "spans":
        yield _area(x.at(series.x), y.at(series.y[0] + np.array([-0.35, 0.35])), hue)
    elif series.mark == "line":
        dashes = " ".join(f"{width * part:.1f}" for part in series.dashes)
        across, up = series.thinned()
        yield _line(x.at(across), y.at(up), hue, width, f"; stroke-dasharray: {dashes}" if dashes else "")
    elif series.mark == "points":
        yield _dots(x.at(series.x), y.at(series.y), hue, 2 + width)
    else:
        half = np.zeros(len(series.x)) if series.half is None else series.half
        side = np.array([-1.0, 1.0, np.nan])  # NaN interrupts the line
        if series.mark != "diamond":
            across = x.at(series.x[:, None] + side * (half * (not series.upright))[:, None])
            up = y.at(series.y[:, None] + side * (half * series.upright)[:, None])
            yield _line(across.ravel(), up.ravel(), hue, 4.0 if series.mark == "thick" else 1.2)
        if series.mark == "disc":
            for k in (0, 1):  # caps
                wide, high = 3 * side * series.upright, 3 * side * (not series.upright)
                yield _line((across[:, [k]] + wide).ravel(), (up[:, [k]] + high).ravel(), hue, 1.0)
            yield _dots(x.at(series.x), y.at(series.y), hue, 4.5)
        elif series.mark == "diamond":
            places = zip(x.at(series.x).tolist(), y.at(series.y).tolist(), strict=True)
            path = "".join(f"M{a:.1f} {b - 3.2:.1f}l3.2 3.2 -3.2 3.2 -3.2 -3.2z" for a, b in places)
            yield f'<path d="{path}" style="fill: var(--page); stroke: var(--{hue})"/>'


def _matrix(matrix: np.ndarray, x: Scale, y: Scale) -> Iterator[str]:
    """Draw values from -1 to 1 by the strength of two colours."""
    tints = np.rint(TINTS * matrix).astype(int)
    cell = abs(x.stop - x.start) / len(matrix)
    for tint in sorted(set(tints.ravel().tolist()) - {0}):
        rows, columns = np.nonzero(tints == tint)
        places = zip((x.at(columns) - cell / 2).tolist(), (y.at(rows) - cell / 2).tolist(), strict=True)
        path = "".join(f"M{a:.1f} {b:.1f}h{cell:.2f}v{cell:.2f}h-{cell:.2f}z" for a, b in places)
        hue = "positive" if tint > 0 else "negative"
        yield f'<path d="{path}" style="fill: var(--{hue}); fill-opacity: {abs(tint) / TINTS}"/>'


def _sketched(sketch: Sketch) -> Iterator[str]:
    """Draw the items of a sketch in order; y points up in a sketch, and down on a page."""
    left, top = sketch.corner[0], sketch.corner[1] + sketch.size[1]
    for item in sketch.items:
        if isinstance(item, Word):
            across, down = float(item.place[0] - left), float(top - item.place[1]) + 0.36 * item.size
            yield _word(item.text, across, down, item.side, item.size, item.colour, item.bold)
            continue
        points = (item.points - sketch.corner) * [1, -1] + [0, sketch.size[1]]
        if item.closed:
            path = "L".join(f"{a:.1f} {b:.1f}" for a, b in points.tolist())
            fill = f"var(--{item.fill})" if item.fill else "none"
            stroke = f"stroke: var(--{item.stroke}); stroke-width: {item.width:g}; opacity: {item.opacity:g}"
            yield f'<path d="M{path}z" style="fill: {fill}; {stroke}"/>'
        else:
            yield _line(points[:, 0], points[:, 1], item.stroke, item.width, "; stroke-linecap: round")


# Elements, at places in points


def _line(x: np.ndarray | list[float], y: np.ndarray | list[float], hue: str, width: float, more: str = "") -> str:
    """Draw a line that NaN interrupts."""
    x, y = np.asarray(x), np.asarray(y)
    known = np.isfinite(x) & np.isfinite(y)
    begins = known & ~np.r_[False, known[:-1]]
    places = zip(x[known].tolist(), y[known].tolist(), begins[known].tolist(), strict=True)
    path = "".join(f"{'M' if begin else 'L'}{a:.1f} {b:.1f}" for a, b, begin in places)
    return f'<path d="{path}" style="fill: none; stroke: var(--{hue}); stroke-width: {width:g}{more}"/>'


def _dots(x: np.ndarray, y: np.ndarray, hue: str, size: float) -> str:
    """Draw dots: lines of no length with round caps."""
    known = np.isfinite(x) & np.isfinite(y)
    path = "".join(f"M{a:.1f} {b:.1f}h0" for a, b in zip(x[known].tolist(), y[known].tolist(), strict=True))
    return f'<path d="{path}" style="stroke: var(--{hue}); stroke-width: {size:g}; stroke-linecap: round"/>'


def _area(across: np.ndarray | list[tuple[float, float]], up: np.ndarray | tuple[float, float], hue: str) -> str:
    """Fill rectangles between pairs of places ``across`` and one pair ``up``."""
    low, high = up
    path = "".join(f"M{a:.1f} {low:.1f}H{b:.1f}V{high:.1f}H{a:.1f}z" for a, b in across)
    return f'<path d="{path}" style="fill: var(--{hue})"/>'


def _word(
    text: str, x: float, y: float, side: str = "middle", size: float = SIZE, hue: str = "soft", bold: bool = False,
    turned: bool = False,
) -> str:  # fmt: skip
    """Write words whose ``side`` is at a place, from below upwards if ``turned``."""
    look = f"font-size: {size:.3g}px; text-anchor: {side}; fill: var(--{hue})" + ("; font-weight: bold" if bold else "")
    turn = f' transform="rotate(-90 {x:.1f} {y:.1f})"' if turned else ""
    return f'<text style="{look}" x="{x:.1f}" y="{y:.1f}"{turn}>{escape(text)}</text>'
