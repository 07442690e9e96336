"""Pages as data, written once for each command; :mod:`gtau.report.render` has one renderer for each medium.

A page consists of sections of tables, charts, texts, facts and drawings of robots. Cells are values, not words: numbers
keep all their digits, and a column says how they are written.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import isfinite
from operator import attrgetter
from typing import Any, Literal

import numpy as np

from gtau.findings.words import to_width
from gtau.report.chart import Chart
from gtau.robots.robot import Robot

BADGES = {
    "given": "good",
    "good": "good",
    "weak": "weak",
    "not identifiable": "bad",
    "contradictory": "bad",
    "refused": "bad",
    "passed": "good",
    "failed": "bad",
    "error": "bad",
    "warning": "weak",
    "information": "neutral",
}
"""Outcomes and grades of findings to the style that they are shown in; what is not listed is weak."""


class Kind(StrEnum):
    """What the cells of a column are; a text in place of a value is written as it is, None as ``missing``."""

    TEXT = "text"
    SENTENCE = "sentence"  # without capital letter and full stop
    NAME = "name"  # of a parameter, file or method: letters of equal width
    NUMBER = "number"
    SHARE = "share"  # a number between 0 and 1, shown in per cent
    INTERVAL = "interval"  # its two ends
    SPREAD = "spread"  # a value and half the width of its interval
    BADGE = "badge"  # an outcome or a grade


NUMERIC = (Kind.NUMBER, Kind.SHARE, Kind.INTERVAL, Kind.SPREAD)


@dataclass(frozen=True)
class Column:
    """A column: title, kind of its cells, and how numbers are written.

    ``digits`` are significant ones; ``decimals`` fixes the number of decimals instead. A number above ``most`` is
    written as ``> most``. A ``wide`` column is left out on a terminal.
    """

    title: str
    kind: Kind = Kind.TEXT
    digits: int = 4
    decimals: int | None = None
    missing: str = "-"
    most: float = float("inf")
    wide: bool = False

    def text(self, cell: Any) -> str:
        """Write a cell, negative numbers with a hyphen."""
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
        if self.kind not in NUMERIC:
            return str(value)
        if value > self.most:
            return f"> {self.most:g}"
        return f"{value:z.{self.decimals}f}" if self.decimals is not None else number(value, self.digits)

    def sort_key(self, cell: Any) -> float | None:
        """Return what a cell of numbers sorts by, None for a missing one."""
        if cell is None or isinstance(cell, str):
            return None
        key = cell[1] - cell[0] if self.kind == Kind.INTERVAL else cell[0] if self.kind == Kind.SPREAD else cell
        return float(key) if isfinite(key) else None


def number(value: float, digits: int = 5) -> str:
    """Write a number to the given significant digits, as people write it."""
    if isinstance(value, (int, np.integer)):
        return str(value)
    return f"{value:.{digits}g}".replace("e-0", "e-").replace("e+0", "e")


@dataclass(frozen=True)
class Table:
    """A table.

    A table with a ``name`` sorts and searches where the medium can. Rows in ``faint`` are shown faint. With ``listed``
    a terminal shows the rows as a list, grouped by their badge.
    """

    columns: tuple[Column, ...]
    rows: tuple[tuple[Any, ...], ...]
    name: str = ""
    faint: frozenset[int] = frozenset()
    listed: bool = False


def table(columns: Iterable[Column], rows: Iterable[Sequence[Any]], **more: Any) -> Table:
    """Make a table of any iterables."""
    return Table(tuple(columns), tuple(map(tuple, rows)), **more)


ColumnOf = tuple[Column, str | Callable[[Any], Any]]
"""A column with what its cells are: the name of an attribute of the row's item, or a function of it."""


def table_of(items: Iterable[Any], *columns: ColumnOf, **more: Any) -> Table:
    """Make a table with a row for each item."""
    cells = [attrgetter(cell) if isinstance(cell, str) else cell for _, cell in columns]
    return table([column for column, _ in columns], [[cell(item) for cell in cells] for item in items], **more)


@dataclass(frozen=True)
class Text:
    """A paragraph and a list of sentences: plain, soft, a command, or a verdict with its grade."""

    words: str
    points: tuple[str, ...] = ()
    style: Literal["plain", "soft", "command", "good", "weak", "bad", "neutral"] = "plain"


@dataclass(frozen=True)
class Facts:
    """Values by name; those that are None are left out."""

    pairs: Mapping[str, object]

    def __post_init__(self) -> None:
        there = {name: value for name, value in self.pairs.items() if value is not None}
        object.__setattr__(self, "pairs", there)


@dataclass(frozen=True, eq=False)
class Section:
    """A titled part of a page; one inside another may be ``folded`` away (True) or unfolded (False)."""

    title: str
    items: tuple[Item, ...]
    id: str = ""
    folded: bool | None = None


Item = Table | Text | Facts | Chart | Robot | Section
"""What a section holds; a robot is drawn at home."""


@dataclass(frozen=True, eq=False)
class Page:
    """What a command shows: a title, lines below it, and sections in reading order."""

    title: str
    sections: tuple[Section, ...]
    lead: tuple[str, ...] = ()


def section(title: str, *items: Item | None, id: str = "", folded: bool | None = None) -> Section:
    """Make a section of the items that are there."""
    return Section(title, tuple(item for item in items if item is not None), id, folded)


def page(title: str, *sections: Section | None, lead: Iterable[str] = ()) -> Page:
    """Make a page of the sections that are there and hold something."""
    return Page(title, tuple(part for part in sections if part is not None and part.items), tuple(lead))


def joint_label(joint: str) -> str:
    """Label a joint: ``joint 11``, but ``elbow_joint`` as it is."""
    return joint if "joint" in joint.lower() else f"joint {joint}"
