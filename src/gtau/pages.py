"""Pages of the documentation, which messages name by the command that prints them."""

from __future__ import annotations

from pathlib import Path

from gtau.errors import UnknownName

HOME = Path(__file__).parent
FOLDERS = [HOME / "docs", HOME.parents[1] / "docs"]  # of an installed package, and of a checkout
SHELVES = ("start", "do", "lookup")


def page(name: str, section: str = "") -> str:
    """Name a page, and a section of it, in a message."""
    return f"gtau docs {name}{section and f', {section!r}'}"


def pages() -> dict[str, Path]:
    """List the pages by name."""
    folder = next(folder for folder in FOLDERS if folder.is_dir())
    files = [file for shelf in SHELVES for file in sorted((folder / shelf).rglob("*.md"))]
    return {file.stem: file for file in files if file.stem != "index"}


def page_text(name: str) -> str:
    """Read a page; raises GtauError where there is none of this name."""
    if name not in (listed := pages()):
        raise UnknownName(f"there is no page '{name}'; choose from {', '.join(listed)}.")
    return listed[name].read_text(encoding="utf-8")
