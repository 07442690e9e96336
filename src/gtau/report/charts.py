"""Charts and sketches drawn by Matplotlib: figures for notebooks and files."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from importlib.resources import as_file, files
from io import BytesIO
from math import ceil
from pathlib import Path
from textwrap import fill
from typing import Any, Literal

import numpy as np
from matplotlib import rc_context, rcdefaults, rcParams, style
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba_array
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator

from gtau.documents.files import write_atomically
from gtau.errors import GtauError
from gtau.report.chart import MINUS, NOT_USED, Axis, Chart, Panel, Series, Sketch, Word
from gtau.report.page import number
from gtau.report.robot_figure import sketch_of
from gtau.report.svg import LEVEL, NAMES, SMALLEST, STEPS, size_of_names
from gtau.robots.robot import Robot

ASSETS = files("gtau.report") / "assets"
WIDTH = 7.2  # inches, width of a figure
HALO = 2.4  # points, of the page's colour around words


@contextmanager
def styled() -> Iterator[None]:
    """Draw in the style of the package, and restore the user's settings afterwards."""
    roles = ("axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color")
    settings = dict.fromkeys(roles, palette()["soft"]) | {"grid.color": palette()["grid"]}
    with rc_context(), as_file(ASSETS / "figure.mplstyle") as path:
        rcdefaults()
        style.use(path)
        rcParams.update(settings)
        yield


@cache
def palette() -> Mapping[str, Any]:
    """Read the light colours of the style sheet by name."""
    text = (ASSETS / "light.css").read_text(encoding="utf-8")
    colours: dict[str, Any] = dict(re.findall(r"--([\w-]+): (#\w+);", text))
    for name, *parts in re.findall(r"--([\w-]+): rgba\((\d+), (\d+), (\d+), ([\d.]+)\)", text):
        *rgb, alpha = map(float, parts)
        colours[name] = (*(part / 255 for part in rgb), alpha)
    return colours


class ShownFigure(Figure):
    """A figure that pyplot does not know; a notebook shows it where a cell ends with it."""

    def _repr_png_(self) -> bytes:
        content = BytesIO()
        with styled():
            self.savefig(content, format="png")
        return content.getvalue()


def figure_of(chart: Chart) -> Figure:
    """Draw a chart as one figure, its panels in rows of ``columns``, its key above them."""
    rows = -(-len(chart.panels) // chart.columns)
    heights = [max(panel.height for panel in chart.panels[k * chart.columns :][: chart.columns]) for k in range(rows)]
    with styled():
        figure = ShownFigure(figsize=(WIDTH, 0.5 + 1.15 * sum(heights)), layout="constrained")
        shared: Any = "col" if chart.live else "none"
        grid = figure.subplots(rows, chart.columns, squeeze=False, height_ratios=heights, sharex=shared)
        places = grid.reshape(-1)
        for axes, panel in zip(places, chart.panels, strict=False):
            _draw(axes, panel, last=not chart.live or axes in grid[-1])
        for axes in places[len(chart.panels) :]:
            axes.set_axis_off()
        places[0].set_title(": ".join(filter(None, (chart.title, chart.panels[0].title))))
        handles: dict[str, Any] = {}
        for axes in places:
            handles.update(dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True)))
        if len(handles) > 1:
            figure.legend(list(handles.values()), list(handles), loc="outside upper center", ncols=min(len(handles), 3))
        if chart.caption:
            figure.supxlabel(fill(chart.caption, 100), fontsize="small", color=palette()["soft"])
        figure.align_ylabels()
    return figure


def robot_figure(robot: Robot) -> Figure:
    """Draw a robot at home; see :func:`gtau.report.robot_figure.sketch_of`."""
    sketch = sketch_of(robot)
    with styled():
        figure = ShownFigure(figsize=tuple(sketch.size / 72))
        _draw_sketch(figure, sketch)
    return figure


def save_figure(figure: Figure, path: str | Path) -> None:
    """Write a figure as PNG or PDF, atomically; the same figure gives the same bytes; raises GtauError."""
    kind = Path(path).suffix.lower().removeprefix(".")
    if kind not in ("png", "pdf"):
        raise GtauError(f"figures are written as PNG or PDF, so '{path}' would mislead; let its name end in .png.")
    content = BytesIO()
    with styled():
        figure.savefig(content, format=kind, metadata={"Software": None} if kind == "png" else {"CreationDate": None})
    write_atomically(path, content.getvalue())


def _draw(axes: Axes, panel: Panel, last: bool = True) -> None:
    """Draw a panel; the horizontal axis is labelled on the ``last`` one."""
    if panel.matrix is not None:  # correlations by the strength of two colours
        hues = to_rgba_array([palette()["positive"], palette()["negative"]])[(panel.matrix < 0).astype(int)]
        hues[..., 3] = np.abs(panel.matrix)
        axes.imshow(hues, interpolation="none", aspect="equal")
        axes.grid(False)
    if panel.band is not None:
        axes.axhspan(*panel.band, color=palette()["shade"], linewidth=0)
    for start, stop in () if panel.shaded is None else panel.shaded.reshape(-1, 2):
        axes.axvspan(start, stop, color=palette()["shade"], linewidth=0, label=NOT_USED)
    _draw_rules(axes, panel)
    for series in panel.series:
        _draw_series(axes, series)
    _draw_axis(axes, panel.x, "x")
    _draw_axis(axes, panel.y, "y")
    axes.set(title=panel.title, xlabel=panel.x.label if last else "", ylabel=panel.y.label)
    if panel.y.names:
        axes.grid(False, axis="y")
        axes.spines["left"].set_visible(False)
    if panel.x.names:
        axes.grid(False, axis="x")


def _draw_rules(axes: Axes, panel: Panel) -> None:
    """Draw dashed lines across a panel; the first label is left of its line, further ones right, so that all show."""
    dashed: dict[str, Any] = {"color": palette()["soft"], "linewidth": 0.8, "linestyle": (0, (3, 3))}
    upright = sorted((rule.x, rule.label) for rule in panel.rules if rule.x is not None)
    for k, (x, label) in enumerate(upright):
        axes.axvline(x, **dashed)
        place: dict[str, Any] = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points"}
        side, offset = ("left", 2.0) if k else ("right", -2.0)
        axes.annotate(label, (x, 1.0), (offset, -2.0), **place, rotation=90, va="top", ha=side,
                      fontsize="small", color=palette()["soft"])  # fmt: skip
    for rule in panel.rules:
        if rule.y is not None:
            axes.axhline(rule.y, **dashed)


def _draw_axis(axes: Axes, axis: Axis, which: Literal["x", "y"]) -> None:
    ticks = axes.xaxis if which == "x" else axes.yaxis
    if axis.log:
        axes.set(**{f"{which}scale": "log"})
        low, high = ticks.get_view_interval()
        few = LogLocator(subs=(1.0, 2.0, 5.0) if high < 100 * low else (1.0,), numticks=6)
        ticks.set_major_locator(few if high > 5 * low else MaxNLocator(5, steps=STEPS))
        ticks.set_minor_locator(NullLocator())
        ticks.set_major_formatter(lambda value, _: number(value).replace("-", MINUS))
    else:
        ticks.set_major_locator(MaxNLocator(5, steps=STEPS))
    if axis.names:
        shown = list(axis.names.items())[:: ceil(SMALLEST * len(axis.names) / NAMES)]
        places, names = zip(*shown, strict=True)
        ticks.set_ticks(places, names, fontsize=size_of_names(axis, float(rcParams["font.size"])))
        long = sum(len(name) + 1 for name in names) > LEVEL
        ticks.set_tick_params(rotation=90 if which == "x" and long else 0)
    if any(end is not None for end in axis.limits):
        axes.set(**{f"{which}lim": axis.limits})


def _draw_series(axes: Axes, series: Series) -> None:
    look: dict[str, Any] = {"color": palette()[series.colour], "label": series.label or None}
    if series.mark == "steps":
        axes.stairs(series.y, series.x, linewidth=series.width, **look)
    elif series.mark == "spans":
        spans = [(start, stop - start) for start, stop in series.x]
        axes.broken_barh(spans, (float(series.y[0]) - 0.35, 0.7), color=look["color"], linewidth=0)
    elif series.mark == "line":
        dashes = (0, series.dashes) if series.dashes else "-"
        axes.plot(*series.thinned(), linewidth=series.width, linestyle=dashes, **look)
    elif series.mark == "points":  # one path of dots: very short lines with round caps
        size, nothing = 2 + series.width, np.full(len(series.x), np.nan)
        shifted = series.x + 1e-6 * (np.ptp(series.x) or np.abs(series.x[0]) or 1.0)
        x = np.column_stack([series.x, shifted, nothing]).ravel()
        y = np.column_stack([series.y, series.y, nothing]).ravel()
        axes.plot(x, y, linewidth=size, solid_capstyle="round", snap=False, color=look["color"])
        axes.plot([], [], "o", markersize=size, markeredgewidth=0.0, **look)  # in the key
        axes.margins(x=0.03)
    else:
        half = np.zeros(len(series.x)) if series.half is None else series.half
        marks: dict[str, dict[str, Any]] = {
            "disc": {"marker": "o", "elinewidth": 1.2, "capsize": 3},
            "diamond": {"marker": "D", "markerfacecolor": palette()["page"], "elinewidth": 0, "capsize": 0},
            "thick": {"marker": "", "elinewidth": 4, "capsize": 0},
        }
        look |= {"yerr" if series.upright else "xerr": half, "linestyle": "none", "markersize": 4.5}
        axes.errorbar(series.x, series.y, **marks[series.mark], **look)
        axes.margins(x=0.06, y=0.1)


def _draw_sketch(figure: Figure, sketch: Sketch) -> None:
    halo = [withStroke(linewidth=HALO, foreground=palette()["page"])]
    sides = {"start": "left", "middle": "center", "end": "right"}
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    look: dict[str, Any]
    for order, item in enumerate(sketch.items):
        if isinstance(item, Word):
            look = {"fontsize": item.size, "fontweight": "bold" if item.bold else "normal"}
            look |= {"color": palette()[item.colour], "path_effects": halo, "zorder": order}
            axes.text(item.place[0], item.place[1], item.text, ha=sides[item.side], va="center", **look)
        elif item.closed:
            fill = palette()[item.fill] if item.fill else "none"
            axes.fill(*item.points.T, facecolor=fill, edgecolor=palette()[item.stroke],
                      linewidth=item.width, alpha=item.opacity, zorder=order)  # fmt: skip
        else:
            look = {"color": palette()[item.stroke], "linewidth": item.width, "solid_capstyle": "round"}
            axes.plot(*item.points.T, **look, zorder=order)
    ends = np.column_stack([sketch.corner, sketch.corner + sketch.size])
    axes.set(xlim=ends[0], ylim=ends[1])
    axes.set_axis_off()
