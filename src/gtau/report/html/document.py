"""One self-contained HTML file: sections, styles, scripts and packed arrays; it loads nothing from anywhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files

from gtau.report.html.elements import escape
from gtau.report.html.series import Arrays


@dataclass(frozen=True)
class Section:
    """A titled part of a page; ``html`` is markup, ``id`` its anchor."""

    id: str
    title: str
    html: str


@dataclass(frozen=True)
class Page:
    """A report.

    ``title`` and ``lead`` (lines below it) are plain text, ``sections`` come in reading order, ``arrays`` hold what the
    charts of the sections draw, and ``footer`` (plain text) ends the page.
    """

    title: str
    lead: Sequence[str]
    sections: Sequence[Section]
    arrays: Arrays
    footer: str = ""


def render(page: Page) -> str:
    """Render a page as the text of one HTML file."""
    contents = "".join(f'<a href="#{each.id}">{escape(each.title)}</a>' for each in page.sections)
    body = "\n".join(
        f'<section id="{each.id}">\n<h2>{escape(each.title)}</h2>\n{each.html}\n</section>' for each in page.sections
    )
    scripts = [asset("report.js")]
    notice = ""
    if page.arrays.drawn:
        scripts.insert(0, asset("uPlot.iife.min.js"))
        notice = (
            "<details><summary>Charts are drawn by uPlot (MIT licence)</summary>"
            f"<pre>{escape(asset('uPlot.LICENSE.txt'))}</pre></details>"
        )
    lead = "".join(f"<p>{escape(line)}</p>" for line in page.lead)
    code = "\n".join(f"<script>{script}</script>" for script in scripts)
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="generator" content="gtau">
<link rel="icon" href="data:,">
<title>{escape(page.title)}</title>
<style>
{asset("uPlot.min.css") if page.arrays.drawn else ""}
{style()}
</style>
</head>
<body>
<nav class="contents" aria-label="Contents">{contents}<button id="theme" type="button">Theme</button></nav>
<header class="top"><h1>{escape(page.title)}</h1>{lead}</header>
<main>
{body}
</main>
<footer><p>{escape(page.footer)}</p>{notice}</footer>
{page.arrays.script()}
{code}
</body>
</html>
"""


def style() -> str:
    """Write the style sheet: light colours, dark ones where the system or the switch asks for them, light on paper."""
    light, dark = asset("light.css"), asset("dark.css")
    return (
        f":root {{ color-scheme: light dark; {light} }}\n"
        f'@media (prefers-color-scheme: dark) {{ :root:not([data-theme="light"]) {{ {dark} }} }}\n'
        f':root[data-theme="light"] {{ color-scheme: light; }}\n'
        f':root[data-theme="dark"] {{ color-scheme: dark; {dark} }}\n'
        f'@media print {{ :root, :root[data-theme="dark"], :root:not([data-theme="light"]) '
        f"{{ color-scheme: light; {light} }} }}\n"
        f"{asset('report.css')}"
    )


def asset(name: str) -> str:
    """Read a text file that ships with this package."""
    return files("gtau.report.render").joinpath("assets", name).read_text(encoding="utf-8")
