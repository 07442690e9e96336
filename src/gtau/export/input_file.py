"""The file that a robot came from, to be written again with identified parameters and everything else as it was."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from gtau.errors import GtauError
from gtau.export.exported import Exported, written
from gtau.model.home import load_robot
from gtau.robots.readers.xml_document import read_xml
from gtau.robots.robot import Robot

SAME = 1e-6  # m, and entries of rotations: readers round


@dataclass(frozen=True, eq=False)
class InputFile:
    """An XML file: its ``root`` with comments, and the text ``before`` and ``after`` it."""

    path: Path
    before: str
    root: Element
    after: str

    def save(self, out: Path, notes: list[str], figures: dict[str, float]) -> Exported:
        """Write the file under its own name into another folder ``out``.

        Raises
        ------
        GtauError
            Where that is the folder of the file itself.
        """
        if (out / self.path.name).resolve() == self.path.resolve():
            raise GtauError(f"{self.path} would be overwritten; choose another folder for --out.")
        text = self.before + ElementTree.tostring(self.root, encoding="unicode").rstrip() + self.after
        return Exported(written(out, {self.path.name: text}), tuple(notes), figures)


def input_file(path: Path, robot: Robot) -> InputFile:
    """Read the file of ``robot`` with its comments.

    Raises
    ------
    GtauError
        Where the file cannot be read, or describes another robot than the model.
    """
    found = load_robot(path)
    if problem := _difference(found, robot):
        raise GtauError(f"{path} is not the file of the model's robot '{robot.name}': {problem}; give its own file.")
    try:
        root = read_xml(path)  # safe: no entities, no document types
    except GtauError as error:
        raise GtauError(f"{path}: {error}") from None
    text = path.read_text(encoding="utf-8")
    start, stop = re.search(rf"<{root.tag}\b", text), text.rfind(f"</{root.tag}>")
    assert start is not None
    end = stop + len(f"</{root.tag}>")
    parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    for prefix, uri in re.findall(r'xmlns:(\w+)="([^"]+)"', text):
        ElementTree.register_namespace(prefix, uri)
    return InputFile(path, text[: start.start()], ElementTree.fromstring(text[start.start() : end], parser), text[end:])


def _difference(found: Robot, robot: Robot) -> str:
    """What distinguishes two robots' bodies, if anything does."""
    if found.bodies != robot.bodies:
        missing = [name for name in robot.bodies if name not in found.bodies]
        return f"'{missing[0]}' is missing there" if missing else f"it has {len(found.bodies)} bodies"
    for one, other in zip(found.joints, robot.joints, strict=True):
        if (one.antecedent, one.kind) != (other.antecedent, other.kind):
            return f"joint '{one.name}' hangs elsewhere or is of another kind"
        pairs = (
            (one.placement.rotation, other.placement.rotation),
            (one.placement.position, other.placement.position),
            (np.array(one.axis), np.array(other.axis)),
        )
        if any(np.abs(a - b).max() > SAME for a, b in pairs):
            return f"joint '{one.name}' is placed otherwise"
    return ""
