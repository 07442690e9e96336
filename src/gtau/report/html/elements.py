"""Markup of what pages are made of: tables, facts, lists and badges. All text is escaped here."""

from __future__ import annotations

import html
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

GRADES = {
    "given": "good",
    "good": "good",
    "weak": "weak",
    "not identifiable": "bad",
    "contradictory": "bad",
    "refused": "bad",
    "stops the identification": "bad",
    "worth mending": "weak",
    "for information": "plain",
}
"""Outcome of a verdict to the colour and the mark that it is shown with."""


@dataclass(frozen=True)
class Cell:
    """A cell of a table: markup, whether it is a number, and what it sorts by (None: its text)."""

    html: str
    numeric: bool = False
    key: float | None = None


@dataclass(frozen=True)
class Column:
    """The head of a column."""

    title: str
    numeric: bool = False


def escape(text: object) -> str:
    """Escape a text as markup."""
    return html.escape(str(text))


def text(value: object, css: str = "") -> Cell:
    """Make a cell of plain text."""
    return Cell(f'<span class="{css}">{escape(value)}</span>' if css else escape(value))


def number(value: float | None, digits: int = 5, missing: str = "–") -> Cell:
    """Make a cell with a number to so many significant digits."""
    if value is None:
        return Cell(missing, True)
    return Cell(escape(plain(value, digits)), True, float(value))


def plain(value: float, digits: int = 5) -> str:
    """Write a number to so many significant digits, as people write it."""
    return f"{value:.{digits}g}".replace("e-0", "e-").replace("e+0", "e").replace("-", "\N{MINUS SIGN}")


def badge(outcome: str) -> Cell:
    """Show an outcome with its mark and colour."""
    return Cell(f'<span class="badge {GRADES.get(outcome, "weak")}">{escape(outcome)}</span>')


def table(
    columns: Sequence[Column],
    rows: Iterable[Sequence[Cell]],
    sortable: str = "",
    cancelled: Iterable[int] = (),
    css: str = "",
) -> str:
    """Make a table; with an id for ``sortable`` its heads sort, and a search field stands above it.

    ``cancelled`` are the numbers of rows that are drawn faint.
    """
    faint = set(cancelled)
    heads = "".join(
        f'<th scope="col"{_css("n" if each.numeric else "")}{" data-sort=1" if sortable else ""}>'
        f"{escape(each.title)}</th>"
        for each in columns
    )
    lines = []
    for k, row in enumerate(rows):
        cells = "".join(
            f"<td{_css('n' if cell.numeric else '')}"
            + (f' data-value="{"" if cell.key is None else repr(float(cell.key))}"' if cell.numeric else "")
            + f">{cell.html}</td>"
            for cell in row
        )
        lines.append(f"<tr{_css('cancelled' if k in faint else '')}>{cells}</tr>")
    names = " ".join(name for name in (css, "sortable" if sortable else "") if name)
    own = f' id="{sortable}"' if sortable else ""
    found = (
        f'<div class="scroll"><table{_css(names)}{own}><thead><tr>{heads}</tr></thead>'
        f"<tbody>{''.join(lines)}</tbody></table></div>"
    )
    if sortable:
        search = (
            f'<div class="tools"><input type="search" data-table="{sortable}" placeholder="Search" '
            'aria-label="Search the table"><output class="soft"></output></div>'
        )
        return search + found
    return found


def facts(pairs: Mapping[str, object]) -> str:
    """Show names with their values, as a grid of small cards."""
    cards = "".join(
        f'<div><span class="name">{escape(name)}</span><span class="value">{escape(value)}</span></div>'
        for name, value in pairs.items()
    )
    return f'<div class="facts">{cards}</div>'


def bullets(sentences: Iterable[str]) -> str:
    """List sentences; each begins with a capital letter and ends with a full stop."""
    items = "".join(f"<li>{escape(sentence(each))}</li>" for each in sentences)
    return f'<ul class="plain">{items}</ul>' if items else ""


def sentence(words: str) -> str:
    """Make words begin with a capital letter, unless a name comes first, and end with a full stop."""
    words = words.strip()
    if words and words.split()[0].isalpha():
        words = words[0].upper() + words[1:]
    return words if words.endswith((".", "!", "?")) else words + "."


def paragraph(words: str, css: str = "") -> str:
    """Make a paragraph of plain text."""
    return f"<p{_css(css)}>{escape(words)}</p>"


def verdict(grade: str, headline: str, sentences: Iterable[str]) -> str:
    """Show the verdict in words, in the colour of its grade: good, weak or bad."""
    words = paragraph(headline) + bullets(sentences)
    return f'<div class="verdict {grade}">{words.replace(" %", "&nbsp;%")}</div>'  # a number and its sign on one line


def folded(summary: str, content: str, shown: bool = False) -> str:
    """Fold content below its summary."""
    return f"<details{' open' if shown else ''}><summary>{escape(summary)}</summary>{content}</details>"


def _css(names: str) -> str:
    return f' class="{names}"' if names else ""
