"""Units as recorders write them: in brackets, as words of a column's name, or in a row below the header.

Each is converted to the form of an experiment file (``mN m``). Counts and unknown units remain as written, and an
experiment file refuses them: none is ignored.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from typing import NamedTuple

SPELLINGS = {  # of units by what they measure; without blanks, dots and hyphens
    "time": "s: s sec secs second seconds sek; ms: ms msec msecs millis milliseconds; us: us usec usecs microseconds; "
    "ns: ns nsec nsecs nanoseconds; min: min minutes",
    # in German, Grad is no gon
    "position": "rad: rad rads radian radians radiant; mrad: mrad; deg: deg degs degree degrees ° grad grado gradi; "
    "mdeg: mdeg millideg; arcmin: arcmin; arcsec: arcsec; gon: gon gons; m: m meter meters metre metres; "
    "mm: mm millimeter; cm: cm; um: um micron microns; inch: inch inches; turn: turn turns rev revs revolution "
    "revolutions rot rotation rotations umdr umdrehungen tours",
    "current": "A: a amp amps ampere amperes arms aeff apk; mA: ma mamp mamps milliamp milliamps marms",
    "torque": "N m: nm newtonmeter newtonmeters; mN m: mnm; uN m: unm; N cm: ncm; N mm: nmm; cN m: cnm; kN m: knm; "
    "kgf m: kgfm kgm kpm; kgf cm: kgfcm kgcm kpcm; kgf mm: kgfmm kgmm; gf cm: gfcm gcm; lbf ft: lbfft lbft ftlb ftlbs "
    "ftlbf; lbf inch: lbfin lbin inlb inlbs inlbf; ozf inch: ozin ozfin inoz; N: n newton newtons; kN: kn; kgf: kgf kp",
    "share": "%: % percent pct prozent; ‰: ‰ permille promille 0.1% 1/1000",
    "other": ": v mv volt volts w watt watts kw hz khz °c degc c celsius k kelvin bar pa j bool",
}
UNITS = {
    spelling: (what, unit)
    for what, units in SPELLINGS.items()
    for unit, spellings in (entry.split(": ") for entry in units.split("; "))
    for spelling in spellings.split()
}
LONGEST = 40  # characters
SI = frozenset(["s", "rad", "m", "A", "N m", "N"])
COUNTS = re.compile(
    r"(inc|ink|inkr|incr|increment|inkremente?|count|cnt|ct|tick|pulse?|step|digit)s?|pls|lsb|raw|adc|u"
)
RATE = re.compile(r"rpm|rps|dps|\D*(/|per)(s|sec|min)|(min|s)\^?1|1/(min|s)")
ACCELERATION = re.compile(r".*/(s\^?2|sec2|s\*\*2|s/s|min/s)")
NUMBER = re.compile(r"[x×*]?\s*(\d+(?:[.,]\d+)?(?:e-?\d+)?)(?:/(\d+))?\s*[x×*]?\s*(.*)", re.IGNORECASE)
WORDS = (  # of names, where they cannot mean anything else: no single letter, and no degs, which may be deg/s
    "deg|degrees?|mdeg|rad|radians?|mrad|turns?|revs?|rotations?|mm|cm|mA|milliamps?|amps|m?Nm|N[cm]m|cNm|kNm|kgf?_?cm|"
    "ozin|ms|msecs?|us|usecs?|ns|rpm|counts?|cnts?|ticks?|incs?|increments?|pct|percent|permille|lsb"
)
WORD = re.compile(
    rf"(?:(?<![A-Za-z])|(?-i:(?<=[a-z])(?=[A-Z])))({WORDS}|%|‰)(?:[_ ]?(?:/|per)?[_ ]?(s|sec|min)(\^?2)?)?(?![A-Za-z])",
    re.IGNORECASE,
)


# As physicists label axes, q/deg and i/mA: the last of two parts, and no single letter, which may be a joint
QUOTIENT = re.compile(r"[^/]+?\s*/\s*([^/\W\d_]{2,}|[°%‰])")


class WrittenUnit(NamedTuple):
    """A unit as an experiment file takes it, or as written, and what it measures, None where that is unknown.

    It measures one of ``SPELLINGS``, ``velocity`` or ``acceleration``; a ``share`` is one of a rated value.
    """

    measures: str | None
    text: str


def read_unit(text: str) -> WrittenUnit | None:
    """Read a unit, or the quantity of one count (``0.01A``); None if the text is neither."""
    if len(text) > LONGEST:
        return None
    plain = unicodedata.normalize("NFKC", text.replace("º", "°")).replace("μ", "u").strip()
    key = re.sub(r"\s" if plain[:1].isdigit() else r"[\s·⋅._*-]", "", plain).lower()
    if key in UNITS:
        return WrittenUnit(*UNITS[key])
    for measures, pattern in (("acceleration", ACCELERATION), ("velocity", RATE), (None, COUNTS)):
        if pattern.fullmatch(key):
            return WrittenUnit(measures, text.strip())
    number = NUMBER.fullmatch(plain)
    unit = read_unit(number[3]) if number and number[3] else None
    if number is None or unit is None or unit.measures not in SPELLINGS:
        return unit and WrittenUnit(unit.measures, text.strip())
    size = float(number[1].replace(",", ".")) / (float(number[2] or 1) or 1.0)
    return WrittenUnit(unit.measures, f"{size:g} {unit.text}")


def split_unit(name: str) -> tuple[str, WrittenUnit | None]:
    """Split a column's name into the rest and its unit, in brackets, after a stroke, or else a word."""
    for match in reversed(list(re.finditer(r"([\[(])([^\[\]()]*)[\])]", name))):
        remark = match[1] == "(" and re.fullmatch(r"\s*[a-z]\s*", match[2])  # measured, set, actual
        if not remark and (unit := read_unit(match[2])):
            return name[: match.start()].rstrip(" /") + name[match.end() :], unit
    if (quotient := QUOTIENT.fullmatch(name)) and (unit := read_unit(quotient[1])):
        return name[: quotient.start(1)].rstrip("/ "), unit
    if word := next(reversed(list(WORD.finditer(name))), None):
        unit = read_unit(word[1].replace("_", ""))
        if word[2]:
            unit = WrittenUnit("acceleration" if word[3] else "velocity", word[0])
        return name[: word.start()].rstrip("_ .-") + name[word.end() :], unit
    return name, None


def unit_row(fields: Sequence[str]) -> list[str] | None:
    """Read the units of a row below the header; None if most of its fields are not units."""
    texts = [re.sub(r"^[\[(](.*)[\])]$", r"\1", field.strip()) for field in fields]
    texts = ["" if text.lower() in ("unit", "units", "einheit", "-", "1") else text for text in texts]
    units = [read_unit(text) for text in texts if text]
    return texts if 2 * len([unit for unit in units if unit]) > len(units) else None
