"""Figures as inline SVG, in the colours and the font of the page that holds them."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from hashlib import sha256
from io import StringIO
from typing import TYPE_CHECKING

from gtau.report.chart import Panel
from gtau.report.render.charts import Colours, draw, new_figure, palette, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NARROW, WIDE = 3.3, 4.5  # inches, of panels beside each other, and of one alone
SIZE = 7.5  # points, of words
UNWANTED = (
    r"<!--.*?-->|<metadata>.*?</metadata>|<defs>\s*<style.*?</defs>",  # styles in there would hold on the whole page
    r' transform="rotate\(-0 [^"]*"|font-family: [^;"]*;? ?',
    r'(?<=<g) id="[^"]*"| id="image[^"]*"',
    r"\s*\n\s*",
)


@cache
def variables() -> Colours:
    """Return a colour of its own for each name of the style sheet; :func:`svg` puts the variable in its place."""
    return {name: f"#fe01{k:02x}" for k, name in enumerate(palette())}


def svg_of(panel: Panel, alone: bool) -> str:
    """Draw a panel without its title: one ``alone`` is wider than those beside each other."""
    width = WIDE if alone else NARROW
    height = 0.8 * width if panel.equal else panel.height if panel.matrix is None else width
    with styled(variables(), SIZE):
        figure = new_figure(width, height)
        draw(figure.subplots(), replace(panel, title=""), variables())
        return svg(figure)


def svg(figure: Figure) -> str:
    """Write a figure drawn in the colours of :func:`variables`, with ids of its own and two decimals."""
    from matplotlib.text import Text

    for words in figure.findobj(Text):
        words.set_path_effects([])  # they would turn words into outlines
    content = StringIO()
    with styled(variables(), SIZE):
        figure.savefig(content, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    text = content.getvalue()
    for unwanted in UNWANTED:
        text = re.sub(unwanted, "", text, flags=re.DOTALL)
    box, body = text[text.index("viewBox=") :].split(">", 1)
    body = re.sub(r"<(?!image)[^>]*>", lambda tag: re.sub(r"(\.\d\d)\d+", r"\1", tag[0]), body)
    body = re.sub(r'( id="|"#|url\(#)(\w+)', rf"\1\g<2>-{sha256(body.encode()).hexdigest()[:8]}", body)
    names = {colour: f"var(--{name})" for name, colour in variables().items()}
    body = re.sub(r"#fe01[0-9a-f]{2}", lambda colour: names[colour[0]], body)
    return f'<svg {box.split(" xmlns")[0]} stroke-linejoin="round">{body}'
