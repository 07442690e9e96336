"""One look for all figures: lines differ in style and marker as well as in colour, so that they survive a copier."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib.util import find_spec
from io import BytesIO
from math import floor, log10
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from gtau.documents.files import write_atomically
from gtau.errors import GtauError, install_command, missing_extra

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's colours, which colour-blind people tell apart.
BLACK, ORANGE, SKY, GREEN, BLUE, VERMILION = "#000000", "#E69F00", "#56B4E9", "#009E73", "#0072B2", "#D55E00"
PURPLE = "#CC79A7"
GREY = "#767676"

LINES: tuple[dict[str, Any], ...] = (
    {"color": BLUE, "linestyle": "-"},
    {"color": VERMILION, "linestyle": (0, (5, 1.6))},
    {"color": GREEN, "linestyle": (0, (5, 1.4, 1, 1.4))},
    {"color": BLACK, "linestyle": (0, (1, 1.3))},
    {"color": ORANGE, "linestyle": (0, (8, 2))},
    {"color": SKY, "linestyle": (0, (3, 1, 1, 1, 1, 1))},
    {"color": PURPLE, "linestyle": "-"},
    {"color": GREY, "linestyle": (0, (5, 1.6))},
)
"""How the lines of joints are drawn, in their order; a ninth begins again."""

PRIOR: dict[str, Any] = {"color": VERMILION, "marker": "D", "markerfacecolor": "white"}
IDENTIFIED: dict[str, Any] = {"color": BLUE, "marker": "o"}
"""How values found with the prior gains, and with the identified ones, are drawn."""

STYLE: dict[Any, Any] = {
    "font.family": "sans-serif",
    "text.parse_math": False,  # names of users may hold a $
    "font.sans-serif": ["DejaVu Sans"],  # comes with matplotlib, so that figures look the same everywhere
    "font.size": 9,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titlepad": 7,
    "axes.labelsize": 9,
    "axes.edgecolor": "#444444",
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "grid.color": "#E4E4E4",
    "grid.linewidth": 0.7,
    "xtick.color": "#444444",
    "ytick.color": "#444444",
    "xtick.labelcolor": BLACK,
    "ytick.labelcolor": BLACK,
    "lines.linewidth": 1.3,
    "lines.markersize": 6,
    "lines.markeredgewidth": 1.6,
    "errorbar.capsize": 4,
    "legend.frameon": False,
    "legend.fontsize": 9,
    "legend.handlelength": 2.6,
    "figure.dpi": 150,
}


def has_matplotlib() -> bool:
    """Decide whether matplotlib is installed."""
    return find_spec("matplotlib") is not None


def require_matplotlib() -> None:
    """Refuse to draw where matplotlib is not installed."""
    if not has_matplotlib():
        raise missing_extra("drawing figures", "matplotlib", "plot")


def skipped_figures() -> list[str]:
    """Note the PNG figures that were not drawn; empty where matplotlib is installed."""
    if has_matplotlib():
        return []
    return [f"no PNG figures, as matplotlib is not installed; install it with: {install_command('plot')}"]


@contextmanager
def styled() -> Iterator[None]:
    """Draw in the style of the package; afterwards the user's settings of matplotlib are as they were."""
    import matplotlib

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(STYLE)
        yield


def new_figure(width: float, height: float) -> Figure:
    """Make an empty figure, inches, without a window and known to no pyplot; it shows itself in notebooks."""
    require_matplotlib()
    return _shown_figure()(figsize=(width, height), layout="constrained")


@cache
def _shown_figure() -> type[Figure]:
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


def light_grid(axes: Axes, axis: Literal["both", "x", "y"] = "both") -> None:
    """Draw a faint grid without tick marks."""
    axes.grid(True, axis=axis)
    axes.tick_params(length=0)


def joint_label(joint: str) -> str:
    """Label a joint in a figure: ``joint 11``, but ``elbow_joint`` as it is."""
    return joint if "joint" in joint.lower() else f"joint {joint}"


def with_interval(value: float, half: float) -> str:
    """Write a value and half its interval, to two digits of the latter."""
    digits = max(0, 1 - floor(log10(half))) if half > 0 else 4
    return f"{value:.{digits}f} ± {half:.{digits}f}"


def value_label(axes: Axes, text: str, x: float, y: float, color: str) -> None:
    """Write a value above its marker."""
    axes.annotate(
        text,
        (x, y),
        xytext=(0, 9),
        textcoords="offset points",
        ha="center",
        va="bottom",
        color=color,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
    )


def save_figure(figure: Figure, path: str | Path) -> None:
    """Write a figure as PNG, atomically; the same figure gives the same bytes.

    Raises
    ------
    GtauError
        Where the file's name does not end in ``.png``, or it cannot be written.
    """
    if Path(path).suffix.lower() != ".png":
        raise GtauError(f"figures are written as PNG, so '{path}' would mislead; let its name end in .png.")
    content = BytesIO()
    with styled():
        figure.savefig(content, format="png", metadata={"Software": None})
    write_atomically(path, content.getvalue())
