"""Parameter files of OpenSYMORO (``.par``): geometry of simple, tree and closed robots."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from gtau.documents.files import read_at_most
from gtau.errors import GtauError
from gtau.robots.placement import short_angles_note
from gtau.robots.readers.expressions import COORDINATE, RESERVED, evaluate, linear
from gtau.robots.readers.mdh_table import MdhRow, moving_parameter, table_joints, table_row
from gtau.robots.robot import GROUND, STANDARD_GRAVITY, Attachment, Closure, Robot, RobotFile

MAX_BYTES = 1 << 16
LISTS = ("ant", "sigma", "mu", "gamma", "b", "alpha", "d", "theta", "r")
PARAMETERS = LISTS[3:]
COORDINATES = r"(?:th|theta|t|q|r)_?{}"
"""How such files call the coordinate of joint {}."""


def read_par(path: str | Path) -> Robot:
    """Read a robot from a parameter file of OpenSYMORO.

    Joints are named by their numbers. A loop is cut at a joint beyond the number of links: its frame becomes a massless
    link, welded to the fixed frame on the other side. Symbols in lengths and angles need values on separate lines,
    ``D3 = 0.45``. Joints with ``mu = 1`` are actuated, or all joints of an open chain without such a ``mu``. Gravity
    that is not given as numbers is 9.80665 m/s2 along -z. Notes mention both defaults.
    """
    path = Path(path)
    try:
        larger = "the file is larger than 64 KiB; a parameter file is a few kilobytes, so check the path."
        content = read_at_most(MAX_BYTES, path, larger)
        return _robot(content.decode("latin-1"), path)  # old programs wrote accents; the entries read are ASCII
    except GtauError as error:
        raise type(error)(f"{path}: {error}") from None


def _robot(text: str, path: Path) -> Robot:
    name = re.search(r"\(\*\s*Robotname\s*=\s*'([^']*)'\s*\*\)", text)
    entries = _entries(_without_comments(text))
    links, joints, count = (_integer(entries, key) for key in ("NL", "NJ", "NF"))
    for key in ("is_mobile", "is_floating"):
        if entries.get(key.lower(), "0") not in ("0", "false", "False"):
            raise GtauError("the robot's base moves; only robots on a fixed base are read.")
    if not (0 < links <= joints and count == 2 * joints - links):
        raise GtauError(
            f"NL = {links}, NJ = {joints}, NF = {count} do not fit; NF is NL and two for each of the NJ - NL loops."
        )
    constants = _constants(entries)
    lists = {key: _list(entries, key, count) for key in LISTS}
    _check_symbols(lists, constants)
    rows = [
        _row(k, dict(zip(LISTS, texts, strict=True)), constants, links, joints)
        for k, texts in enumerate(zip(*lists.values(), strict=True), start=1)
    ]
    tree, frames = table_joints(rows)
    # a joint that cuts a loop has friction, but its link belongs to the other side
    tree = tuple(replace(joint, parameters="drive") if int(joint.name) > links else joint for joint in tree)
    cuts = range(links + 1, joints + 1)
    closures = tuple(Closure("weld", Attachment(str(cut)), frames[str(cut + joints - links)]) for cut in cuts)
    gravity, notes = _gravity(entries, constants)
    notes += short_angles_note({row.name: row.short for row in rows})
    if not any(joint.actuated for joint in tree) and links == joints:
        tree = tuple(replace(joint, actuated=True) for joint in tree)
        notes += ("no joint has mu = 1, so all were taken as driven by motors",)
    file = RobotFile(path.name, notes, home_given=links == joints)
    return Robot(name[1] if name and name[1] else path.stem, tree, closures=closures, gravity=gravity, file=file)


def _without_comments(text: str) -> str:
    kept, *rest = text.split("(*")
    for piece in rest:
        _, end, after = piece.partition("*)")
        if not end:
            raise GtauError("a comment begins with '(*' and does not end with '*)'; close it.")
        kept += after
    return kept


def _entries(text: str) -> dict[str, str]:
    """Read values by lower-case key, since versions of the program differ in case; lists lose their braces."""
    entries: dict[str, str] = {}
    for key, braces, plain in re.findall(
        r"^[ \t]*(\w+)[ \t]*=[ \t]*(?:\{([^{}]*)\}|([^{}\n]*))", text, flags=re.MULTILINE
    ):
        if key.lower() in entries and key.lower() in (*LISTS, "nl", "nj", "nf", "g"):
            raise GtauError(f"{key} is written twice; keep one of them.")
        entries[key.lower()] = (braces or plain).strip()
    return entries


def _integer(entries: Mapping[str, str], key: str) -> int:
    text = entries.get(key.lower())
    if text is None:
        raise GtauError(f"{key} is missing; this is not a complete parameter file of OpenSYMORO.")
    if not text.isdecimal() or len(text) > 4:
        raise GtauError(f"{key} is '{text}'; write a number.")
    return int(text)


def _constants(entries: Mapping[str, str]) -> dict[str, float]:
    others = entries.keys() - {*LISTS, "nl", "nj", "nf", "type", "is_mobile", "is_floating"}
    return {key: evaluate(entries[key]) for key in others if re.fullmatch(r"[-+.\deE]+", entries[key])}


def _list(entries: Mapping[str, str], key: str, count: int) -> list[str]:
    if key not in entries:
        raise GtauError(f"{key} is missing; this is not a complete parameter file of OpenSYMORO.")
    values: list[str] = []
    depth, start, text = 0, 0, entries[key] + ","
    for position, character in enumerate(text):  # atan2(b, d) holds a comma
        depth += (character == "(") - (character == ")")
        if character == "," and depth == 0:
            values.append(text[start:position].strip())
            start = position + 1
    if len(values) != count and key == "mu":
        values += ["0"] * (count - len(values))  # frames beyond the joints have none
    if len(values) != count:
        raise GtauError(f"{key} has {len(values)} values; write {count}, one for each frame.")
    return values


def _check_symbols(lists: Mapping[str, Sequence[str]], constants: Mapping[str, float]) -> None:
    """Refuse symbols without values, all at once and spelt as in the file."""
    missing: dict[str, tuple[str, str]] = {}
    for key, texts in lists.items():
        for k, text in enumerate(texts, start=1):
            for symbol in re.findall(r"(?<![\w.])[A-Za-z_]\w*\b(?!\s*\()", text):
                is_coordinate = key in ("theta", "r") and re.fullmatch(COORDINATES.format(k), symbol, re.IGNORECASE)
                if not is_coordinate and symbol.lower() not in RESERVED - {COORDINATE} | constants.keys():
                    missing.setdefault(symbol.lower(), (symbol, f"{key} of joint {k}"))
    if missing:
        named = ", ".join(f"{symbol} ({where})" for symbol, where in missing.values())
        first = next(symbol for symbol, _ in missing.values())
        raise GtauError(f"these symbols have no value: {named}; write one for each on a line such as '{first} = 0.45'.")


def _row(k: int, texts: Mapping[str, str], constants: Mapping[str, float], links: int, joints: int) -> MdhRow:
    def value(key: str, moving: bool = False) -> float:
        text = texts[key]
        if moving:
            text = re.sub(rf"\b{COORDINATES.format(k)}\b", "q", text, flags=re.IGNORECASE)
        try:
            factor, constant = linear(text.lower(), constants)
        except ValueError as error:
            raise GtauError(
                f"{key} of joint {k}: {error}; give symbols their values on lines such as 'd3 = 0.45'."
            ) from None
        if factor not in ((0.0, 1.0) if moving else (0.0,)):
            raise GtauError(f"{key} of joint {k}: write the coordinate plainly, as 'th{k}' or 'th{k} + pi/2'.")
        return constant

    sigma = value("sigma")
    if k <= joints and sigma == 2 and k > links:
        raise GtauError(f"joint {k} cuts a loop and is fixed (sigma 2); cut the loop at a joint that moves.")
    if k > joints and sigma != 2:
        raise GtauError(f"frame {k} is the other side of a loop; its sigma must be 2.")
    moving = moving_parameter(str(k), sigma)
    antecedent = value("ant")
    return table_row(
        str(k),
        GROUND if antecedent == 0 else f"{antecedent:g}",
        value("mu"),
        sigma,
        [value(key, key == moving) for key in PARAMETERS],
    )


def _gravity(
    entries: Mapping[str, str], constants: Mapping[str, float]
) -> tuple[tuple[float, float, float], tuple[str, ...]]:
    default = (0.0, 0.0, -STANDARD_GRAVITY)
    texts = [text.strip() for text in entries.get("g", "").split(",")]
    try:
        x, y, z = (evaluate(text.lower(), constants) for text in texts)
    except ValueError:
        note = "gravity is not given as numbers in the file, so it was taken as 9.80665 m/s2 along -z of the base"
        return default, (note,)
    return (x, y, z), ()
