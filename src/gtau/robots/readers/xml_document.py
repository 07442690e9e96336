"""XML files read safely: no entities, no document types, bounded size, numbers checked."""

from __future__ import annotations

import re
from math import isfinite
from pathlib import Path
from xml.etree.ElementTree import Element, ParseError, TreeBuilder
from xml.parsers.expat import errors

from gtau.documents.files import read_at_most
from gtau.errors import GtauError

MAX_BYTES = 1 << 24
MAX_DEPTH = 200
PREFIX = re.compile(rb"(</?|\s)(?!xmlns:)([A-Za-z_][\w.-]*):(?=[\w.-]+(?:[\s/>]|\s*=\s*[\"']))")
"""The prefix of an element or attribute. Simulators' have some that are declared nowhere; no reader looks at these."""


def read_xml(path: Path) -> Element:
    """Read the root element of an XML file.

    Raises
    ------
    GtauError
        The file cannot be read, is larger than 16 MiB, is no XML, declares entities or a document type, or is nested
        more than 200 levels deep. The message does not name the file; the caller does.
    """
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
    """An element that knows its line."""

    line = 0


def _parsed(content: bytes) -> Element:
    from defusedxml.ElementTree import DefusedXMLParser

    class Parser(DefusedXMLParser):  # type: ignore[misc, unused-ignore]
        """A parser that keeps the line in which an element begins."""

        def _start(self, tag: str, attributes: list[str]) -> Element:
            element: Element = super()._start(tag, attributes)
            element.line = self.parser.CurrentLineNumber  # type: ignore[attr-defined]
            return element

    parser = Parser(target=TreeBuilder(element_factory=_Element), forbid_dtd=True)
    parser.feed(content)
    root: Element = parser.close()
    return root


def line_of(element: Element) -> int:
    """Return the line of the file in which an element begins, 0 where it is not known."""
    return int(getattr(element, "line", 0))


def numbers(text: str, count: int, what: str) -> list[float]:
    """Read the finite numbers of an attribute or element; refuse any other count."""
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    if len(values) != count or not all(map(isfinite, values)):
        needed = "a number" if count == 1 else f"{count} numbers"
        raise GtauError(f"the {what} is '{text}'; write {needed}.")
    return values


def attribute(element: Element, key: str, what: str) -> str:
    """Read an attribute that must be there."""
    value = element.get(key)
    if not value:
        raise GtauError(f'{what} has no {key}; write {key}="...".')
    return value
