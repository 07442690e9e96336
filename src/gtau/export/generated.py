"""Generated code for one sample, in any language: the names, numbers and functions that it is made of, and templates.

In templates ``${...}`` is an expression and ``<% ... %>`` a statement of Jinja.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gtau.documents.files import suffixes
from gtau.model.loops import CONDITION, CONTRACTION
from gtau.uses.identified import Identified, functions

if TYPE_CHECKING:
    from jinja2 import Environment

TEMPLATES = Path(__file__).with_name("templates")
LINE = 116  # characters
# numbers of the closing of loops
CLOSING = {
    "newton_steps": 4,  # from 0.01 rad away corrections are about 1e-2, 1e-4, 1e-8, 1e-16: the fourth is rounding
    "starting_steps": 200,  # from home: a few milliradians or millimetres each
    "closed": 1e-8,  # of the last correction; the remaining error is its square
    "contraction": CONTRACTION,
    "condition": CONDITION,
}


def fields_of(model: Identified) -> dict[str, Any]:
    """Collect the fields of the templates: the model, its CasADi functions (``made``), and values of both."""
    made, result = functions(model), model.result
    count = len(made.home) - len(made.presliding)
    return {
        **CLOSING,
        "model": model,
        "made": made,
        "result": result,
        "name": model.name,
        "NAME": model.name.upper(),
        "joints": [result.robot.joint(joint) for joint in model.joints],
        "current_unit": "A" if result.kind == "current" else "",
        "coordinates": count,
        "presliding": [(place, *state) for place, state in enumerate(made.presliding, start=count)],
        "payloads": list(zip(suffixes(model.payloads).values(), model.payloads.items(), strict=True)),
        "friction": " ".join(result.friction_law.range_sentence.split()),
    }


def filled(template: str, fields: dict[str, Any]) -> str:
    """Fill a template of this folder."""
    return _environment().get_template(f"{template}.in").render(fields)


@cache
def _environment() -> Environment:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    made = Environment(  # of code, which needs no escapes of HTML
        variable_start_string="${",
        variable_end_string="}",
        block_start_string="<%",
        block_end_string="%>",
        comment_start_string="<#",
        comment_end_string="#>",
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=StrictUndefined,
        loader=FileSystemLoader(TEMPLATES),
    )
    made.filters |= {"numbers": numbers, "wrapped": wrapped, "in_c": in_c, "in_matlab": in_matlab}
    return made


def numbers(values: Iterable[float | None], between: str = ", ") -> str:
    """Write numbers with all their digits, None as NaN."""
    return between.join("NaN" if value is None else repr(float(value)) for value in values)


def wrapped(text: str, indent: str) -> str:
    """Break a text into lines that begin with ``indent``."""
    return textwrap.fill(text, LINE, initial_indent=indent, subsequent_indent=indent)


def in_c(text: str) -> str:
    """Clean a text so that it is safe in a comment and in a string of C."""
    return re.sub(r"[^\w .,:;()+/-]", "_", text, flags=re.ASCII)


def in_matlab(text: str) -> str:
    """Write a text as a string of MATLAB."""
    return "'" + "".join(c if c.isprintable() else " " for c in text).replace("'", "''") + "'"
