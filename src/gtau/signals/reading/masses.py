"""Masses of payloads in the names of logs, such as ``loaded_1983g``, with all readings of ambiguous names."""

from __future__ import annotations

import re
from unicodedata import numeric

UNITS: dict[tuple[str, ...], float] = {
    ("kg", "kilo"): 1.0,
    ("g",): 1e-3,
    ("lb", "pound"): 0.45359237,
    ("oz",): 0.45359237 / 16,
}
MASS = re.compile(
    r"(?:(?<![\d.,])(?P<plus>\d+(?:[.,]\d+)?) ?\+ ?)?"
    r"(?:(?<!\d)(?P<times>\d+) ?[x*×] ?)?(?P<point>[.,]?)(?<!\d)(?P<number>\d+(?:(?:[-.,·_ p]|dot|pt)\d+)*)"
    r"(?P<power>e[+-]?\d)?[-_ ]?"
    r"(?P<unit>kg(?![fm]|cm)|kilos?(?![a-z])|kilogram|(?:g|gr|gms?|grams?|grammes?|gramm)(?![a-z])|lbs?(?![a-z])|pounds?"
    r"|oz(?![a-z]))(?P<rest>\d+(?![\d.,]*[-_ ]?(?:kg|g|lb|oz)(?![a-z])))?",
    re.IGNORECASE,
)
FRACTION = re.compile(r"(?:(?<![\d.,])(\d+)[-_ ]?)?(?:(?<!\d)(\d)[/⁄](\d)|([¼½¾]))")
NO = re.compile(r"(?<![a-z])(?:no|non|without|wo|sans|ohne|un)[-_ ]?(?:(?:pay)?load(?:ed)?|mass|weight)?[-_ ]*$", re.I)
DATE = re.compile(
    r"(?<!\d)20\d\d([-_.]?)[01]\d\1[0-3]\d(?:[-_T ][0-2]\d[-_.:h]?[0-5]\d(?:[-_.:]?[0-5]\d)?(?=[-_ ]))?(?!\d)"
)
DECIMAL = (".", ",", "·", "p", "dot", "pt")  # between digits; others may also separate a number from what precedes it
LEAST, MOST = 0.01, 1e3  # kg; of a payload. Less may be an acceleration (0.5g), more a time or a count


def masses_in_name(name: str) -> tuple[float, ...]:
    """Read the mass, kg, from the name of a file: no reading, one, or several from which the user must choose.

    ``1,5kg``, ``1p5kg`` and ``1500g`` have one; ``loaded_1_5kg`` may be 1.5 kg or log 1 with 5 kg, ``1kg5`` 1.5 kg or
    log 5 with 1 kg, ``2x1.25kg`` one or two of 1.25 kg, ``0.7+0.5kg`` both or the last. A mass that is too small or too
    large may mean no payload (0), as may ``no_5kg``.
    """
    name = FRACTION.sub(_decimal, DATE.sub(" ", name))
    matches = list(MASS.finditer(name))
    readings = [_readings(match) for match in matches]
    masses = dict.fromkeys(mass for several in readings for mass in several)
    if len(matches) > 1:
        masses |= {round(sum(several[0] for several in readings), 6): None}
    if any(NO.search(name[: match.start()]) for match in matches):
        masses |= {0.0: None}
    likely = [mass for mass in masses if mass == 0 or LEAST <= mass <= MOST]
    return tuple(likely or ((*masses, 0.0) if masses else ()))


def _decimal(match: re.Match[str]) -> str:
    integer, over, under, sign = match.groups()
    return f"{int(integer or 0) + (numeric(sign) if sign else int(over) / (int(under) or 1)):.6g}"


def _readings(match: re.Match[str]) -> list[float]:
    """List the masses, kg, that a number and its unit may mean, the likeliest first."""
    unit = match["unit"].lower()
    factor = next(size for letters, size in UNITS.items() if unit.startswith(letters))
    *before, last = re.split(r"(\D+)", match["number"])
    integer, separator = before[-2:] if before else ("", "")
    texts = []
    if integer and (separator in DECIMAL or integer == "0" or integer[0] != "0"):
        texts.append(f"{integer}.{last}")
    if len(last) == 3 and factor < 0.01 and integer and integer[0] != "0":
        texts.append(integer + last)  # thousands of grams
    if separator not in DECIMAL or len(before) > 2:
        texts.append(last)
    if match["point"] and not integer:
        texts.append(f"0.{last}")
    if match["rest"]:
        texts.insert(0, f"{texts[0].partition('.')[0]}.{match['rest']}")
    numbers = [float(text + (match["power"] or "")) for text in texts]
    if match["power"] and not before:
        numbers.append(float(match["power"].lstrip("eE+-")))  # log 1e with as much
    if match["times"]:
        numbers += [int(match["times"]) * number for number in numbers]
    if match["plus"]:
        numbers.insert(0, float(match["plus"].replace(",", ".")) + numbers[0])
    return [round(number * factor, 6) for number in numbers]
