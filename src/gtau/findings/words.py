"""Words of findings: the templates of their sentences are data, ``words.yaml``; here is how they are filled in."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from functools import cache
from importlib.resources import files
from math import ceil, floor, log10, pi
from typing import TYPE_CHECKING, Any

from gtau.errors import quoted

if TYPE_CHECKING:
    from jinja2 import Environment

MOST_PERCENT = 1000.0
"""Per cent, above which a size is none: what has it is no estimate, and no error of one."""
Sentence = tuple[str, str]
"""Reason and advice, of a cause its name and advice, which is empty where there is nothing to do."""


@cache
def templates() -> dict[str, dict[str, Any]]:
    """Read the templates: ``verdicts``, ``notes``, ``logs`` and ``causes`` by kind, ``phrases`` by name."""
    import yaml

    text = files("gtau.findings").joinpath("words.yaml").read_text(encoding="utf-8")
    read: dict[str, dict[str, Any]] = yaml.load(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    return read


def filled(kind: str, values: Mapping[str, Any]) -> Sentence:
    """Fill in the sentence of a kind."""
    what, action = (_environment().get_template(f"{kind}: {part}").render(values) for part in ("what", "action"))
    return what, action


def phrase(name: str) -> str:
    """Return a phrase without values."""
    return _environment().get_template(name).render()


@cache
def _environment() -> Environment:
    from jinja2 import DictLoader, Environment, StrictUndefined

    class Absent(StrictUndefined):
        """What a finding lacks: false, but never printed."""

        def __bool__(self) -> bool:  # type: ignore[override]
            return False

    sources = dict(templates()["phrases"])
    for section in ("verdicts", "notes", "logs", "causes"):
        for kind, sentence in templates()[section].items():
            sources |= {f"{kind}: {part}": sentence.get(part, "") for part in ("what", "action")}
    environment = Environment(
        loader=DictLoader(sources),
        undefined=Absent,
        autoescape=False,
        variable_start_string="${",
        variable_end_string="}",
        block_start_string="<%",
        block_end_string="%>",
        comment_start_string="<#",
        comment_end_string="#>",
    )
    environment.globals["pi"] = pi
    environment.filters |= {
        "form": _form,
        "percent": _percent,
        "percent_text": percent_text,
        "plural": lambda number: "s" * (number != 1),
        "quoted": lambda names, between=", ": listed(names, between),
    }
    return environment


def moment(time: float, digits: int = 9) -> str:
    """Write an instant of a log in s, or as a date where it is one since 1970: ``1.7e+09 s`` says nothing."""
    if time < 1e8:
        return f"{time:.{digits}g} s"
    if time > 1e10:
        return f"{time:.3f} s"
    return f"{datetime.fromtimestamp(time, UTC).isoformat(' ', 'milliseconds')[:-6]} UTC ({time:.3f} s)"


def _form(value: float, spec: str) -> str:
    """Write a number, zero without a sign."""
    text = format(value, spec)
    return text if text.strip("-0.") else text.removeprefix("-")


def _percent(share: float, spec: str) -> str:
    """Write a share in per cent, or "more than 1000 %" above ten times the whole."""
    return f"{_form(100 * share, spec)} %" if abs(share) <= MOST_PERCENT / 100 else f"more than {MOST_PERCENT:g} %"


def percents(values: Iterable[float]) -> str:
    """Write the range of shares (per cent), one number where they are alike."""
    shown = [f"{value:.2f}" if value <= MOST_PERCENT else f"more than {MOST_PERCENT:g}" for value in sorted(values)]
    return f"{' to '.join(dict.fromkeys((shown[0], shown[-1])))} %"


def listed(names: Iterable[str], between: str = " and ") -> str:
    """Quote names and join them."""
    return between.join(map(quoted, names))


def counted(number: int, noun: str) -> str:
    """Write ``1 row``, ``2 rows``."""
    return f"{number} {noun}{'s' * (number != 1)}"


def write_limits(joint: str) -> str:
    """Advise how to correct wrong limits of a joint in its file."""
    return f"state the real one under 'robot' in the experiment file ({{file: ..., limits: {{{joint}: ...}}}})"


def clock_advice(rate: float | None) -> str:
    """Advise what to correct where a run has a wrong time: its ``rate`` (Hz) if that is stated, or the time stamps."""
    if rate is not None:
        return f"correct the sampling rate, 'rate: {rate:g}' under signals.time"
    return "correct the unit of the time (units: {time: ...})"


def to_width(value: float, width: float) -> str:
    """Write a number to two digits of half the width of its interval."""
    decimals = max(1 - floor(log10(width)), 0) if 0 < width < float("inf") else 4
    return f"{value:z.{min(decimals, 12)}f}"


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
