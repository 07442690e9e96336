"""Pages as one self-contained HTML file with its styles, scripts and data.

As ``report.html`` a page says how it was made: command, hashes of input files, versions, settings and time taken.
"""

from __future__ import annotations

import json
import platform
import re
import shlex
import sys
from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from functools import cache
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup, escape

from gtau.documents.files import digest_of, write_atomically
from gtau.report.chart import MINUS, NOT_USED, Chart, Panel, envelope
from gtau.report.page import BADGES, NUMERIC, Column, Facts, Item, Kind, Page, Section, Table, Text
from gtau.report.svg import svg_of, svg_of_robot

Inputs = tuple[tuple[str, Path], ...]
"""Files with their purpose."""
BUCKETS = 2000  # intervals of a run, drawn by their extremes: more than the pixels of a wide screen
BUDGET = 450_000  # numbers in all series of a page, packed to 2.4 MB
INCH = 96  # pixels
REPORT = "report.html"
PACKAGES = ("numpy", "scipy", "polars", "casadi", "numba", "clarabel", "mujoco")
LISTED = 12  # inputs; longer lists are folded
LARGEST = 1 << 31  # bytes; larger inputs are not hashed
FIT = (
    "new ResizeObserver(() => { try { frameElement.style.height = document.body.getBoundingClientRect().height + 16 + "
    "'px'; } catch (outside) {} }).observe(document.body);"
)


def html(page: Page, embedded: bool = False) -> str:
    """Render a page as HTML; an ``embedded`` page goes into a frame of a notebook."""
    arrays = arrays_for(page.sections)
    live = next(live_charts(page.sections), None) is not None
    # numbers as in the text: a browser may also name a language that is none, such as en-US@posix
    scripts = [asset("uPlot.iife.min.js").replace("k.language", '"en-US"')] if live else []
    scripts += [asset("report.js")] if live or not embedded else []
    scripts += [FIT] if embedded else []
    digests = (b64encode(sha256(script.encode()).digest()).decode() for script in scripts)
    allowed = " ".join(f"'sha256-{digest}'" for digest in digests) or "'none'"  # only the scripts of the page run
    groups = (f"g{k}" for k in count())
    template = _environment().get_template("page.html.j2")
    text: str = template.render(
        page=page,
        embedded=embedded,
        scripts=scripts,
        policy=f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src {allowed}",
        style=(asset("uPlot.min.css") if live else "") + _style(),
        licence=asset("uPlot.LICENSE.txt") if live else "",
        arrays=arrays,
        group=lambda: next(groups),
        spec=lambda panel, group, last: json.dumps(spec_of(panel, arrays, group, last)),
        svg=svg_of,
        robot=svg_of_robot,
    )
    return text


def frame(page: Page) -> str:
    """Render a page as an inline frame, which keeps its styles apart from the notebook's."""
    content = escape(html(page, embedded=True))
    return f'<iframe srcdoc="{content}" style="width:100%;height:24em;border:0" title="gtau"></iframe>'


def asset(name: str) -> str:
    """Read a text file of this package."""
    return files("gtau.report").joinpath("assets", name).read_text(encoding="utf-8")


@cache
def _environment() -> Any:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(loader=PackageLoader("gtau.report"), autoescape=True, undefined=StrictUndefined)
    environment.trim_blocks = environment.lstrip_blocks = True
    environment.globals.update(numeric=NUMERIC, badges=BADGES, not_used=NOT_USED)
    environment.filters.update(cell=_cell, key=Column.sort_key, sentence=sentence, shown=_shown, words=words)
    environment.tests.update(kind=lambda item, name: type(item).__name__ == name)
    return environment


def _cell(column: Column, cell: Any) -> str:
    text = column.text(cell)
    if column.kind in NUMERIC and not isinstance(cell, str):
        return "\N{EN DASH}" if text == column.missing == "-" else text.replace("-", MINUS)
    return text.replace(" - ", f" {MINUS} ") if column.kind == Kind.NAME else text


def words(text: str) -> Markup:
    """Set minus signs, keep ``%``, options and commands in one piece, and let names break at ``_``."""
    signed = re.sub(r"(?<![^\s(,])-(?=\d)|(?<=\d[eE])-(?=\d)", MINUS, text.replace("+-", "\N{PLUS-MINUS SIGN}"))
    text = str(escape(signed)).replace(" %", "\N{NO-BREAK SPACE}%").replace("_", "_<wbr>")
    text = re.sub(r"(?<=\()gtau [^()]+(?=\))", r"<code>\g<0></code>", text)
    return Markup(re.sub(r"(?<!\w)--[a-z-]+", r'<span class="option">\g<0></span>', text))


def _shown(table: Table) -> list[int]:
    """List the columns to show; for findings, the columns that are not empty."""
    return [k for k in range(len(table.columns)) if not table.listed or any(row[k] for row in table.rows)]


def _style() -> str:
    """Write the style sheet: light colours, dark ones if the system or the button asks for them, light on paper."""
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


def sentence(words: str) -> str:
    """Capitalise the first word unless it is a name, and end with a full stop."""
    words = words.strip()
    if words and words.split()[0].isalpha():
        words = words[0].upper() + words[1:]
    return words if not words or words.endswith((".", "!", "?")) else words + "."


# Time series, thinned and packed as base64 float32, which uPlot draws


@dataclass
class Arrays:
    """Arrays of a page by key; equal arrays are stored once."""

    buckets: int = BUCKETS
    keys: dict[str, str] = field(default_factory=dict)

    def put(self, values: np.ndarray) -> str:
        """Pack an array (K,) as float32 and return its key."""
        text = b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode("ascii")
        return self.keys.setdefault(text, f"a{len(self.keys)}")

    @property
    def text(self) -> str:
        """The arrays as JSON."""
        return json.dumps({key: text for text, key in self.keys.items()}, separators=(",", ":"))


def arrays_for(items: Sequence[Item]) -> Arrays:
    """Divide the budget of a page equally among its series."""
    series = sum(len(panel.series) for chart in live_charts(items) for panel in chart.panels)
    return Arrays(int(np.clip(BUDGET // max(2 * series, 1), 100, BUCKETS)))


def live_charts(items: Sequence[Item]) -> Iterator[Chart]:
    """Yield the live charts of a page."""
    for item in items:
        if isinstance(item, Section):
            yield from live_charts(item.items)
        elif isinstance(item, Chart) and item.live:
            yield item


def spec_of(panel: Panel, arrays: Arrays, group: str, last: bool) -> dict[str, Any]:
    """Describe a panel for the script of the page, and pack its series."""
    values = np.column_stack([series.y for series in panel.series])
    thin_time, thin = envelope(panel.series[0].x, values, arrays.buckets)
    spec: dict[str, Any] = {
        "x": arrays.put(thin_time),
        "series": [
            {
                "label": series.label,
                "data": arrays.put(thin[:, k]),
                "colour": series.colour,
                "width": series.width,
                "dash": [series.width * part for part in series.dashes],
            }
            for k, series in enumerate(panel.series)
        ],
        "unit": panel.y.label,
        "group": group,
        "height": round(INCH * panel.height),
        "last": last,
        "xlabel": panel.x.label,
    }
    if panel.shaded is not None and panel.shaded.size:
        spec["masked"] = arrays.put(panel.shaded)
    if panel.y.limits[0] is not None:
        spec["from"] = panel.y.limits[0]
    return spec


def write_report(
    page: Page, folder: Path, seconds: float, inputs: Inputs = (), settings: Mapping[str, str] | None = None
) -> Path:
    """Write a page to a folder, with the current command, its ``inputs``, ``settings`` and ``seconds`` taken."""
    command = shlex.join(["gtau", *sys.argv[1:]])
    write_atomically(folder / REPORT, html(stamped(page, settings or {}, command, inputs, seconds)))
    return folder / REPORT


def stamped(
    page: Page, settings: Mapping[str, str], command: str = "", inputs: Inputs = (), seconds: float | None = None
) -> Page:
    """Add date and version below the title of a page, and at its end the section on provenance."""
    made = datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z")
    packages = {"gtau": version("gtau")}
    packages["Python"] = f"{platform.python_version()}, {platform.system()} {platform.machine()}"
    for package in PACKAGES:
        with suppress(PackageNotFoundError):
            packages[package] = version(package)
    facts = {"made on": made, "time taken": None if seconds is None else f"{seconds:.1f} s", **packages}
    hashed = Table(
        (Column("input"), Column("file"), Column("size"), Column("SHA-256", Kind.NAME)),
        [(what, str(path), *_fingerprint(path)) for what, path in inputs],
    )
    listed = f"Inputs: {len(inputs)} file{'s' * (len(inputs) > 1)} with hashes"
    provenance = Section(
        "Provenance",
        Section("The command that reproduces this report", Text(command, style="command")) if command else None,
        Facts(facts),
        Section("Settings and statistics", Facts(settings)) if settings else None,
        Section(listed, hashed, folded=len(inputs) > LISTED) if inputs else None,
        id="provenance",
        folded=True,
    )
    lead = (*page.lead, f"Made on {made} by gtau {packages['gtau']}.")
    return Page(page.title, *page.sections, provenance, lead=lead)


def _fingerprint(path: Path) -> tuple[str, str]:
    if not path.exists():
        return "–", "no longer exists"
    sizes = [part.stat().st_size for part in (path.rglob("*") if path.is_dir() else [path]) if part.is_file()]
    shown = f"{len(sizes)} files" if path.is_dir() else _size(sum(sizes))
    return shown, digest_of(path) if sum(sizes) <= LARGEST else f"not computed: larger than {_size(LARGEST)}"


def _size(size: float) -> str:
    for unit in ("B", "kB", "MB"):
        if size < 1000:
            return f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:.3g} GB"
