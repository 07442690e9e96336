"""Dates, clock times and durations in a column, as seconds; what Polars parses is left to it."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from gtau.signals.reading.units import COMMON, read_unit

if TYPE_CHECKING:
    import polars as pl

DATE = re.compile(r"\d{1,4}[-/.](\d{1,2}|[A-Za-z]{3})[-/.]\d{1,4}([T ]|$)|20\d{6}T\d{6}")
CLOCK = re.compile(r"(?:(\d+) days?,? *)?(?:(\d+):)?(\d+):(\d\d?(?:\.\d+)?)")  # Excel shows minutes and seconds
SPAN = re.compile(r"([-+]?[\d.]+(?:[eE][-+]?\d+)?) *([A-Za-zµ]+)")  # as MATLAB writes a duration: 0.002 sec
HALF_DAYS = "%I:%M:%S%.f %p"
FORMATS = (None, "%d-%b-%Y %H:%M:%S%.f", f"%m/%d/%Y {HALF_DAYS}")  # by Polars' guess, of MATLAB, of LabVIEW


def is_instant(text: str) -> bool:
    """Decide whether a text is a date, a clock time or a duration."""
    span = SPAN.fullmatch(text)
    if span and (unit := read_unit(span[2])):
        return unit.measures == "time"
    return bool(DATE.match(text) or CLOCK.match(text))


def seconds(column: pl.Series) -> pl.Series | None:
    """Convert dates, clock times and durations, or texts of such, to s, null where one is not; None for others."""
    import polars as pl

    if column.dtype == pl.String:
        column = column.str.replace(r"(\d),(\d)", "$1.$2")
        texts = column.drop_nulls()
        return _parsed(column, texts[0]) if len(texts) and is_instant(texts[0]) else None
    if not column.dtype.is_temporal():
        return None
    if column.dtype == pl.Duration:
        return column.dt.total_nanoseconds() * 1e-9
    nanoseconds = column.dtype == pl.Time  # of dates they would overflow
    return column.cast(pl.Int64) * 1e-9 if nanoseconds else column.cast(pl.Datetime("us")).cast(pl.Int64) * 1e-6


def _parsed(texts: pl.Series, first: str) -> pl.Series | None:
    import polars as pl

    if span := SPAN.fullmatch(first):
        number = texts.str.extract(rf"^([-+.\deE]+) *{re.escape(span[2])}$").cast(pl.Float64, strict=False)
        unit = read_unit(span[2])
        return number * COMMON["time"].get(unit.text if unit else "", 60.0)  # s to ns, or min
    if not DATE.match(first):
        if first[-1] in "mM":
            return seconds(texts.str.to_time(HALF_DAYS, strict=False))
        days, hours, minutes, rest = texts.str.extract_groups(f"^{CLOCK.pattern}$").struct.unnest().cast(pl.Float64)
        return days.fill_null(0.0) * 86400 + hours.fill_null(0.0) * 3600 + minutes * 60 + rest
    guesses = (texts.str.to_datetime(form, strict=False, time_zone="UTC") for form in FORMATS)
    return next((seconds(dates) for dates in guesses if dates.null_count() < len(dates)), None)
