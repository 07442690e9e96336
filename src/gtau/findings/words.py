"""Words of findings: what templates of sentences share, and how they are filled in."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import ceil, floor, log10
from typing import Any

RELATIVE = "of itself"  # unit of a size that is a share of what it changes

Values = Mapping[str, Any]
Sentence = tuple[str, str]
"""Reason and advice, of a cause its name and advice, which is empty where there is nothing to do.

Fields in braces are the values of the finding, its ``joints`` and their ``count``, its ``subject``, its first
``joint`` and the ``other`` one, the ``estimate`` that it is about, the ``cause`` and what ``to_do`` then, and how to
correct the ``clock`` and the ``limits``. Beyond the formats of Python, ``%`` at the end prints a ratio in per cent,
``m`` and ``k`` a thousand times a value and a thousandth of it, and ``|`` at the beginning its size. Names are listed,
``&`` with an "and", ``,`` and ``and`` with quotes, and ``s`` is their plural. Of ``<name?this|that>`` the first is
taken where the value is true, not empty and not zero, of ``<name+?this|that>`` where it is positive, of
``<name=text?this|that>`` where it is that.
"""
Words = Sentence | Callable[[Values], Sentence]
"""The sentence of a kind of finding, or a function that makes it from the values."""


def counted(number: int, noun: str) -> str:
    """Write ``1 row``, ``2 rows``."""
    return f"{number} {noun}{'s' * (number != 1)}"


def which_payload(values: Values) -> str:
    """Add the payload to what is to be checked, where some run has one."""
    return ", which runs carry the payload, and on which body" if values.get("payload", True) else ""


def write_limits(joint: str) -> str:
    """Advise how to correct wrong limits of a joint in its file."""
    return f"state the real one under 'robot' in the experiment file ({{file: ..., limits: {{{joint}: ...}}}})"


def clock_advice(rate: float | None) -> str:
    """Advise what to correct where a run has a wrong time: its ``rate`` (Hz) if that is stated, or the time stamps."""
    if rate is not None:
        return f"correct the sampling rate, 'rate: {rate:g}' under signals.time"
    return "correct the unit of the time (units: {time: ...})"


def percent_text(share: float, accuracy: float | None = None) -> str:
    """Write a share (per cent) in two significant digits and at most two decimals, without the sign of per cent.

    A share that exceeds the ``accuracy`` (per cent) is rounded up where it would be rounded to it or below.
    """
    if 0 < share < 0.005:
        return "<0.01"
    decimals = min(max(1 - floor(log10(float(f"{share:.2g}"))), 0), 2) if share else 2
    shown = f"{share:.{decimals}f}"
    if accuracy is not None and share > accuracy >= float(shown):
        shown = f"{ceil(share * 10**decimals) / 10**decimals:.{decimals}f}"
    return shown


def literal(value: Any) -> Any:
    """Double the braces of names, which functions put into templates."""
    if isinstance(value, str):
        return value.replace("{", "{{").replace("}", "}}")
    if isinstance(value, Mapping):
        return {key: literal(entry) for key, entry in value.items()}
    return tuple(map(literal, value)) if isinstance(value, list | tuple) else value
