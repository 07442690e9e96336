"""Pages as data; :mod:`gtau.report.terminal` and :mod:`gtau.report.html` write them.

A page has sections of tables, charts, texts, facts and drawings of robots. Table cells are values; the column formats
them. A new section is a function that returns a :class:`Section` and one line in the list of a page.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import isfinite
from operator import attrgetter
from typing import Any, Literal

import numpy as np

from gtau.findings import to_width
from gtau.report.chart import Chart
from gtau.robots.robot import Robot

BADGES = {
    **dict.fromkeys(("given", "good", "passed", "agrees"), "good"),
    **dict.fromkeys(("not identifiable", "contradictory", "refused", "failed", "error", "contradicted"), "bad"),
    **dict.fromkeys(("information", "not stated"), "neutral"),
}
"""Style of verdicts, grades and results; others are shown as weak."""


class Kind(StrEnum):
    """Content of a column's cells. Any cell may hold a text instead, or None, shown as ``missing``."""

    TEXT = "text"
    SENTENCE = "sentence"  # given without capital letter and full stop
    NAME = "name"  # of a parameter, file or method, in a fixed-width font
    NUMBER = "number"
    SHARE = "share"  # from 0 to 1, shown in per cent
    INTERVAL = "interval"  # both ends
    SPREAD = "spread"  # a value and the half-width of its interval
    BADGE = "badge"  # a key of BADGES


NUMERIC = (Kind.NUMBER, Kind.SHARE, Kind.INTERVAL, Kind.SPREAD)


@dataclass(frozen=True)
class Column:
    """A column: title, kind of its cells, and format of its numbers.

    ``digits`` counts significant digits; ``decimals`` fixes the decimals instead. Numbers above ``most`` are written as
    ``> most``. Terminals leave out ``wide`` columns.
    """

    title: str
    kind: Kind = Kind.TEXT
    digits: int = 4
    decimals: int | None = None
    missing: str = "-"
    most: float = float("inf")
    wide: bool = False

    def text(self, cell: Any) -> str:
        """Format a cell, with a hyphen before negative numbers."""
        if isinstance(cell, str):
            return cell
        if cell is None or (isinstance(cell, float) and not isfinite(cell)):
            return self.missing
        if self.kind == Kind.INTERVAL:
            return " to ".join(to_width(end, (cell[1] - cell[0]) / 2) for end in cell)
        if self.kind == Kind.SPREAD:
            value, half = cell
            return number(value, self.digits) if not half else f"{to_width(value, half)} ± {to_width(half, half)}"
        value = 100 * cell if self.kind == Kind.SHARE else cell
        if value > self.most:
            return f"> {self.most:g}"
        return f"{value:z.{self.decimals}f}" if self.decimals is not None else number(value, self.digits)

    def sort_key(self, cell: Any) -> float | None:
        """Return the number by which a cell sorts, None for a missing value."""
        if cell is None or isinstance(cell, str):
            return None
        key = cell[1] - cell[0] if self.kind == Kind.INTERVAL else cell[0] if self.kind == Kind.SPREAD else cell
        return float(key) if isfinite(key) else None


def number(value: float, digits: int = 5) -> str:
    """Format a number with significant digits: 1.5e-7, not 1.5e-07, and 110, not 1.1e2."""
    if isinstance(value, (int, np.integer)):
        return str(value)
    return f"{float(f'{value:.{digits}g}'):.{max(digits, 5)}g}".replace("e-0", "e-").replace("e+0", "e")


@dataclass(frozen=True)
class Table:
    """A table of rows of cells.

    In HTML, readers can sort and search a table with a ``name``. Rows in ``faint`` are dimmed. Terminals show a
    ``listed`` table as a list, grouped by badge.
    """

    columns: Sequence[Column]
    rows: Sequence[Sequence[Any]]
    name: str = ""
    faint: frozenset[int] = frozenset()
    listed: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "rows", tuple(map(tuple, self.rows)))


ColumnOf = tuple[Column, str | Callable[[Any], Any]]
"""A column, and the attribute of an item (``"a.b"``) or the function that gives its cell."""


def table_of(items: Iterable[Any], *columns: ColumnOf, **more: Any) -> Table:
    """Make a table with one row per item."""
    cells = [attrgetter(cell) if isinstance(cell, str) else cell for _, cell in columns]
    return Table([column for column, _ in columns], [[cell(item) for cell in cells] for item in items], **more)


@dataclass(frozen=True)
class Text:
    """A paragraph and a list of sentences: plain, soft, a command, or a verdict in a style of BADGES."""

    words: str
    points: tuple[str, ...] = ()
    style: Literal["plain", "soft", "command", "good", "weak", "bad", "neutral"] = "plain"


@dataclass(frozen=True)
class Facts:
    """Values by name, without those that are None."""

    pairs: Mapping[str, object]

    def __post_init__(self) -> None:
        known = {name: value for name, value in self.pairs.items() if value is not None}
        object.__setattr__(self, "pairs", known)


class Section:
    """A titled part of a page with the items that are not None.

    It is foldable unless ``folded`` is None; True folds it at first.
    """

    def __init__(self, title: str, *items: Item | None, id: str = "", folded: bool | None = None) -> None:
        self.title, self.id, self.folded = title, id, folded
        self.items: list[Item] = [item for item in items if item is not None]


Item = Table | Text | Facts | Chart | Robot | Section
"""Items of a section; a robot is drawn in its home pose."""


class Page:
    """The output of a command: title, lines below it (``lead``), and the sections that have items."""

    def __init__(self, title: str, *sections: Section | None, lead: Iterable[str] = ()) -> None:
        self.title, self.lead = title, tuple(lead)
        self.sections = [section for section in sections if section is not None and section.items]


def joint_label(joint: str) -> str:
    """Label a joint: ``joint 11``, but ``elbow_joint`` as it is."""
    return joint if "joint" in joint.lower() else f"joint {joint}"
