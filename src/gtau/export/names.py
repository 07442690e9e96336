"""Names of robots, joints and payloads, valid in the languages of the exports."""

from __future__ import annotations

import re
from collections.abc import Iterable
from unicodedata import normalize

LONGEST = 40  # characters: with what follows, MATLAB's 63 are not exceeded
SPECIAL = {
    "\\": r"\textbackslash{}",
    "^": r"\textasciicircum{}",
    "~": r"\textasciitilde{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': "''",
    "ß": r"\ss{}",
    "æ": r"\ae{}",
    "Æ": r"\AE{}",
    "ø": r"\o{}",
    "Ø": r"\O{}",
    "ł": r"\l{}",
    "Ł": r"\L{}",
} | {each: rf"\{each}" for each in "_#%&${}"}
ACCENTS = {"\u0300": "`", "\u0301": "'", "\u0302": "^", "\u0303": "~", "\u0308": '"', "\u030a": "r", "\u0327": "c"}
ACCENTS |= {"\u030c": "v", "\u0306": "u", "\u0304": "=", "\u0307": ".", "\u030b": "H", "\u0328": "k"}


def identifier(name: str) -> str:
    """Make a name that C, MATLAB, Python and file systems accept: ``five-bar`` becomes ``five_bar``."""
    plain = _word(name.lower())
    return (plain if re.match(r"[a-z]", plain) else f"robot_{plain}")[:LONGEST]


def suffixes(names: Iterable[str]) -> dict[str, str]:
    """Make names unique suffixes of identifiers: ``a-b`` and ``a_b`` become ``a_b`` and ``a_b_2``."""
    found: dict[str, str] = {}
    for name in names:
        plain, number = _word(name)[:LONGEST], 1
        while (made := plain if number == 1 else f"{plain}_{number}") in found.values():
            number += 1
        found[name] = made
    return found


def _word(name: str) -> str:
    return re.sub(r"\W", "_", name, flags=re.ASCII)


def in_c(text: str) -> str:
    """Clean a text so that it is safe in a comment and in a string of C."""
    return re.sub(r"[^\w .,:;()+/-]", "_", text, flags=re.ASCII)


def in_matlab(text: str) -> str:
    """Write a text as a string of MATLAB."""
    return "'" + text.replace("'", "''") + "'"


def in_latex(text: str) -> str:
    """Write a text so that LaTeX prints it: accents as macros, and what no common font has as ``U+1F916``."""
    made: list[str] = []
    for character in normalize("NFD", text):
        if character in ACCENTS and made:
            made[-1] = rf"\{ACCENTS[character]}{{{made[-1]}}}"
        else:
            plain = character if character.isascii() else f"U+{ord(character):04X}"
            made.append(SPECIAL.get(character, plain))
    return "".join(made)


def in_latex_index(name: str) -> str:
    """Write a name as an upright index of a formula."""
    if re.fullmatch(r"[\w .:-]*", name, flags=re.ASCII):
        return r"\mathrm{" + in_latex(name).replace(" ", r"\ ") + "}"
    return r"\text{" + in_latex(name) + "}"  # accents and some signs are for text alone
