"""Read YAML and XML files safely, with the line of every key or element, and write readable YAML.

Nothing in a file is executed or guessed. In YAML scalars stay text (a joint may be called ``11``, ``01`` or ``on``),
and anchors, tags and repeated keys are refused; in XML entities and document types are, and numbers are checked.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, ParseError, TreeBuilder
from xml.parsers.expat import errors

import numpy as np
import yaml

from gtau.documents.files import read_at_most, system_refusals
from gtau.errors import GtauError, short

MAX_BYTES = 1 << 20
MAX_DEPTH = 64

KeyPath = tuple[str | int, ...]
"""Path of a value: keys of mappings and positions (from 0) in lists."""


class Document:
    """A file of nested dicts and lists of texts: its path, its ``data``, and the line of every value.

    ``content`` is YAML, parsed to PyYAML's events without resolving tags or constructing objects, or data from another
    reader, whose keys and integers become texts.
    """

    def __init__(self, path: str | Path, content: str | Mapping[str, Any]) -> None:
        self.path = Path(path)
        self.lines: dict[KeyPath, int] = {}
        self.data: dict[str, Any] = self._parsed(content) if isinstance(content, str) else _as_written(content)

    def line(self, keys: KeyPath) -> int | None:
        """Find the line (from 1) of the value at `keys`, or of the nearest enclosing value."""
        while keys and keys not in self.lines:
            keys = keys[:-1]
        return self.lines.get(keys) if keys else None

    def error(self, keys: KeyPath, problem: str) -> GtauError:
        """Make an error with file, line and dotted key; `problem` states the correct form."""
        place = [str(self.path)]
        if (line := self.line(keys)) is not None:
            place.append(f"line {line}")
        if keys:
            place.append(".".join(str(key + 1) if isinstance(key, int) else short(key) for key in keys))
        return GtauError(f"{', '.join(place)}: {problem}{'' if problem.endswith('?') else '.'}")

    def _parsed(self, text: str) -> dict[str, Any]:
        self._events: Iterator[Any] = yaml.parse(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
        try:
            next(self._events)  # stream start
            if isinstance(next(self._events), yaml.StreamEndEvent):
                raise GtauError(f"{self.path} is empty; write 'key: value' lines.")
            root = next(self._events)
            if not isinstance(root, yaml.MappingStartEvent):
                raise self._error(root, "the file must consist of 'key: value' lines")
            data: dict[str, Any] = self._value(root, ())
            next(self._events)  # document end
            after = next(self._events)
            if not isinstance(after, yaml.StreamEndEvent):
                raise self._error(after, "a second document begins here; keep one document in a file")
        except yaml.MarkedYAMLError as error:
            mark = error.problem_mark or error.context_mark
            line = f", line {mark.line + 1}" if mark else ""
            reported = " ".join(filter(None, (error.context, error.problem)))
            known = (sentence for part, sentence in SYNTAX if part in reported)
            problem = next(known, f"{reported}; correct the line")
            raise GtauError(f"{self.path}{line}: this is not valid YAML: {problem}.") from None
        except yaml.YAMLError:
            raise GtauError(f"{self.path} holds control characters; save it as plain text.") from None
        del self._events
        return data

    def _value(self, event: Any, keys: KeyPath) -> Any:
        self.lines[keys] = event.start_mark.line + 1
        if isinstance(event, yaml.AliasEvent) or event.anchor is not None:
            raise self._error(event, "anchors (&) and aliases (*) are not read; write the value out")
        if event.tag is not None:
            raise self._error(event, f"the tag '{event.tag}' is not read; write the value without it")
        if len(keys) > MAX_DEPTH:
            raise self._error(event, f"values are nested more than {MAX_DEPTH} levels deep; write them flatter")
        if isinstance(event, yaml.ScalarEvent):
            if event.implicit[0] and not event.value:
                key = keys[-1] if isinstance(keys[-1], str) else "-"
                self._refuse_rest(event, key)
                raise self._error(event, f"nothing is written after '{key}'; write a value or remove the line")
            return event.value
        if isinstance(event, yaml.SequenceStartEvent):
            items: list[Any] = []
            while not isinstance(item := next(self._events), yaml.SequenceEndEvent):
                if event.flow_style and items and isinstance(item, yaml.ScalarEvent) and item.implicit[0]:
                    self._refuse_rest(item, item.value)
                items.append(self._value(item, (*keys, len(items))))
            return items
        mapping: dict[str, Any] = {}
        while not isinstance(key := next(self._events), yaml.MappingEndEvent):
            if not isinstance(key, yaml.ScalarEvent) or key.anchor is not None or key.tag is not None:
                raise self._error(key, "a key must be plain text")
            if key.value in mapping:
                raise self._error(key, f"the key '{key.value}' is written twice; keep one of them")
            mapping[key.value] = self._value(next(self._events), (*keys, key.value))
            # Users look at the line of the key, even if the value begins below.
            self.lines[(*keys, key.value)] = key.start_mark.line + 1
        return mapping

    def _refuse_rest(self, event: Any, text: str) -> None:
        """Refuse the rest of an expression: in braces and brackets, a comma ends a value."""
        if text.count(")") > text.count("("):
            raise self._error(
                event, f"the comma before '{text}' ends a value; quote the expression, as in s: 'atan2(h, a)'"
            )

    def _error(self, event: Any, problem: str) -> GtauError:
        return GtauError(f"{self.path}, line {event.start_mark.line + 1}: {problem}.")


def _as_written(data: Any) -> Any:
    if isinstance(data, Mapping):
        return {str(key): _as_written(value) for key, value in data.items()}
    return str(data) if isinstance(data, (int, np.integer)) and not isinstance(data, bool) else data


def read_yaml(path: str | Path) -> Document:
    """Read a YAML file whose root is a mapping, UTF-8 and at most 1 MiB.

    Every scalar is text as written, never ``None``. Raises GtauError if the file is unreadable or invalid, or contains
    several documents, aliases, tags, repeated keys, keys that are not text, empty values, or more than 64 levels.
    """
    path = Path(path)
    with system_refusals(path, "check the path and its permissions"), path.open("rb") as file:
        content = file.read(MAX_BYTES + 1)
    if len(content) > MAX_BYTES:
        raise GtauError(f"{path} is larger than 1 MiB; a file of this kind is a few kilobytes, so check the path.")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise GtauError(f"{path}, line {line}: the text is not UTF-8; save the file in that encoding.") from None
    return Document(path, text)


def own_table(beside: str, name: str) -> Any:
    """Read a YAML file of gtau that stands beside a module's file; unlike in files of users, numbers become numbers."""
    return yaml.load(Path(beside).with_name(name).read_bytes(), getattr(yaml, "CSafeLoader", yaml.SafeLoader))


SYNTAX = (
    ("that cannot start any token", "a tab or a special character begins it; indent with spaces, or quote a value"),
    ("mapping values are not allowed", "a key stands deeper than the one above, or a value has ':'; align or quote it"),
    ("could not find expected ':'", "a line has no 'key: value'; add the colon, or indent it as the lines above"),
    ("expected ',' or", "a bracket or brace is not closed, or a comma is missing; add it"),
    ("expected <block end>", "the line is not indented as the lines above; align them"),
    ("scanning a quoted scalar", "a quotation mark is not closed; add it"),
    ("found unexpected end of stream", "a bracket, brace or quotation mark is not closed; add it"),
    ("expected the node content", "a value is missing or misplaced; correct the line"),
    ("control characters are not allowed", "it holds control characters; save it as plain text"),
)
"""Parts of PyYAML's messages, and their meaning for users."""


class _Dumper(yaml.SafeDumper):
    """Safe YAML dumper that writes joints called ``11`` without quotes, as by hand."""


def _text(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    kind = "int" if re.fullmatch("0|[1-9][0-9]*", text) else "str"
    return dumper.represent_scalar(f"tag:yaml.org,2002:{kind}", text)


_Dumper.add_representer(str, _text)
_Dumper.add_multi_representer(str, _text)  # parameters


def yaml_text(data: Any, flow: bool | None = None, width: float = 120) -> str:
    """Write nested dicts and lists as YAML, keys in their order, in lines of at most ``width`` characters.

    With ``flow`` all groups are in braces and brackets; if omitted, only the innermost ones.
    """
    options: dict[str, Any] = {"default_flow_style": flow, "sort_keys": False, "width": width, "allow_unicode": True}
    return str(yaml.dump(data, Dumper=_Dumper, **options))


XML_BYTES = 1 << 24
XML_DEPTH = 200
PREFIX = re.compile(rb"(</?|\s)(?!xmlns:)([A-Za-z_][\w.-]*):(?=[\w.-]+(?:[\s/>]|\s*=\s*[\"']))")
"""Prefix of an element or attribute. Files for simulators use undeclared prefixes, which no reader needs."""


def read_xml(path: Path) -> Element:
    """Read the root element of an XML file."""
    from defusedxml import DefusedXmlException

    larger = "the file is larger than 16 MiB; a robot is text without meshes, so check the path."
    content = read_at_most(XML_BYTES, path, larger)
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
    for _ in range(XML_DEPTH):
        level = list(chain(*level))
    if level:
        raise GtauError(f"elements are nested more than {XML_DEPTH} levels deep; check the file.")
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
