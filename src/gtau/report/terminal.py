"""Pages on a terminal: text of 80 columns, coloured only on a screen."""

from __future__ import annotations

import re
import sys
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from io import StringIO
from itertools import groupby
from typing import Any, Literal

from rich.console import Console, Group, RenderableType
from rich.table import Table as RichTable
from rich.text import Text as RichText

from gtau.errors import tidy
from gtau.report.page import BADGES, NUMERIC, Column, Facts, Kind, Page, Section, Table, Text

WIDTH = 80
GAP = 2
LONGEST = 40  # characters of the longest unbroken word
COLOURS = {"good": "green", "weak": "yellow", "bad": "bold red"}
ASCII = str.maketrans({"±": "+-", "\N{EN DASH}": "-", "\N{MINUS SIGN}": "-", "×": "x", "²": "2", "‘": "'", "’": "'"})


def show(page: Page) -> None:
    """Print a page on stdout, coloured on a terminal."""
    if sys.stdout.isatty():
        Console(width=WIDTH, highlight=False).print(rendered(page), crop=False)
    else:
        print(plain(page))


def plain(page: Page) -> str:
    """Write a page as plain text."""
    console = Console(width=WIDTH, file=StringIO(), color_system=None, highlight=False, legacy_windows=False)
    console.print(rendered(page), crop=False)
    return "\n".join(line.rstrip() for line in console.file.getvalue().splitlines())  # type: ignore[attr-defined]


def rendered(page: Page) -> Group:
    """Lay out a page for a console."""
    parts: list[RenderableType] = [*_lines([page.title], style="bold"), *_lines(page.lead)] if page.title else []
    for section in page.sections:
        body = list(_items(section.items))
        if body:
            title = _ascii(f"{section.title} ")
            parts += [RichText(title + "-" * (WIDTH - len(title)), style="bold")] if section.title else []
            parts += body
    return Group(*parts)


def _items(items: Iterable[Any]) -> Iterator[RenderableType]:
    for item in items:
        match item:
            case Table():
                yield from _list(item) if item.listed else _table(item)
            case Text():
                yield from _lines([item.words] if item.words else [], style=COLOURS.get(item.style, ""))
                yield from _lines(item.points, "- ")
            case Facts():
                yield from _facts(item)
            case Section():
                body = list(_items(item.items))
                yield from [*_lines([item.title]), *body] if body else []


def _badge(outcome: str) -> str:
    return COLOURS.get(BADGES.get(outcome, "weak"), "")


def _ascii(words: str) -> str:
    return tidy(" ".join(words.split("\n")).translate(ASCII))


def _kept(words: str) -> str:
    """Write words in ASCII, with no-break spaces before and within units."""
    return re.sub(
        r"(?<=\d) (?=%|[A-Za-z]{1,3}\d?\b)|(?<=\bN) (?=m\b)|(?<=\bkg) (?=m)|(?<=\bm) (?=s/)", "\xa0", _ascii(words)
    )


def _broken(words: str, width: int = WIDTH, margin: int = 0) -> list[str]:
    """Break words at spaces into lines; paths, and numbers with their units, stay in one piece."""
    lines = textwrap.wrap(
        _kept(words), max(width, 1), subsequent_indent=" " * margin, break_long_words=False, break_on_hyphens=False
    )
    return [line.replace("\xa0", " ") for line in lines]


def _lines(texts: Iterable[str], mark: str = "", style: str = "", margin: int = 0) -> Iterator[RichText]:
    for words in texts:
        for line in _broken(mark + words, margin=margin or len(mark)):
            yield RichText(line, style=style, no_wrap=True, overflow="ignore")


def _facts(facts: Facts) -> Iterator[RichText]:
    width = max((len(name) for name in facts.pairs), default=0) + GAP
    yield from _lines((f"{name:<{width}}{value}" for name, value in facts.pairs.items()), margin=width)


def _list(table: Table) -> Iterator[RichText]:
    """List rows as ``where: what; what to do``, grouped by badge."""
    badge = next(k for k, column in enumerate(table.columns) if column.kind == Kind.BADGE)
    shown = [k for k, column in enumerate(table.columns) if k != badge and not column.wide]
    for grade, rows in groupby(table.rows, key=lambda row: row[badge]):
        yield from _lines([f"{str(grade).capitalize()}:"], style=_badge(grade))
        for row in rows:
            where, *sentences = (str(row[k] or "") for k in shown)
            text = "; ".join(filter(None, sentences))
            yield from _lines([f"{where}: {text}" if where else text], "- ")


def _table(table: Table) -> Iterator[RichTable]:
    """Print a table; a wide one is split into blocks that repeat the first column."""
    kept = [k for k, column in enumerate(table.columns) if not column.wide]
    columns = [table.columns[k] for k in kept]
    cells = [[_ascii(columns[i].text(row[k])) for i, k in enumerate(kept)] for row in table.rows]
    titles = [_ascii(column.title) for column in columns]
    least = [_narrowest(column, titles[i], [row[i] for row in cells], i == 0) for i, column in enumerate(columns)]
    most = [max(len(titles[i]), *(len(row[i]) for row in cells)) if cells else len(titles[i]) for i in range(len(kept))]
    for block in _blocks(least):
        widths = {i: most[i] for i in block}
        while sum(widths.values()) + GAP * (len(block) - 1) > WIDTH:
            widths[max(block, key=lambda i: widths[i] - least[i])] -= 1
        block_table = RichTable(box=None, padding=(0, GAP, 0, 0), pad_edge=False, show_header=any(titles))
        for i in block:
            justify: Literal["left", "right"] = "right" if columns[i].kind in NUMERIC else "left"
            title = RichText("\n".join(_broken(titles[i], widths[i])))
            block_table.add_column(title, justify=justify, width=widths[i], overflow="fold", header_style="")
        for k, row in enumerate(cells):
            styles = [_badge(row[i]) if columns[i].kind == Kind.BADGE else "" for i in block]
            texts = ["\n".join(_broken(row[i], widths[i])) for i in block]
            block_table.add_row(*map(RichText, texts, styles), style="dim" if k in table.faint else "")
        yield block_table


def _narrowest(column: Column, title: str, cells: Sequence[str], first: bool) -> int:
    """Return the least width of a column, in which numbers and all but very long words stay on a line."""
    if first or column.kind in NUMERIC:
        words = [*_kept(title).split(" "), *cells]
    else:
        words = [*_kept(title).split(" "), *(word for cell in cells for word in _kept(cell).split(" "))]
    return min(max(map(len, words), default=0), LONGEST)


def _blocks(widths: Sequence[int]) -> Iterator[list[int]]:
    """Divide columns into blocks that fit; every block starts with the first column."""
    block, used = [0], widths[0]
    for k, width in enumerate(widths[1:], 1):
        if used + GAP + width > WIDTH and len(block) > 1:
            yield block
            block, used = [0], widths[0]
        block.append(k)
        used += GAP + width
    yield block
