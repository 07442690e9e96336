"""The pages of the documentation: they ship with the package, as ``gtau/docs``."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from difflib import get_close_matches
from math import inf
from pathlib import Path

from gtau.errors import GtauError, quoted

PACKAGE = Path(__file__).parents[1]
SHELVES = ("start", "do", "lookup", "evidence")
MESSAGES = "lookup/messages"
CELL = re.compile(r"(?<!\\)\|")
MARKUP = re.compile(r"\\(?=[|<*_\[\]])|`")
SHORTEST = 12  # characters of a message by which a text is recognised


@dataclass(frozen=True)
class Explained:
    """A row of the page of messages: findings alike, what they say, and what to do; ``…`` differs by case.

    The ``group`` is the grade of the verdict that they lower, or ``Notes`` or ``Causes``.
    """

    names: str
    group: str
    message: str
    remedy: str

    def __str__(self) -> str:
        """Write it in one line."""
        return f"{self.names} ({self.group}): {self.message or 'see its text'}; what to do: {self.remedy}."

    def likeness(self, finding: str) -> float:
        """Return how many characters of a finding's text are its message; inf by name, 0 if it is another."""
        if finding in (self.names.lower(), *self.names.lower().split(", ")):
            return inf
        said = [part.strip().lower() for part in self.message.split("…") if part.strip()]
        length = sum(map(len, said))
        return length if length >= SHORTEST and re.search(".*".join(map(re.escape, said)), finding) else 0


def pages() -> dict[str, Path]:
    """List the pages by name, such as ``do/identify``."""
    shipped = PACKAGE / "docs"
    folder = shipped if shipped.is_dir() else PACKAGE.parents[1] / "docs"  # of a checkout
    files = [path for shelf in SHELVES for path in sorted((folder / shelf).rglob("*.md"))]
    return {path.relative_to(folder).with_suffix("").as_posix(): path for path in files}


def explain(finding: str) -> list[Explained]:
    """Look up a finding, given by its name or its text, on the page of messages; raises GtauError if it is unknown."""
    rows, named = list(_rows()), finding.strip(" .").lower()
    if most := max(row.likeness(named) for row in rows):
        return [row for row in rows if row.likeness(named) == most]
    words = {text.lower(): row.names for row in rows for text in (*row.names.split(", "), row.message)}
    close = get_close_matches(named, words, n=1)
    hint = f"did you mean '{words[close[0]]}'?" if close else "give its kind; an error itself says what to do."
    raise GtauError(f"no finding is called {quoted(finding)}; {hint}")


def _rows() -> Iterator[Explained]:
    group = ""
    for line in pages()[MESSAGES].read_text(encoding="utf-8").splitlines():
        if line.startswith("#"):
            group = line.strip("# ")
        elif line.startswith("| ") and not line.startswith(("| name ", "| --- ")):
            names, *message, remedy = (
                MARKUP.sub("", cell).replace("±", "+-").strip() for cell in CELL.split(line)[1:-1]
            )
            yield Explained(names, group, "".join(message), remedy)
        elif line.startswith("For information"):
            for name in line.partition(": ")[2].rstrip(".").split(", "):
                yield Explained(name, group, "", "nothing")
