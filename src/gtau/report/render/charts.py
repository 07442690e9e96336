"""Charts and sketches by Matplotlib: figures for files and notebooks."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib.resources import as_file, files
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from gtau.documents.files import write_atomically
from gtau.errors import GtauError
from gtau.report.chart import MINUS, Axis, Chart, Panel, Series, Sketch, Word
from gtau.report.page import number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ASSETS = files("gtau.report.render") / "assets"
WIDTH = 7.2  # inches, of a figure
NAMES = 220.0  # points, that the names at an axis share
HALO = 2.4  # points, of the page's colour around words


@contextmanager
def styled() -> Iterator[None]:
    """Draw in the style of the package; afterwards the user's settings are as before."""
    from matplotlib import rc_context, rcdefaults, style

    with rc_context(), as_file(ASSETS / "figure.mplstyle") as path:
        rcdefaults()
        style.use(path)
        yield


@cache
def palette() -> dict[str, Any]:
    """Read the colours of the style sheet by name, as Matplotlib takes them."""
    text = (ASSETS / "light.css").read_text(encoding="utf-8")
    colours: dict[str, Any] = dict(re.findall(r"--([\w-]+): (#\w+);", text))
    for name, *parts in re.findall(r"--([\w-]+): rgba\((\d+), (\d+), (\d+), ([\d.]+)\)", text):
        *rgb, alpha = map(float, parts)
        colours[name] = (*(part / 255 for part in rgb), alpha)
    return colours


@cache
def shown_figure() -> type[Figure]:
    """Make the class of figures that show themselves in a notebook without pyplot; imports Matplotlib."""
    from matplotlib.figure import Figure

    class ShownFigure(Figure):
        """A figure unknown to pyplot, drawn where a notebook cell ends with it."""

        def _repr_png_(self) -> bytes:
            content = BytesIO()
            with styled():
                self.savefig(content, format="png")
            return content.getvalue()

    return ShownFigure


def figure_of(chart: Chart) -> Figure:
    """Draw a chart as one figure, its panels in rows of ``columns``, its key above them."""
    rows = -(-len(chart.panels) // chart.columns)
    heights = [max(panel.height for panel in chart.panels[k * chart.columns :][: chart.columns]) for k in range(rows)]
    with styled():
        figure = shown_figure()(figsize=(WIDTH, 0.5 + 1.15 * sum(heights)), layout="constrained")
        grid = figure.subplots(
            rows, chart.columns, squeeze=False, height_ratios=heights, sharex="col" if chart.live else "none"
        )
        places = grid.reshape(-1)
        for axes, panel in zip(places, chart.panels, strict=False):
            draw(axes, panel, last=not chart.live or axes in grid[-1])
        for axes in places[len(chart.panels) :]:
            axes.set_axis_off()
        first, label = places[0], chart.panels[0].title
        first.set_title(": ".join(filter(None, (chart.title, label))))
        handles: dict[str, Any] = {}
        for axes in places:
            handles.update(dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True)))
        if len(handles) > 1:
            figure.legend(list(handles.values()), list(handles), loc="outside upper center", ncols=min(len(handles), 3))
        figure.align_ylabels()
    return figure


def draw(axes: Axes, panel: Panel, last: bool = True) -> None:
    """Draw a panel; the horizontal axis is labelled on the ``last`` one."""
    from matplotlib.colors import to_rgba_array

    colours = palette()
    if panel.matrix is not None:  # correlations by the strength of two colours on the page's own
        hues = to_rgba_array([colours["positive"], colours["negative"]])[(panel.matrix < 0).astype(int)]
        hues[..., 3] = np.abs(panel.matrix)
        axes.imshow(hues, interpolation="none", aspect="equal")
    if panel.band is not None:
        axes.axhspan(*panel.band, color=colours["shade"], linewidth=0)
    for start, stop in () if panel.shaded is None else panel.shaded.reshape(-1, 2):
        axes.axvspan(start, stop, color=colours["shade"], linewidth=0)
    for rule in panel.rules:
        dashed: dict[str, Any] = {"color": colours["soft"], "linewidth": 0.8, "linestyle": (0, (3, 3))}
        if rule.y is not None:
            axes.axhline(rule.y, **dashed)
        if rule.x is not None:
            axes.axvline(rule.x, **dashed)
        if rule.label and rule.x is not None:
            place: dict[str, Any] = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points"}
            axes.annotate(rule.label, (rule.x, 1.0), (-2.0, -2.0), **place, rotation=90, va="top", ha="right",
                          fontsize="small", color=colours["soft"])  # fmt: skip
    for series in panel.series:
        _draw_series(axes, series)
    _draw_axis(axes, panel.x, "x")
    _draw_axis(axes, panel.y, "y")
    axes.set(title=panel.title, xlabel=panel.x.label if last else "", ylabel=panel.y.label)
    if panel.matrix is not None:
        axes.grid(False)
    if panel.y.names:
        axes.grid(False, axis="y")
        axes.spines["left"].set_visible(False)
    if panel.equal:
        axes.set_aspect("equal", adjustable="datalim")


def _draw_axis(axes: Axes, axis: Axis, which: Literal["x", "y"]) -> None:
    from matplotlib import rcParams
    from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator

    ticks = axes.xaxis if which == "x" else axes.yaxis
    if axis.log:
        axes.set(**{f"{which}scale": "log"})
        low, high = ticks.get_view_interval()
        ticks.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 20 * low else (1.0,), numticks=6))
        ticks.set_minor_locator(NullLocator())
        ticks.set_major_formatter(lambda value, _: number(value).replace("-", MINUS))
    else:
        ticks.set_major_locator(MaxNLocator(5))
    if axis.names:
        size = min(rcParams["font.size"], NAMES / len(axis.names))
        ticks.set_ticks(list(axis.names), list(axis.names.values()), fontsize=size)
        ticks.set_tick_params(rotation=90 if which == "x" else 0)
    if any(end is not None for end in axis.limits):
        axes.set(**{f"{which}lim": axis.limits})


def _draw_series(axes: Axes, series: Series) -> None:
    colours = palette()
    colour = colours[series.colour]
    look: dict[str, Any] = {"label": series.label or None}
    if series.mark == "steps":
        axes.stairs(series.y, series.x, color=colour, linewidth=series.width, **look)
    elif series.mark == "spans":
        spans = [(start, stop - start) for start, stop in series.x]
        axes.broken_barh(spans, (float(series.y[0]) - 0.35, 0.7), color=colour, linewidth=0)
    elif series.mark == "line":
        style = (0, series.dashes) if series.dashes else "-"
        axes.plot(*series.thinned(), color=colour, linewidth=series.width, linestyle=style, **look)
    elif series.mark == "points":
        look |= {"markersize": 2 + series.width, "markeredgewidth": 0.0}
        axes.plot(series.x, series.y, "o", color=colour, **look)
        axes.margins(x=0.03)
    else:
        half = np.zeros(len(series.x)) if series.half is None else series.half
        marks: dict[str, dict[str, Any]] = {
            "disc": {"marker": "o", "elinewidth": 1.2, "capsize": 3},
            "diamond": {"marker": "D", "markerfacecolor": colours["page"], "elinewidth": 0, "capsize": 0},
            "thick": {"marker": "", "elinewidth": 4, "capsize": 0},
        }
        look |= {"yerr" if series.upright else "xerr": half, "color": colour, "linestyle": "none", "markersize": 4.5}
        axes.errorbar(series.x, series.y, **marks[series.mark], **look)
        axes.margins(x=0.06, y=0.1)


def figure_of_sketch(sketch: Sketch) -> Figure:
    """Draw a sketch on axes that fill a figure of its size."""
    from matplotlib.patheffects import withStroke

    colours = palette() | {"": "none"}
    sides = {"start": "left", "middle": "center", "end": "right"}
    look: dict[str, Any]
    halo = withStroke(linewidth=HALO, foreground=colours["page"])
    with styled():
        figure = shown_figure()(figsize=tuple(sketch.size / 72))
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        for order, item in enumerate(sketch.items):
            if isinstance(item, Word):
                look = {"fontsize": item.size, "fontweight": "bold" if item.bold else "normal"}
                look |= {"color": colours[item.colour], "path_effects": [halo], "zorder": order}
                axes.text(item.place[0], item.place[1], item.text, ha=sides[item.side], va="center", **look)
            elif item.closed:
                axes.fill(*item.points.T, facecolor=colours[item.fill], edgecolor=colours[item.stroke],
                          linewidth=item.width, alpha=item.opacity, zorder=order)  # fmt: skip
            else:
                look = {"color": colours[item.stroke], "linewidth": item.width, "solid_capstyle": "round"}
                axes.plot(*item.points.T, **look, zorder=order)
        ends = np.column_stack([sketch.corner, sketch.corner + sketch.size])
        axes.set(xlim=ends[0], ylim=ends[1])
        axes.set_axis_off()
    return figure


def save(chart: Chart, path: Path) -> Path:
    """Write a chart as a figure; see :func:`save_figure`."""
    save_figure(figure_of(chart), path)
    return path


def save_figure(figure: Figure, path: str | Path) -> None:
    """Write a figure as PNG or PDF, atomically; the same figure gives the same bytes.

    Raises
    ------
    GtauError
        Where the file's name does not end in ``.png`` or ``.pdf``, or it cannot be written.
    """
    kind = Path(path).suffix.lower().removeprefix(".")
    if kind not in ("png", "pdf"):
        raise GtauError(f"figures are written as PNG or PDF, so '{path}' would mislead; let its name end in .png.")
    content = BytesIO()
    with styled():
        figure.savefig(content, format=kind, metadata={"Software": None} if kind == "png" else {"CreationDate": None})
    write_atomically(path, content.getvalue())
