"""Pages of the documentation, which messages name by their command, what findings mean, and logs of the tutorial."""

from __future__ import annotations

import csv
import re
from difflib import get_close_matches
from math import inf
from pathlib import Path

from gtau.documents.files import folder_of, write_atomically
from gtau.errors import GtauError, UnknownName, quoted

HOME = Path(__file__).parent
FOLDERS = [HOME / "docs", HOME.parents[1] / "docs"]  # of an installed package, and of a checkout
SHELVES = ("start", "do", "lookup")
MESSAGES = "messages"  # the page of all findings, a table
SHORTEST = 12  # characters of a message by which a text is recognised


def page(name: str, section: str = "") -> str:
    """Name a page, and a section of it, in a message."""
    return f"gtau docs {name}{section and f', {section!r}'}"


def _folder() -> Path:
    return next(folder for folder in FOLDERS if folder.is_dir())


def pages() -> dict[str, Path]:
    """List the pages by name."""
    files = [file for shelf in SHELVES for file in sorted((_folder() / shelf).rglob("*.md"))]
    return {file.stem: file for file in files if file.stem != "index"} | {MESSAGES: _folder() / "lookup/messages.csv"}


def titles() -> str:
    """List the pages by name, each with its title."""
    return "\n".join(f"{name:23} {page_text(name).splitlines()[0].removeprefix('# ')}" for name in pages())


def page_text(name: str) -> str:
    """Read a page; raises GtauError where there is none of this name."""
    if name not in (listed := pages()):
        raise UnknownName(f"there is no page '{name}'; choose from {', '.join(listed)}.")
    if name == MESSAGES:
        return "\n".join(["# Messages: every finding, and what to do", "", *map(said, _messages())])
    return listed[name].read_text(encoding="utf-8")


def said(row: dict[str, str]) -> str:
    """Write a row of the table of messages as a sentence."""
    return f"{row['name']} ({row['grade']}): {row['message']}; what to do: {row['what to do']}."


def _messages() -> list[dict[str, str]]:
    with pages()[MESSAGES].open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def explain(finding: str) -> list[dict[str, str]]:
    """Look up findings, by name or text, in the table of messages: grade, name, message (… differs) and what to do.

    Raises GtauError where none is like it.
    """
    rows, named = _messages(), finding.strip(" .").lower()
    if most := max(_likeness(row, named) for row in rows):
        return [row for row in rows if _likeness(row, named) == most]
    words = {text.lower(): row["name"] for row in rows for text in (row["name"], row["message"])}
    close = get_close_matches(named, words, n=1)
    hint = f"did you mean '{words[close[0]]}'?" if close else "give its kind; an error itself says what to do."
    raise GtauError(f"no finding is called {quoted(finding)}; {hint}")


def _likeness(row: dict[str, str], finding: str) -> float:
    """Count the characters of a finding's text that are the message of a row; inf by name, 0 if it is another."""
    if finding == row["name"].lower():
        return inf
    parts = [part.strip().lower() for part in row["message"].split("…") if part.strip()]
    length = sum(map(len, parts))
    return length if length >= SHORTEST and re.search(".*".join(map(re.escape, parts)), finding) else 0


def write_tutorial(out: Path) -> list[Path]:
    """Copy the tutorial logs to a folder, created if missing, and return their paths.

    Raises GtauError where that cannot be written to, or has a log of that name with other content.
    """
    shipped = sorted((HOME / "demo" / "tutorial_logs").glob("*.csv"))
    logs = {folder_of(out) / log.name: log.read_bytes() for log in shipped}
    for copy, content in logs.items():
        if copy.exists() and copy.read_bytes() != content:
            raise GtauError(f"{copy} exists already, with other content; give another folder, or remove it.")
    for copy, content in logs.items():
        write_atomically(copy, content)
    return list(logs)
