"""XML files read safely: no entities, no document types, bounded size, numbers checked."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from xml.etree.ElementTree import Element, ParseError, TreeBuilder
from xml.parsers.expat import errors

from gtau.documents.files import read_at_most
from gtau.errors import GtauError

MAX_BYTES = 1 << 24
MAX_DEPTH = 200
PREFIX = re.compile(rb"(</?|\s)(?!xmlns:)([A-Za-z_][\w.-]*):(?=[\w.-]+(?:[\s/>]|\s*=\s*[\"']))")
"""Prefix of an element or attribute. Files for simulators use undeclared prefixes, which no reader needs."""


def read_xml(path: Path) -> Element:
    """Read the root element of an XML file."""
    from defusedxml import DefusedXmlException

    larger = "the file is larger than 16 MiB; a robot is text without meshes, so check the path."
    content = read_at_most(MAX_BYTES, path, larger)
    try:
        try:
            root = _parsed(content)
        except ParseError as error:
            if error.code != errors.codes[errors.XML_ERROR_UNBOUND_PREFIX]:
                raise
            root = _parsed(PREFIX.sub(rb"\1\2.", content))
    except DefusedXmlException:
        raise GtauError("the file declares entities or a document type; write their values out.") from None
    except (ParseError, ValueError, LookupError) as error:
        raise GtauError(f"this is not valid XML ({error}); correct the file.") from None
    level = [root]
    for _ in range(MAX_DEPTH):
        level = [child for element in level for child in element]
    if level:
        raise GtauError(f"elements are nested more than {MAX_DEPTH} levels deep; check the file.")
    return root


class _Element(Element):
    line = 0


def _parsed(content: bytes) -> Element:
    from defusedxml.ElementTree import DefusedXMLParser

    class Parser(DefusedXMLParser):  # type: ignore[misc, unused-ignore]
        """Parser that records the line in which an element begins."""

        def _start(self, tag: str, attributes: list[str]) -> Element:
            element: Element = super()._start(tag, attributes)
            element.line = self.parser.CurrentLineNumber  # type: ignore[attr-defined]
            return element

    parser = Parser(target=TreeBuilder(element_factory=_Element), forbid_dtd=True)
    parser.feed(content)
    root: Element = parser.close()
    return root


def line_of(element: Element) -> int:
    """Return the line of the file in which an element begins, 0 if unknown."""
    return int(getattr(element, "line", 0))


DECIMAL = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
ENDLESS = re.compile(r"[+-]?inf(?:inity)?", re.IGNORECASE | re.ASCII)
LARGEST = 1e9  # SI units: no number of a robot comes near; 1e16 and more mean 'no limit'


def decimals(text: str, endless: bool = False) -> list[float] | None:
    """Read plain decimals within the physical range of a robot, or beyond if ``endless``; None for anything else."""
    words = text.split()
    if not all(DECIMAL.fullmatch(word) or (endless and ENDLESS.fullmatch(word)) for word in words):
        return None
    values = list(map(float, words))
    return values if endless or all(abs(value) <= LARGEST for value in values) else None


def numbers(text: str, count: int, what: str, endless: bool = False) -> list[float]:
    """Read the numbers of an attribute or element, see :func:`decimals`; refuse any other count."""
    values = decimals(text, endless)
    if values is None or len(values) != count:
        needed = "a plain decimal number" if count == 1 else f"{count} plain decimal numbers"
        size = "" if endless else f", at most {LARGEST:g} in size"
        raise GtauError(f"the {what} is '{text}'; write {needed}{size}.")
    return values


def all_numbers(elements: Iterable[Element], keys: Sequence[str]) -> list[float]:
    """List the numbers in some attributes of elements."""
    return [value for element in elements for key in keys for value in decimals(element.get(key, "")) or ()]


def position_limits(low: float, high: float) -> tuple[float, float] | None:
    """Return position limits, rad or m; None if their range is empty or one of them means no limit."""
    return (low, high) if low < high and max(abs(low), abs(high)) <= LARGEST else None


def attribute(element: Element, key: str, what: str) -> str:
    """Read a required attribute."""
    value = element.get(key)
    if not value:
        raise GtauError(f'{what} has no {key}; write {key}="...".')
    return value
