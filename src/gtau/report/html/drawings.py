"""Small charts as inline SVG: panels with axes, and rows of intervals. They need no script and print as they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import ceil, floor, log10

import numpy as np

from gtau.report.html.elements import escape, plain

LEFT, RIGHT, TOP, BOTTOM = 50.0, 8.0, 8.0, 32.0  # margins of a panel for its labels


def ticks(low: float, high: float, most: int = 5) -> list[float]:
    """Round numbers between two others, at most ``most`` of them."""
    if not high > low:
        return [low]
    decade = 10.0 ** (floor(log10(high - low)) - 1)
    for step in (each * decade for each in (1, 2, 5, 10, 20, 50, 100)):
        first, last = ceil(low / step - 1e-9), floor(high / step + 1e-9)
        if last - first < most:
            break
    return [k * step for k in range(first, last + 1)]


@dataclass
class Panel:
    """A chart in the making: what is drawn is added to it, and ``svg`` gives the markup.

    ``x`` and ``y`` are the ranges; with ``log_x`` or ``log_y`` they are positive and the axis is logarithmic.
    """

    x: tuple[float, float]
    y: tuple[float, float]
    xlabel: str = ""
    ylabel: str = ""
    size: tuple[float, float] = (300.0, 160.0)
    log_x: bool = False
    log_y: bool = False
    marks: list[str] = field(default_factory=list)

    def place(self, x: np.ndarray | float, y: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        """Map values to the page; what lies outside the ranges is moved to their ends."""
        found = []
        for values, (low, high), logarithmic in ((x, self.x, self.log_x), (y, self.y, self.log_y)):
            values = np.clip(np.asarray(values, dtype=float), low, high)
            part = (values - low) / (high - low)
            if logarithmic:
                part = np.log(values / low) / np.log(high / low)
            found.append(part)
        width, height = self.size
        return LEFT + found[0] * (width - LEFT - RIGHT), height - BOTTOM - found[1] * (height - TOP - BOTTOM)

    def line(self, x: np.ndarray, y: np.ndarray, colour: str = "predicted", dash: str = "", width: float = 1.3) -> None:
        """Draw a line through points (K,); it is broken where a value is NaN."""
        finite = np.isfinite(x) & np.isfinite(y)
        across, up = self.place(np.where(finite, x, self.x[0]), np.where(finite, y, self.y[0]))
        words, pen = [], "M"
        for k in range(len(across)):
            if not finite[k]:
                pen = "M"
                continue
            words.append(f"{pen}{across[k]:.1f} {up[k]:.1f}")
            pen = "L"
        self.marks.append(
            f'<path class="line" style="stroke:var(--{colour});stroke-width:{width}"'
            f'{f" stroke-dasharray={chr(34)}{dash}{chr(34)}" if dash else ""} d="{"".join(words)}"/>'
        )

    def bars(self, edges: np.ndarray, heights: np.ndarray, colour: str = "predicted") -> None:
        """Draw bars (K,) between edges (K + 1,) from the bottom up."""
        across, up = self.place(edges, np.append(heights, self.y[0]))
        floor_ = self.size[1] - BOTTOM
        self.marks += [
            f'<rect x="{a:.1f}" y="{top:.1f}" width="{max(b - a - 0.5, 0.5):.1f}" height="{floor_ - top:.1f}" '
            f'style="fill:var(--{colour});opacity:.55"/>'
            for a, b, top in zip(across[:-1], across[1:], up[:-1], strict=True)
        ]

    def points(self, x: np.ndarray, y: np.ndarray, colour: str = "predicted", labels: Sequence[str] = ()) -> None:
        """Draw discs at points (K,), with the labels that show when they are pointed at."""
        across, up = self.place(x, y)
        for k, (a, b) in enumerate(zip(across, up, strict=True)):
            title = f"<title>{escape(labels[k])}</title>" if k < len(labels) else ""
            self.marks.append(
                f'<circle cx="{a:.1f}" cy="{b:.1f}" r="2.6" style="fill:var(--{colour})">{title}</circle>'
            )

    def rule(self, x: float | None = None, y: float | None = None, label: str = "", row: int = 0) -> None:
        """Draw a straight line across the panel at one x or one y, with a label, those of one x in their own rows."""
        width, height = self.size
        if x is not None:
            (a,) = self.place(np.array([x]), self.y[0])[0]
            self.marks.append(f'<line class="rule" x1="{a:.1f}" x2="{a:.1f}" y1="{TOP}" y2="{height - BOTTOM}"/>')
            right = a > 0.6 * width
            self._label(a - 3 if right else a + 3, TOP + 9 + 12 * row, label, "end" if right else "start")
        if y is not None:
            (b,) = self.place(self.x[0], np.array([y]))[1]
            self.marks.append(f'<line class="rule" x1="{LEFT}" x2="{width - RIGHT}" y1="{b:.1f}" y2="{b:.1f}"/>')
            self._label(width - RIGHT, b - 3, label, "end")

    def band(self, low: float, high: float) -> None:
        """Shade a band between two values of y."""
        (b, a) = self.place(self.x[0], np.array([low, high]))[1]
        width = self.size[0] - LEFT - RIGHT
        self.marks.append(f'<rect class="band" x="{LEFT}" y="{a:.1f}" width="{width}" height="{b - a:.1f}"/>')

    def _label(self, x: float, y: float, words: str, anchor: str) -> None:
        if words:
            self.marks.append(
                f'<text class="halo" x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(words)}</text>'
            )

    def svg(self, title: str) -> str:
        """Write the markup; ``title`` is read aloud and shown when the panel is pointed at."""
        width, height = self.size
        grid = []
        for value in _axis(self.x, self.log_x, 5):
            (a,) = self.place(np.array([value]), self.y[0])[0]
            grid.append(f'<line class="grid" x1="{a:.1f}" x2="{a:.1f}" y1="{TOP}" y2="{height - BOTTOM}"/>')
            grid.append(
                f'<text x="{a:.1f}" y="{height - BOTTOM + 12}" text-anchor="middle">{_tick(value, self.log_x)}</text>'
            )
        for value in _axis(self.y, self.log_y, 4):
            (b,) = self.place(self.x[0], np.array([value]))[1]
            grid.append(f'<line class="grid" x1="{LEFT}" x2="{width - RIGHT}" y1="{b:.1f}" y2="{b:.1f}"/>')
            grid.append(f'<text x="{LEFT - 4}" y="{b + 3.5:.1f}" text-anchor="end">{_tick(value, self.log_y)}</text>')
        middle = (TOP + height - BOTTOM) / 2
        names = (
            f'<text x="{(LEFT + width - RIGHT) / 2:.1f}" y="{height - 4}" text-anchor="middle">{escape(self.xlabel)}'
            f'</text><text x="9" y="{middle:.1f}" text-anchor="middle" transform="rotate(-90 9 {middle:.1f})">'
            f"{escape(self.ylabel)}</text>"
        )
        return (
            f'<svg viewBox="0 0 {width:g} {height:g}" role="img" aria-label="{escape(title)}">'
            f"{''.join(grid)}{''.join(self.marks)}"
            f'<path class="axis" d="M{LEFT} {TOP}V{height - BOTTOM}H{width - RIGHT}"/>{names}</svg>'
        )


def _tick(value: float, logarithmic: bool) -> str:
    """Write a value at an axis; powers of ten as such where they are many."""
    exponent = round(log10(value)) if logarithmic and value > 0 else 0
    if abs(exponent) >= 3 and abs(value / 10.0**exponent - 1) < 1e-9:
        return f"1e{exponent}".replace("-", "\N{MINUS SIGN}")
    return escape(plain(value, 4))


def _axis(span: tuple[float, float], logarithmic: bool, most: int) -> list[float]:
    if not logarithmic:
        return ticks(*span, most)
    low, high = ceil(log10(span[0]) - 1e-9), floor(log10(span[1]) + 1e-9)
    if high - low < 1:
        return ticks(*span, 3)
    step = -(-(high - low + 1) // most)
    return [10.0**k for k in range(low, high + 1, step)]


def panel_figure(title: str, drawing: str, css: str = "") -> str:
    """Place a drawing below its title."""
    return f'<figure class="panel {css}"><h4>{escape(title)}</h4>{drawing}</figure>'


@dataclass(frozen=True)
class Interval:
    """A row of an interval chart, all in the same unit.

    ``outer`` are the ends of the whole interval, ``inner`` those of its random part where both are known, and ``other``
    a value to compare with.
    """

    value: float | None
    outer: tuple[float, float] | None = None
    inner: tuple[float, float] | None = None
    other: float | None = None


def interval_rows(rows: Sequence[Interval], zero: float | None = None) -> tuple[list[str], str]:
    """Draw bars of the rows on one scale, each as an SVG of full width, and one with the axis below them.

    Discs are the values, thin lines the intervals, thick ones their random part, and diamonds what they are compared
    with; ``zero`` is marked by a line.
    """
    ends = [each.value for each in rows] + [each.other for each in rows] + [zero]
    ends += [end for each in rows for span in (each.outer, each.inner) for end in span or ()]
    known = [end for end in ends if end is not None and np.isfinite(end)]
    low, high = (min(known), max(known)) if known else (0.0, 1.0)
    margin = 0.06 * (high - low) or 0.5 * abs(high) or 1.0
    low, high = low - margin, high + margin

    def at(value: float) -> str:
        return f"{100 * (value - low) / (high - low):.2f}%"

    guide = "" if zero is None else f'<line class="rule" x1="{at(zero)}" x2="{at(zero)}" y1="0" y2="30"/>'
    found = []
    for each in rows:
        marks = [guide]
        if each.outer is not None:
            a, b = map(at, each.outer)
            marks.append(f'<line x1="{a}" x2="{b}" y1="15" y2="15" style="stroke:var(--predicted);stroke-width:1.6"/>')
            marks += [
                f'<line x1="{end}" x2="{end}" y1="10" y2="20" style="stroke:var(--predicted);stroke-width:1.6"/>'
                for end in (a, b)
            ]
        if each.inner is not None:
            a, b = map(at, each.inner)
            marks.append(f'<line x1="{a}" x2="{b}" y1="15" y2="15" style="stroke:var(--predicted);stroke-width:5"/>')
        if each.other is not None:
            marks.append(
                f'<svg x="{at(each.other)}" y="15" overflow="visible"><path d="M-5 0L0 -5L5 0L0 5Z" '
                'style="fill:var(--page);stroke:var(--prior);stroke-width:1.6"/></svg>'
            )
        if each.value is not None:
            marks.append(f'<circle cx="{at(each.value)}" cy="15" r="4" style="fill:var(--predicted)"/>')
        found.append(f'<svg role="img" aria-hidden="true">{"".join(marks)}</svg>')
    axis = "".join(
        f'<line class="axis" x1="{at(tick)}" x2="{at(tick)}" y1="0" y2="5"/>'
        f'<text x="{at(tick)}" y="17" text-anchor="middle">{escape(plain(tick, 4))}</text>'
        for tick in ticks(low, high, 5)
    )
    return found, f'<svg role="img" aria-hidden="true"><line class="axis" x1="0" x2="100%" y1="0" y2="0"/>{axis}</svg>'


def decades(values: np.ndarray) -> tuple[float, float]:
    """Choose a range of whole decades around positive values, at most six of them."""
    high = 10.0 ** np.ceil(np.log10(values.max()))
    low = 10.0 ** np.floor(np.log10(values.min()))
    return float(max(low, high * 1e-6)), float(high)
