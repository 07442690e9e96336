"""Charts as data: axes, series, bands and rules; :mod:`gtau.report.render` draws them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np


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
        found: dict[str, Series] = {}
        for panel in self.panels:
            for each in panel.series:
                if each.label:
                    found.setdefault(each.label, each)
        return found


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
    """Make a panel of values with their intervals, a row each, of the random part and of what they are compared with.

    Parameters
    ----------
    names : sequence of str
        Of the rows.
    values, halves : sequence of float
        Values and half the widths of their 95 % intervals; None where there is none.
    axis : str
        Label of the horizontal axis, with unit.
    inner : sequence of float, optional
        Half the widths of the random parts.
    other : (str, sequence of float), optional
        What the values are compared with, and its values.
    zero : bool
        Whether zero is marked.
    """

    def columns(at: Sequence[float | None], half: Sequence[float | None]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        rows = [k for k, value in enumerate(at) if value is not None]
        widths = [half[k] if k < len(half) else None for k in rows]
        return (
            np.array([at[k] for k in rows], dtype=float),
            np.array(rows, dtype=float),
            np.array([width or 0.0 for width in widths], dtype=float),
        )

    x, y, half = columns(values, halves)
    series = [Series("value, 95 % interval", x, y, "predicted", "disc", half=half)]
    if any(each is not None for each in inner):
        series.append(Series("random part", x, y, "predicted", "thick", half=columns(values, inner)[2]))
    if any(each is not None for each in other[1]):
        a, b, _ = columns(other[1], ())
        series.append(Series(other[0], a, b, "prior", "diamond"))
    places = Axis("", limits=(len(names) - 0.4, -0.6), names={float(k): name for k, name in enumerate(names)})
    return Panel(
        Axis(axis), places, tuple(series), rules=(Rule(x=0.0),) if zero else (), height=0.62 + 0.27 * len(names)
    )
