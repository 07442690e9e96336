"""Check every link and picture of a built site, and every anchor that a link names: python docs/check_links.py SITE.

Links to other sites are left alone, as is what only a server needs.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit


def read(path: Path) -> tuple[set[str], list[str]]:
    """Read the anchors of a page, and what it links to."""
    anchors: set[str] = set()
    links: list[str] = []
    parser = HTMLParser()

    def start(tag: str, attributes: list[tuple[str, str | None]]) -> None:
        for name, value in attributes:
            if name == "id" or (tag, name) == ("a", "name"):
                anchors.add(value or "")
            elif name in ("href", "src") and value:
                links.append(value)

    parser.handle_starttag = start  # type: ignore[method-assign]
    parser.feed(path.read_text(encoding="utf-8"))
    return anchors, links


def broken(site: Path) -> tuple[int, int, list[str]]:
    """Return the numbers of pages and of links within the site, and the links that lead nowhere."""
    pages = {path.resolve(): read(path) for path in sorted(site.rglob("*.html")) if "_static" not in path.parts}
    found = [each for path, page in pages.items() for each in _within(path, page[1])]
    wrong = []
    for path, link, target, anchor in found:
        missing = not target.exists()
        if missing or (anchor and target in pages and anchor not in pages[target][0]):
            wrong.append(f"{path.relative_to(site.resolve())}: {link}")
    return len(pages), len(found), wrong


def _within(path: Path, links: list[str]) -> Iterator[tuple[Path, str, Path, str]]:
    for link in links:
        parts = urlsplit(link)
        if not parts.scheme and not parts.netloc and link != "#":
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            yield path, link, target, unquote(parts.fragment)


if __name__ == "__main__":
    number, links, wrong = broken(Path(sys.argv[1]))
    print(f"{number} pages, {links} links within the site, {len(wrong)} broken", *wrong, sep="\n")
    sys.exit(bool(wrong))
