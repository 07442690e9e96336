"""Bounds of MJCF files, checked before MuJoCo reads them: what they open, repeat and reserve memory for."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING

from gtau.documents.files import regular
from gtau.errors import GtauError
from gtau.robots.readers.xml_document import line_of, read_xml

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

MOST_FILES = 100  # that a file includes or attaches; the files of hands and humanoids have fewer than ten
MOST_BODIES = 2000  # with copies: more keep the compiler busy for minutes
MOST_ELEMENTS = 20 * MOST_BODIES  # a body of a robot has about five joints, shapes and sites
LARGEST_SIZE = 8192  # points along a side of a height field or texture: 256 MiB
COPYING = ("replicate", "composite", "flexcomp")
NESTED = ("worldbody", "body", "frame", "include", *COPYING)
SIZES = ("nrow", "ncol", "width", "height", "nkey")  # and nuser_...
FOLDERS = ("meshdir", "texturedir", "assetdir")

Files = dict[Path, "Element"]


def bounded(root: Element, path: Path) -> list[Element]:
    """List the outermost elements of a file and of those that it includes; refuse what is beyond the bounds."""
    files: Files = {path.resolve(): root}
    attached: Files = {}
    _collect(root, path, files, "include")
    for file, outermost in files.items():
        _collect(outermost, path if file == path.resolve() else file, attached, "model")
    if path.resolve() in attached:
        raise GtauError("it attaches itself by a <model>, without end; attach another file.")
    every = [*files.values(), *(one for file, one in attached.items() if file not in files)]
    _refuse_devices(every, path)
    _check_sizes(every)
    try:
        _check_copies(root, path, files)
        for file, outermost in attached.items():
            _check_copies(outermost, file, attached)
    except RecursionError:
        raise GtauError("its files are nested too deep; write them flatter.") from None
    return list(files.values())


def _collect(root: Element, path: Path, files: Files, tag: str) -> None:
    """Add the files that an element ``include``s, or attaches as a ``model``, and those that these do in turn.

    MuJoCo looks for all of them in the folder of the outermost file, and includes each once.
    """
    waiting = [root]
    while waiting:
        for element in waiting.pop().iter(tag):
            other = path.parent / element.get("file", "")
            if not other.is_file() or other.resolve() in files:
                continue
            if len(files) > MOST_FILES:
                raise GtauError(f"it reads more than {MOST_FILES} other files; give the file of the robot alone.")
            files[other.resolve()] = read_xml(other)
            waiting.append(files[other.resolve()])


def _refuse_devices(roots: Iterable[Element], path: Path) -> None:
    """Refuse pipes and devices, of which MuJoCo would read without end."""
    roots = list(roots)
    folders = {compiler.get(key, "") for root in roots for compiler in root.iter("compiler") for key in FOLDERS}
    named = [element for root in roots for element in root.iter() if element.get("file")]
    for element, folder in product(named, {"", *folders}):
        try:
            regular(path.parent / folder / element.get("file", ""))
        except OSError as error:
            raise GtauError(
                f"line {line_of(element)}: <{element.tag}> cannot be read from '{element.get('file')}': "
                f"{error.strerror or error}; give a file."
            ) from None


def _check_sizes(roots: Iterable[Element]) -> None:
    for element in (part for root in roots for part in root.iter()):
        for key, text in element.items():
            if (key in SIZES or key.startswith("nuser_")) and text.isdecimal() and int(text[:9]) > LARGEST_SIZE:
                raise GtauError(
                    f"line {line_of(element)}: {key} of <{element.tag}> is {text[:20]}, and at most {LARGEST_SIZE} is "
                    "read; give the file of the robot alone."
                )


def _check_copies(root: Element, path: Path, files: Files) -> None:
    """Refuse files that ask for more copies of a body, or of what it holds, than a robot can have."""

    def copies(element: Element, whole: bool) -> float:
        if element.tag == "include":  # a file that is included twice, MuJoCo refuses
            element = once.pop((path.parent / element.get("file", "")).resolve(), element)
        inside = sum(copies(child, whole) for child in element if whole or child.tag in NESTED)
        if element.tag not in COPYING:
            return max(1.0, inside) + whole * (inside > 0)
        try:
            repeated = prod(float(word) for word in element.get("count", "1").split())
        except ValueError:
            return 0.0  # MuJoCo reports the error
        return repeated * max(1.0, inside)

    for whole, limit, what in ((False, MOST_BODIES, "bodies"), (True, MOST_ELEMENTS, "elements")):
        once = dict(files)
        if (most := copies(root, whole)) > limit:
            raise GtauError(
                f"it holds {most:.0f} {what}, with the copies that <replicate> and <composite> ask for, and at most "
                f"{limit} are read; give the file of the robot alone."
            )
