"""Sketches: paths, marks and words at places of a sheet, in points; drawn as SVG in the colours of a page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHAPES = {"disc": "o", "square": "s", "diamond": "D", "hexagon": "h"}
"""Shapes of marks, and Matplotlib's names of them."""
CORNERS = {"diamond": 4, "hexagon": 6}
HALO = 2.4  # points, of the page's colour around words


@dataclass(frozen=True, eq=False)
class Path:
    """A line through ``points`` (K, 2), broken where one is not finite, or an area where it has a ``fill``.

    Colours are names of the palette. ``dash`` are the lengths of strokes and gaps, points.
    """

    points: np.ndarray
    stroke: str = ""
    width: float = 1.0
    fill: str = ""
    opacity: float = 1.0
    dash: tuple[float, ...] = ()
    round: bool = False


@dataclass(frozen=True, eq=False)
class Mark:
    """A shape of a ``size`` across, points, at a place (2,)."""

    place: np.ndarray
    shape: Literal["disc", "square", "diamond", "hexagon"] = "disc"
    size: float = 5.0
    fill: str = ""
    stroke: str = ""
    width: float = 1.0


@dataclass(frozen=True, eq=False)
class Word:
    """Words at a place (2,), which is at their ``side`` and at their middle height, ``upright`` if read from below."""

    text: str
    place: np.ndarray
    side: Literal["start", "middle", "end"] = "middle"
    colour: str = "soft"
    size: float = 7.5
    upright: bool = False
    bold: bool = False
    halo: bool = False


Item = Path | Mark | Word


@dataclass(frozen=True, eq=False)
class Sketch:
    """What is drawn on a sheet of a size (2,), points: the later above the earlier; y points up.

    ``inside`` are items that end at the edges of the ``window``: left, lower, right and upper.
    """

    size: tuple[float, float]
    items: Sequence[Item]
    inside: Sequence[Item] = ()
    window: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)


def svg(sketch: Sketch) -> str:
    """Write a sketch as an inline SVG without ids, whose colours are variables of the page's style sheet."""
    width, height = sketch.size
    left, low, right, high = sketch.window
    window = f'x="{left:.1f}" y="{height - high:.1f}" width="{right - left:.1f}" height="{high - low:.1f}"'
    clipped = "".join(_markup(each, -left, high) for each in sketch.inside)
    return (
        f'<svg viewBox="0 0 {width:.1f} {height:.1f}" stroke-linejoin="round">'
        f"{f'<svg {window}>{clipped}</svg>' if clipped else ''}"
        f"{''.join(_markup(each, 0.0, height) for each in sketch.items)}</svg>"
    )


def _markup(item: Item, right: float, top: float) -> str:
    """Write an item for a sheet whose upper edge is at ``top``, moved to the right."""
    match item:
        case Path():
            style = f"fill:{_variable(item.fill)};stroke:{_variable(item.stroke)}"
            style += f";stroke-width:{item.width:.3g}" if item.stroke else ""
            style += f";opacity:{item.opacity:.2g}" if item.opacity < 1 else ""
            style += f";stroke-dasharray:{' '.join(f'{each:.1f}' for each in item.dash)}" if item.dash else ""
            style += ";stroke-linecap:round" if item.round else ""
            return f'<path d="{_course(item.points, right, top)}{"Z" if item.fill else ""}" style="{style}"/>'
        case Mark():
            x, y = item.place[0] + right, top - item.place[1]
            style = f"fill:{_variable(item.fill)};stroke:{_variable(item.stroke)}"
            style += f";stroke-width:{item.width:.3g}" if item.stroke else ""
            if item.shape == "disc":
                return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{item.size / 2:.1f}" style="{style}"/>'
            return f'<path d="{_course(outline(item), right, top)}Z" style="{style}"/>'
        case Word():
            x, y = item.place[0] + right, top - item.place[1]
            turned = f' transform="rotate(-90 {x:.1f} {y:.1f})"' if item.upright else ""
            style = f"font-size:{item.size:.1f}px;fill:var(--{item.colour})" + ";font-weight:bold" * item.bold
            style += f";paint-order:stroke;stroke:var(--page);stroke-width:{HALO:g}" if item.halo else ""
            return (
                f'<text x="{x:.1f}" y="{y:.1f}" dy=".35em" text-anchor="{item.side}"{turned} style="{style}">'
                f"{escape(item.text)}</text>"
            )


def _variable(colour: str) -> str:
    return f"var(--{colour})" if colour else "none"


def _course(points: np.ndarray, right: float, top: float) -> str:
    """Write the commands of a path through points (K, 2)."""
    words, pen = [], "M"
    for x, y in (np.asarray(points, dtype=float) * (1.0, -1.0) + (right, top)).tolist():
        if x - x == 0 and y - y == 0:
            words.append(f"{pen}{x:.1f} {y:.1f}")
            pen = "L"
        else:
            pen = "M"
    return "".join(words)


def outline(mark: Mark) -> np.ndarray:
    """Return the corners (K, 2) of a mark that is no disc."""
    if mark.shape == "square":
        corners = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    else:
        angle = np.pi / 2 + 2 * np.pi * np.arange(CORNERS[mark.shape]) / CORNERS[mark.shape]
        corners = np.column_stack([np.cos(angle), np.sin(angle)]) * (2**0.5 if mark.shape == "diamond" else 1.0)
    return np.asarray(mark.place + mark.size / 2 * corners)


def draw_sketch(axes: Axes, sketch: Sketch, colours: dict[str, Any]) -> None:
    """Draw a sketch by Matplotlib, on axes that fill a figure of its size."""
    from matplotlib.patheffects import withStroke

    axes.set(xlim=(0.0, sketch.size[0]), ylim=(0.0, sketch.size[1]))
    axes.set_axis_off()
    for order, item in enumerate(sketch.items):
        match item:
            case Path() if item.fill:
                edge = colours[item.stroke] if item.stroke else "none"
                axes.fill(*item.points.T, facecolor=colours[item.fill], edgecolor=edge, linewidth=item.width,
                          alpha=item.opacity, zorder=order)  # fmt: skip
            case Path():
                axes.plot(*item.points.T, color=colours[item.stroke], linewidth=item.width, alpha=item.opacity,
                          solid_capstyle="round" if item.round else "butt", zorder=order)  # fmt: skip
            case Mark():
                face, edge = (colours[each] if each else "none" for each in (item.fill, item.stroke))
                axes.plot(*item.place, marker=SHAPES[item.shape], markersize=item.size, markerfacecolor=face,
                          markeredgecolor=edge, markeredgewidth=item.width, zorder=order)  # fmt: skip
            case Word():
                side = {"start": "left", "middle": "center", "end": "right"}[item.side]
                effects = [withStroke(linewidth=HALO, foreground=colours["page"])] if item.halo else []
                x, y = item.place.tolist()
                axes.text(x, y, item.text, ha=side, va="center", color=colours[item.colour], fontsize=item.size,
                          fontweight="bold" if item.bold else "normal", path_effects=effects, zorder=order)  # fmt: skip
