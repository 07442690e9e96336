"""Words of numbers and names in findings."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import UTC, datetime
from math import ceil, floor, log10

from gtau.errors import quoted

MOST_PERCENT = 1000.0
"""Per cent, above which a size is none: what has it is no estimate, and no error of one."""


def moment(time: float, digits: int = 9) -> str:
    """Write an instant of a log in s, or as a date where it is one since 1970: ``1.7e+09 s`` says nothing."""
    if time < 1e8:
        return f"{time:.{digits}g} s"
    if time > 1e10:
        return f"{time:.3f} s"
    return f"{datetime.fromtimestamp(time, UTC).isoformat(' ', 'milliseconds')[:-6]} UTC ({time:.3f} s)"


def percent(share: float, spec: str = ".2g") -> str:
    """Write a share in per cent, or "more than 1000 %" above ten times the whole."""
    if abs(share) > MOST_PERCENT / 100:
        return f"more than {MOST_PERCENT:g} %"
    text = format(100 * share, spec)
    return f"{text if text.strip('+-0.') else text.lstrip('-')} %"


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
