"""A Matplotlib figure that shows itself in a notebook without pyplot."""

from __future__ import annotations

from io import BytesIO

from matplotlib.figure import Figure


class ShownFigure(Figure):
    """A figure known to no pyplot, drawn where a notebook cell ends with it."""

    def _repr_png_(self) -> bytes:
        from gtau.report.style import styled

        content = BytesIO()
        with styled():
            self.savefig(content, format="png")
        return content.getvalue()
