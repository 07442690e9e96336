"""Tables of modified Denavit-Hartenberg parameters, as in the paper's Tables 1 and 2: CSV and OpenSYMORO's."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from gtau.documents.expressions import COORDINATE, RESERVED, AffineInQ, evaluate, linear
from gtau.documents.files import read_at_most
from gtau.errors import GtauError, errors_at
from gtau.robots.placement import DEGREES_ADVICE, exact_placement, in_degrees, short_angles_note
from gtau.robots.robot import (
    GROUND,
    STANDARD_GRAVITY,
    Attachment,
    Closure,
    Joint,
    JointKind,
    Mdh,
    Placement,
    Robot,
    RobotFile,
    refuse_many,
)

COLUMNS = ("j", "a", "mu", "sigma", "gamma", "b", "alpha", "d", "theta", "r")
MAX_BYTES = 1 << 20
MAX_PAR_BYTES = 1 << 16
LISTS = ("ant", "sigma", "mu", "gamma", "b", "alpha", "d", "theta", "r")
COORDINATES = r"(?:th|theta|t|q|r)_?{}"
"""How parameter files call the coordinate of joint {}."""


class _Row(NamedTuple):
    """A frame of a table, placed in the frame of its antecedent; rounded angles are changed by at most ``short``, rad.

    ``sigma`` is 0 for a revolute joint, 1 for a prismatic one and 2 for a fixed frame; ``mu`` is 1 for a motor.
    """

    name: str
    antecedent: str
    mu: int
    sigma: int
    placement: Placement
    short: float


def _moving_parameter(name: str, sigma: float) -> str | None:
    """Return the parameter that a joint's coordinate is added to: theta, r, or None for a fixed frame."""
    if sigma not in (0, 1, 2):
        raise GtauError(f"sigma of joint '{name}' is {sigma:g}; write 0 (revolute), 1 (prismatic) or 2 (fixed frame).")
    return ("theta", "r", None)[int(sigma)]


def _row(name: str, antecedent: str, mu: float, sigma: float, parameters: Sequence[float]) -> _Row:
    """Make a row from numbers: mu, sigma, and (gamma, b, alpha, d, theta, r), angles in rad, lengths in m."""
    if mu not in (0, 1):
        raise GtauError(f"mu of joint '{name}' is {mu:g}; write 1 (driven by a motor) or 0 (passive).")
    for key, angle in zip(("gamma", "alpha", "theta"), parameters[::2], strict=True):
        if in_degrees(angle):
            raise GtauError(f"{key} of joint '{name}' is {angle:g}; angles are in rad, so {DEGREES_ADVICE}.")
    return _Row(name, antecedent, int(mu), int(sigma), *exact_placement(Mdh(*parameters)))


def _joints(rows: Sequence[_Row]) -> tuple[list[Joint], dict[str, Attachment]]:
    """Make the joints of a table, and place its fixed frames in their links."""
    frames = {GROUND: Attachment(GROUND)}
    joints = []
    for row in rows:
        if row.antecedent not in frames:
            raise GtauError(
                f"joint '{row.name}' has the antecedent '{row.antecedent}', which is not a joint of an earlier row; "
                "write 0 for the base, or move the antecedent's row up."
            )
        at = frames[row.antecedent].at(row.placement)
        if row.sigma != 2:
            kind: JointKind = "prismatic" if row.sigma else "revolute"
            joints.append(Joint(row.name, at.body, kind, at.placement, actuated=row.mu == 1))
            at = Attachment(row.name)
        frames[row.name] = at
    return joints, frames


def read_mdh_csv(path: str | Path) -> Robot:
    """Read a serial or tree robot from a table of MDH parameters, with gravity along -z.

    The header names the ``COLUMNS`` in any order: joint, antecedent (``0`` is the base), 1 for a motor, 0 revolute, 1
    prismatic or 2 fixed, and the parameters, rad and m. Cells are numbers or arithmetic such as ``pi/2``; ``theta`` or
    ``r`` of joint 13 may be ``q13 - a`` or ``q - a``. Lines ``name = value`` before the header give constants.
    """
    path = Path(path)
    with errors_at(path):
        lines = _lines(path)
        refuse_many(len(lines), "rows")
        constants, header = _constants(lines)
        rows = [_csv_row(number, cells, header, constants) for number, cells in lines]
        if not rows:
            raise GtauError("no joint is listed; write a line for each below the header.")
        joints, _ = _joints(rows)
        notes = short_angles_note({row.name: row.short for row in rows})
        return Robot(path.stem, tuple(joints), file=RobotFile(path.name, notes))


def _lines(path: Path) -> list[tuple[int, list[str]]]:
    larger = "the file is larger than 1 MiB; a table of a robot is a few kilobytes, so check the path."
    content = read_at_most(MAX_BYTES, path, larger)
    try:
        text = content.decode("utf-8-sig")
        cells = [[cell.strip() for cell in row] for row in csv.reader(text.splitlines(), strict=True)]
    except UnicodeDecodeError:
        raise GtauError("the text is not UTF-8; save the file in that encoding.") from None
    except csv.Error as error:
        raise GtauError(f"this is not a table of comma-separated values ({error}); correct the file.") from None
    return [(number, row) for number, row in enumerate(cells, start=1) if any(row) and not row[0].startswith("#")]


def _constants(lines: list[tuple[int, list[str]]]) -> tuple[dict[str, float], list[str]]:
    constants: dict[str, float] = {}
    while lines:
        number, cells = lines.pop(0)
        if set(COLUMNS) <= set(cells):
            if len(set(cells)) < len(cells) or set(cells) > set(COLUMNS):
                raise GtauError(f"line {number}: the header must name each of {', '.join(COLUMNS)} once, nothing else.")
            return constants, cells
        name, sign, value = cells[0].partition("=")
        name = name.strip()
        if not sign or len(cells) > 1:
            missing = ", ".join(column for column in COLUMNS if column not in cells)
            words = {word for cell in cells for word in re.split(r"[^a-zα-ω]", cell.lower())}
            if words & {"alpha", "α"} and words & {"theta", "θ"} and words.isdisjoint(("mu", "sigma")):
                raise GtauError(
                    f"line {number}: this header of DH parameters lacks {missing}; in gtau's modified DH, a is the "
                    "antecedent: write Craig's a as d, and d as r; of standard DH, also move alpha and a of each row "
                    "to the next one."
                )
            raise GtauError(
                f"line {number}: this is neither a constant ('a = 0.34') nor the header, which lacks {missing}."
            )
        if name in RESERVED or not name.isidentifier() or not name.isascii():
            raise GtauError(f"line {number}: '{name}' cannot name a constant; use letters, digits and _.")
        try:
            constants[name] = evaluate(value, constants)
        except ValueError as error:
            raise GtauError(f"line {number}, {name}: {error}.") from None
    raise GtauError(f"it has no header; write {','.join(COLUMNS)} above the joints.")


def _csv_row(number: int, cells: list[str], header: list[str], constants: dict[str, float]) -> _Row:
    if len(cells) != len(header):
        raise GtauError(f"line {number}: it has {len(cells)} cells; write {len(header)}, as in the header.")
    texts = dict(zip(header, cells, strict=True))
    name = texts["j"]

    def read(column: str) -> AffineInQ:
        text = re.sub(rf"\bq_?{re.escape(name)}\b", "q", texts[column])
        try:
            return linear(text, constants)
        except ValueError as error:
            raise GtauError(f"line {number}, {column} of joint '{name}': {error}.") from None

    numbers = {column: read(column) for column in COLUMNS[2:]}
    mu, sigma, *parameters = (constant for _, constant in numbers.values())
    with errors_at(f"line {number}"):
        moving = _moving_parameter(name, sigma)
    for column, (factor, _) in numbers.items():
        if factor not in ((0.0, 1.0) if column == moving else (0.0,)):
            raise GtauError(
                f"line {number}, {column} of joint '{name}': write the coordinate q plainly, and only in theta "
                "(sigma 0) or r (sigma 1)."
            )
    with errors_at(f"line {number}"):
        return _row(name, GROUND if texts["a"] == "0" else texts["a"], mu, sigma, parameters)


def read_par(path: str | Path) -> Robot:
    """Read a robot from a parameter file of OpenSYMORO.

    A loop is cut at a joint beyond the number of links: its frame becomes a massless link, welded to the fixed frame on
    the other side. Symbols in lengths and angles need values on separate lines, ``D3 = 0.45``. Joints with ``mu = 1``
    are actuated, or all joints of an open chain without such a ``mu``; gravity without numbers is along -z.
    """
    path = Path(path)
    with errors_at(path):
        larger = "the file is larger than 64 KiB; a parameter file is a few kilobytes, so check the path."
        return _robot(read_at_most(MAX_PAR_BYTES, path, larger).decode("latin-1"), path)  # with accents in comments


def _robot(text: str, path: Path) -> Robot:
    name = re.search(r"\(\*\s*Robotname\s*=\s*'([^']*)'\s*\*\)", text)
    text = re.sub(r"\(\*(?:(?!\(\*).)*?\*\)", "", text, flags=re.DOTALL)
    if "(*" in text:
        raise GtauError("a comment begins with '(*' and does not end with '*)'; close it.")
    entries = _entries(text)
    links, joints, count = (_integer(entries, key) for key in ("NL", "NJ", "NF"))
    for key in ("is_mobile", "is_floating"):
        if entries.get(key.lower(), "0") not in ("0", "false", "False"):
            raise GtauError("the robot's base moves; only robots on a fixed base are read.")
    if not (0 < links <= joints and count == 2 * joints - links):
        raise GtauError(
            f"NL = {links}, NJ = {joints}, NF = {count} do not fit; NF is NL and two for each of the NJ - NL loops."
        )
    constants = _values(entries)
    lists = {key: _list(entries, key, count) for key in LISTS}
    _check_symbols(lists, constants)
    rows = [
        _par_row(k, dict(zip(LISTS, texts, strict=True)), constants, links, joints)
        for k, texts in enumerate(zip(*lists.values(), strict=True), start=1)
    ]
    tree, frames = _joints(rows)
    # a joint that cuts a loop has friction, but its link belongs to the other side
    tree = [replace(joint, parameters="drive") if int(joint.name) > links else joint for joint in tree]
    cuts = range(links + 1, joints + 1)
    closures = tuple(Closure("weld", Attachment(str(cut)), frames[str(cut + joints - links)]) for cut in cuts)
    gravity, notes = _gravity(entries, constants)
    notes += short_angles_note({row.name: row.short for row in rows})
    if not any(joint.actuated for joint in tree) and links == joints:
        tree = [replace(joint, actuated=True) for joint in tree]
        notes += ("no joint has mu = 1, so all were taken as driven by motors",)
    file = RobotFile(path.name, notes, home_given=links == joints)
    title = name[1] if name and name[1] else path.stem
    return Robot(title, tuple(tree), closures=closures, gravity=gravity, file=file)


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
    text = _entry(entries, key)
    if not text.isdecimal() or len(text) > 4:
        raise GtauError(f"{key} is '{text}'; write a number.")
    return int(text)


def _values(entries: Mapping[str, str]) -> dict[str, float]:
    others = entries.keys() - {*LISTS, "nl", "nj", "nf", "type", "is_mobile", "is_floating"}
    return {key: evaluate(entries[key]) for key in others if re.fullmatch(r"[-+.\deE]+", entries[key])}


def _entry(entries: Mapping[str, str], key: str) -> str:
    if key.lower() not in entries:
        raise GtauError(f"{key} is missing; this is not a complete parameter file of OpenSYMORO.")
    return entries[key.lower()]


def _list(entries: Mapping[str, str], key: str, count: int) -> list[str]:
    values: list[str] = []
    depth, start, text = 0, 0, _entry(entries, key) + ","
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


def _par_row(k: int, texts: Mapping[str, str], constants: Mapping[str, float], links: int, joints: int) -> _Row:
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
    moving = _moving_parameter(str(k), sigma)
    number, mu = value("ant"), value("mu")
    parameters = [value(key, key == moving) for key in LISTS[3:]]
    return _row(str(k), f"{number:g}" if number else GROUND, mu, sigma, parameters)


def _gravity(
    entries: Mapping[str, str], constants: Mapping[str, float]
) -> tuple[tuple[float, float, float], tuple[str, ...]]:
    texts = [text.strip() for text in entries.get("g", "").split(",")]
    try:
        x, y, z = (evaluate(text.lower(), constants) for text in texts)
    except ValueError:
        note = "gravity is not given as numbers in the file, so it was taken as 9.80665 m/s2 along -z of the base"
        return (0.0, 0.0, -STANDARD_GRAVITY), (note,)
    return (x, y, z), ()
