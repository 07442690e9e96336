"""Input file of a robot, rewritten with identified parameters and otherwise unchanged."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from pathlib import Path
from xml.etree.ElementTree import Element, indent, tostring
from xml.parsers.expat import ParserCreate

import numpy as np

from gtau.errors import GtauError
from gtau.export.exported import written
from gtau.model.home import load_robot
from gtau.robots.readers.xml_document import read_xml
from gtau.robots.robot import Robot

SAME = 1e-6  # m, and entries of rotations: readers round


@dataclass(frozen=True)
class Span:
    """Location of an element in the bytes of its file: from ``start`` to ``stop``, its start tag up to ``inner``."""

    start: int
    inner: int
    stop: int


@dataclass(frozen=True, eq=False)
class InputFile:
    """Unchanged XML file, its elements with their spans, and the pending ``edits``: span, new bytes."""

    path: Path
    content: bytes
    root: Element
    spans: dict[Element, Span]
    edits: list[tuple[int, int, bytes]] = field(default_factory=list)

    def set(self, element: Element, **attributes: str) -> None:
        """Set attributes of an element; all others stay unchanged."""
        span = self.spans[element]
        tag = self.content[span.start : span.inner].decode("ascii", "surrogateescape")
        for name, value in attributes.items():
            tag, count = re.subn(rf"(\s{name}\s*=\s*)(\"[^\"]*\"|'[^']*')", rf'\g<1>"{value}"', tag, count=1)
            if not count:
                tag = re.sub(r"\s*(/?>)$", rf' {name}="{value}"\g<1>', tag)
        self.edits.append((span.start, span.inner, tag.encode("ascii", "surrogateescape")))

    def put(self, parent: Element, new: Element) -> None:
        """Put an element into another, in place of one of its kind, or as the first content on its own line."""
        indent(new)
        text, old = tostring(new, encoding="unicode").encode(), parent.find(new.tag)
        span = self.spans[parent if old is None else old]
        line = self.content[self.content.rfind(b"\n", 0, span.start) + 1 : span.start]
        margin = b"\n" + line * line.isspace()  # where nothing else precedes it
        inside = (b"\n" + text).replace(b"\n", margin + b"  ")
        if old is not None:
            self.edits.append((span.start, span.stop, text.replace(b"\n", margin)))
        elif span.inner == span.stop:  # <a/>
            tag = self.content[span.start : span.inner].rstrip(b"/>").rstrip()
            self.edits.append((span.start, span.stop, tag + b">" + inside + margin + f"</{parent.tag}>".encode()))
        else:
            self.edits.append((span.inner, span.inner, inside))

    def remove(self, element: Element) -> None:
        """Remove an element, with the white space before it."""
        span = self.spans[element]
        self.edits.append((len(self.content[: span.start].rstrip()), span.stop, b""))

    def text(self) -> bytes:
        """Return the file with all edits made."""
        made = self.content
        for start, stop, new in sorted(self.edits, reverse=True):
            made = made[:start] + new + made[stop:]
        return made

    def save(self, out: Path) -> tuple[Path, ...]:
        """Write the file under its own name into the folder ``out``."""
        return written(out, {self.path.name: self.text()})


def input_file(path: Path, robot: Robot) -> InputFile:
    """Read the file of ``robot`` for edits; raises GtauError if it is unreadable or describes another robot."""
    if problem := _difference(load_robot(path), robot):
        raise GtauError(f"{path} is not the file of the model's robot '{robot.name}': {problem}; give its own file.")
    try:
        root = read_xml(path)  # safe: no entities, no document types
    except GtauError as error:
        raise GtauError(f"{path}: {error}") from None
    content = path.read_bytes()
    if b"\0" in content:
        raise GtauError(f"{path} is UTF-16 text, which cannot be edited in place; save it as UTF-8.")
    return InputFile(path, content, root, dict(zip(root.iter(), _spans(content), strict=True)))


def _spans(content: bytes) -> list[Span]:
    """Find the spans of all elements in document order."""
    parser = ParserCreate()
    spans: dict[int, Span] = {}  # by where the elements begin
    inside: list[int] = []

    def start(name: str, attributes: object) -> None:
        inside.append(parser.CurrentByteIndex)
        spans[inside[-1]] = Span(inside[-1], _tag_end(content, inside[-1]), 0)

    def end(name: str) -> None:
        span = spans[inside.pop()]
        empty = content.endswith(b"/>", 0, span.inner)  # its end is reported at its beginning, or after it
        spans[span.start] = replace(span, stop=span.inner if empty else _tag_end(content, parser.CurrentByteIndex))

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.Parse(content, True)
    return list(spans.values())


def _tag_end(content: bytes, start: int) -> int:
    """Find where a tag that begins at ``start`` ends; a > within quotes does not end it."""
    tag = re.compile(rb"<(?:[^>\"']|\"[^\"]*\"|'[^']*')*>").match(content, start)
    assert tag is not None
    return tag.end()


def _difference(file_robot: Robot, robot: Robot) -> str:
    """Describe the difference between two robots' bodies, if any."""
    if file_robot.bodies != robot.bodies:
        missing = [name for name in robot.bodies if name not in file_robot.bodies]
        return f"'{missing[0]}' is missing there" if missing else f"it has {len(file_robot.bodies)} bodies"
    for one, other in zip(file_robot.joints, robot.joints, strict=True):
        if (one.antecedent, one.kind) != (other.antecedent, other.kind):
            return f"joint '{one.name}' has another parent or is of another kind"
        a, b = (np.vstack([joint.placement.rotation, joint.placement.position, joint.axis]) for joint in (one, other))
        if np.abs(a - b).max() > SAME:
            return f"joint '{one.name}' is placed otherwise"
    return ""
