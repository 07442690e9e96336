"""Tables of modified Denavit-Hartenberg parameters as CSV, as in the paper's Tables 1 and 2."""

from __future__ import annotations

import csv
import re
from pathlib import Path

from gtau.documents.expressions import RESERVED, AffineInQ, evaluate, linear
from gtau.documents.files import read_at_most
from gtau.errors import GtauError, errors_at
from gtau.robots.placement import DEGREES_ADVICE, exact_placement, in_degrees, short_angles_note
from gtau.robots.robot import GROUND, Attachment, Joint, JointKind, Mdh, Robot, RobotFile, refuse_many

COLUMNS = ("j", "a", "mu", "sigma", "gamma", "b", "alpha", "d", "theta", "r")
MAX_BYTES = 1 << 20


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
        frames, joints, changes = {GROUND: Attachment(GROUND)}, list[Joint](), dict[str, float]()
        for number, cells in lines:
            name, antecedent, mu, sigma, placement = _row(number, cells, header, constants)
            if antecedent not in frames:
                raise GtauError(
                    f"joint '{name}' has the antecedent '{antecedent}', which is not a joint of an earlier row; "
                    "write 0 for the base, or move the antecedent's row up."
                )
            exact, changes[name] = exact_placement(placement)
            at = frames[antecedent].at(exact)
            if sigma != 2:  # else it becomes a part of a link
                kind: JointKind = "prismatic" if sigma else "revolute"
                joints.append(Joint(name, at.body, kind, at.placement, actuated=mu == 1))
                at = Attachment(name)
            frames[name] = at
        if not lines:
            raise GtauError("no joint is listed; write a line for each below the header.")
        return Robot(path.stem, tuple(joints), file=RobotFile(path.name, short_angles_note(changes)))


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
    """Remove the constants and the header from `lines`."""
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
                    f"line {number}: this header of DH parameters lacks {missing}; gtau reads modified DH, where alpha "
                    "and d of a row are before its joint: of standard DH, move alpha and a of each row to the next "
                    "one, a as d, and write d as r."
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


def _row(
    number: int, cells: list[str], header: list[str], constants: dict[str, float]
) -> tuple[str, str, float, float, Mdh]:
    """Read a row: names of joint and antecedent, mu, sigma, and the placement in the antecedent's frame."""
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
        if sigma not in (0, 1, 2):
            kinds = "0 (revolute), 1 (prismatic) or 2 (fixed frame)"
            raise GtauError(f"sigma of joint '{name}' is {sigma:g}; write {kinds}.")
        if mu not in (0, 1):
            raise GtauError(f"mu of joint '{name}' is {mu:g}; write 1 (driven by a motor) or 0 (passive).")
        for key, angle in zip(("gamma", "alpha", "theta"), parameters[::2], strict=True):
            if in_degrees(angle):
                raise GtauError(f"{key} of joint '{name}' is {angle:g}; angles are in rad, so {DEGREES_ADVICE}.")
    moving = ("theta", "r", "")[int(sigma)]
    for column, (factor, _) in numbers.items():
        if factor not in ((0.0, 1.0) if column == moving else (0.0,)):
            raise GtauError(
                f"line {number}, {column} of joint '{name}': write the coordinate q plainly, and only in theta "
                "(sigma 0) or r (sigma 1)."
            )
    return name, GROUND if texts["a"] == "0" else texts["a"], mu, sigma, Mdh(*parameters)
