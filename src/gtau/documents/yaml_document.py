"""YAML files that people write: read safely, with the line of every key, and checked against a pydantic model.

Nothing in a file is ever executed or guessed: scalars stay the text they were written as (a joint may be called
``11``, ``01`` or ``on``), and anchors, tags and repeated keys are refused.
"""

from __future__ import annotations

import types
import typing
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import yaml

from gtau.errors import GtauError

if TYPE_CHECKING:
    from pydantic import BaseModel
    from pydantic_core import ErrorDetails

    Model = TypeVar("Model", bound=BaseModel)

MAX_BYTES = 1 << 20
MAX_DEPTH = 64

KeyPath = tuple[str | int, ...]
"""The way to a value: keys of mappings and positions (from 0) in lists."""


@dataclass(frozen=True)
class Document:
    """What stands in a file: nested dicts and lists of texts, and the line of every value."""

    path: Path
    data: dict[str, Any]
    lines: Mapping[KeyPath, int]

    def line(self, keys: KeyPath) -> int | None:
        """Find the line (from 1) of the value at `keys`, or of the nearest value around it that is written."""
        while keys and keys not in self.lines:
            keys = keys[:-1]
        return self.lines.get(keys) if keys else None

    def error(self, keys: KeyPath, problem: str) -> GtauError:
        """Make an error that names the file, the line and the dotted key; `problem` says what to write instead."""
        place = [str(self.path)]
        if (line := self.line(keys)) is not None:
            place.append(f"line {line}")
        if keys:
            place.append(".".join(str(key + 1) if isinstance(key, int) else key for key in keys))
        return GtauError(f"{', '.join(place)}: {problem}{'' if problem.endswith('?') else '.'}")


def read_yaml(path: str | Path) -> Document:
    """Read a YAML file whose root is a mapping.

    Parameters
    ----------
    path : str or Path
        A UTF-8 file of at most 1 MiB.

    Returns
    -------
    Document
        Every scalar is text as written; values without text are refused, so there is no ``None``.

    Raises
    ------
    GtauError
        The file cannot be read, is no valid YAML, or holds what gtau does not read: several documents, aliases,
        tags, repeated keys, keys that are not text, empty values, or more than 64 levels.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise GtauError(f"{path} cannot be read: {reason}; check the path and its permissions.") from None
    if len(content) > MAX_BYTES:
        raise GtauError(f"{path} is larger than 1 MiB; a file of this kind is a few kilobytes, so check the path.")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise GtauError(f"{path}, line {line}: the text is not UTF-8; save the file in that encoding.") from None
    return parse_yaml(text, path)


def parse_yaml(text: str, path: str | Path) -> Document:
    """Read YAML from a text; as :func:`read_yaml`, with ``path`` for the messages."""
    return _Composer(Path(path), text).document()


class _Composer:
    """Builds a document from the events of PyYAML's parser, which resolves no tags and constructs no objects."""

    def __init__(self, path: Path, text: str) -> None:
        self.path = path
        self.events: Iterator[Any] = yaml.parse(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
        self.lines: dict[KeyPath, int] = {}

    def document(self) -> Document:
        try:
            next(self.events)  # stream start
            if isinstance(next(self.events), yaml.StreamEndEvent):
                raise GtauError(f"{self.path} is empty; write 'key: value' lines.")
            root = next(self.events)
            if not isinstance(root, yaml.MappingStartEvent):
                raise self.error(root, "the file must consist of 'key: value' lines")
            data = self.value(root, ())
            next(self.events)  # document end
            after = next(self.events)
            if not isinstance(after, yaml.StreamEndEvent):
                raise self.error(after, "a second document begins here; keep one document in a file")
        except yaml.MarkedYAMLError as error:
            mark = error.problem_mark or error.context_mark
            line = f", line {mark.line + 1}" if mark else ""
            raise GtauError(f"{self.path}{line}: this is not valid YAML: {_syntax(error)}.") from None
        except yaml.YAMLError:
            raise GtauError(f"{self.path} holds control characters; save it as plain text.") from None
        return Document(self.path, data, self.lines)

    def value(self, event: Any, keys: KeyPath) -> Any:
        self.lines[keys] = event.start_mark.line + 1
        if isinstance(event, yaml.AliasEvent) or event.anchor is not None:
            raise self.error(event, "anchors (&) and aliases (*) are not read; write the value out")
        if event.tag is not None:
            raise self.error(event, f"the tag '{event.tag}' is not read; write the value without it")
        if len(keys) > MAX_DEPTH:
            raise self.error(event, f"values are nested more than {MAX_DEPTH} levels deep; write them flatter")
        if isinstance(event, yaml.ScalarEvent):
            if event.implicit[0] and not event.value:
                key = keys[-1] if isinstance(keys[-1], str) else "-"
                self.refuse_rest(event, key)
                raise self.error(event, f"nothing is written after '{key}'; write a value or remove the line")
            return event.value
        if isinstance(event, yaml.SequenceStartEvent):
            items: list[Any] = []
            while not isinstance(item := next(self.events), yaml.SequenceEndEvent):
                if event.flow_style and items and isinstance(item, yaml.ScalarEvent) and item.implicit[0]:
                    self.refuse_rest(item, item.value)
                items.append(self.value(item, (*keys, len(items))))
            return items
        mapping: dict[str, Any] = {}
        while not isinstance(key := next(self.events), yaml.MappingEndEvent):
            if not isinstance(key, yaml.ScalarEvent) or key.anchor is not None or key.tag is not None:
                raise self.error(key, "a key must be plain text")
            if key.value in mapping:
                raise self.error(key, f"the key '{key.value}' is written twice; keep one of them")
            mapping[key.value] = self.value(next(self.events), (*keys, key.value))
            # The key's line is where a person looks, also when its value begins below it.
            self.lines[(*keys, key.value)] = key.start_mark.line + 1
        return mapping

    def refuse_rest(self, event: Any, text: str) -> None:
        """Refuse the end of an expression: in braces and brackets, a comma ends a value."""
        if text.count(")") > text.count("("):
            raise self.error(
                event, f"the comma before '{text}' ends a value; quote the expression, as in s: 'atan2(h, a)'"
            )

    def error(self, event: Any, problem: str) -> GtauError:
        return GtauError(f"{self.path}, line {event.start_mark.line + 1}: {problem}.")


SYNTAX = (
    ("found character '\\t'", "a tab stands where only spaces may; indent with spaces"),
    ("that cannot start any token", "a value that begins with a special character must be quoted; write it in '...'"),
    ("mapping values are not allowed", "a ':' follows a value; put the key on a line of its own, or quote the value"),
    ("could not find expected ':'", "a line has no 'key: value'; add the colon, or indent it as the lines above"),
    ("expected ',' or", "a bracket or brace is not closed, or a comma is missing; add it"),
    ("expected <block end>", "the indentation does not match that of the lines above; align them"),
    ("scanning a quoted scalar", "a quotation mark is not closed; add it"),
    ("found unexpected end of stream", "a bracket, brace or quotation mark is not closed; add it"),
    ("expected the node content", "a value is missing or misplaced; correct the line"),
    ("control characters are not allowed", "it holds control characters; save it as plain text"),
)
"""What PyYAML reports, and the same for people who have not read its source."""


def _syntax(error: yaml.MarkedYAMLError) -> str:
    reported = " ".join(filter(None, (error.context, error.problem)))
    known = (sentence for part, sentence in SYNTAX if part in reported)
    return next(known, f"{reported}; correct the line")


def validate(model_class: type[Model], document: Document, context: Any = None) -> Model:
    """Check a document against a pydantic model (configured with ``extra="forbid"``).

    Parameters
    ----------
    model_class : type of pydantic.BaseModel
        Its validators may raise ValueError with a text that says what to write instead, without a full stop.
    document : Document
        What `read_yaml` returned.
    context : object, optional
        Handed to the model's validators as ``info.context``.

    Returns
    -------
    model
        An instance of `model_class`.

    Raises
    ------
    GtauError
        One sentence on the first thing wrong, unknown keys before all else, with file, line and dotted key.
    """
    from pydantic import ValidationError

    try:
        return model_class.model_validate(document.data, context=context)
    except ValidationError as failure:
        errors = failure.errors()
    # A misspelt key also leaves the right one missing: the spelling is the thing to say.
    error = min(errors, key=lambda error: error["type"] != "extra_forbidden")
    keys = _written(error["loc"], document.data)
    if error["type"] == "extra_forbidden":
        raise document.error(keys, unknown(f"key '{keys[-1]}'", str(keys[-1]), _fields(model_class, keys[:-1])))
    if error["type"] == "missing" and isinstance(error["loc"][-1], int):
        needed = 1 + max(int(other["loc"][-1]) for other in errors if other["loc"][:-1] == error["loc"][:-1])
        raise document.error(keys, _count(error["loc"][-1], f"{needed}"))
    if error["type"] == "missing":
        raise document.error(keys, f"the key '{error['loc'][-1]}' is missing; add it")
    raise document.error(keys, _sentence(error))


def unknown(what: str, name: str, choices: typing.Iterable[str]) -> str:
    """Say that `what` is unknown, with the closest of `choices` to `name`, or with all of them."""
    choices = sorted(choices)
    close = get_close_matches(name, choices, n=1, cutoff=0.5 if len(name) <= 2 else 0.52)  # one letter of two is close
    return f"unknown {what}; " + (f"did you mean '{close[0]}'?" if close else f"choose from {', '.join(choices)}")


def _written(location: KeyPath, data: Any) -> KeyPath:
    """Drop from pydantic's location what is not in the file: names of union members and of missing keys."""
    keys: list[str | int] = []
    for key in location:
        if key in (data if isinstance(data, dict) else range(len(data)) if isinstance(data, list) else ()):
            keys.append(key)
            data = data[key]
    return tuple(keys)


def _fields(annotation: Any, keys: KeyPath) -> set[str]:
    """List the keys that the model accepts at a place."""
    from pydantic import BaseModel

    if hasattr(annotation, "__value__"):  # a `type` alias
        annotation = annotation.__value__
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Annotated:
        return _fields(arguments[0], keys)
    if origin in (typing.Union, types.UnionType):
        return set().union(*(_fields(member, keys) for member in arguments))
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        fields = {field.alias or name: field.annotation for name, field in annotation.model_fields.items()}
        if not keys:
            return set(fields)
        return _fields(fields[str(keys[0])], keys[1:]) if keys[0] in fields else set()
    if keys and arguments:  # dict: its values; list or tuple: its items
        index = keys[0] if origin is tuple and isinstance(keys[0], int) and keys[0] < len(arguments) else -1
        item = arguments[index] if arguments[index] is not Ellipsis else arguments[0]
        return _fields(item, keys[1:])
    return set()


def _sentence(error: ErrorDetails) -> str:
    """Say in our words what pydantic found."""
    value, context = error["input"], error.get("ctx", {})
    written = "a list" if isinstance(value, list) else "a group of keys" if isinstance(value, dict) else f"'{value}'"
    match error["type"]:
        case "value_error":
            return str(context["error"])
        case "float_parsing" | "float_type" | "finite_number" | "int_parsing" | "int_type" | "int_from_float":
            return f"{written} is not a number; write one such as 0.1"
        case "bool_parsing" | "bool_type":
            return f"write true or false, not {written}"
        case "string_type":
            return f"write a single value, not {written}"
        case "dict_type" | "model_type" | "model_attributes_type":
            return f"write 'key: value' lines under it, not {written}"
        case "list_type" | "tuple_type":
            return f"write a list such as [..., ...], not {written}"
        case "literal_error" | "enum":
            return f"write {context['expected']}, not {written}"
        case "too_short" | "too_long":
            bound = context.get("min_length", context.get("max_length"))
            least = "" if context["field_type"] == "Tuple" else "at least " if "min_length" in context else "at most "
            return _count(context["actual_length"], f"{least}{bound}")
        case "greater_than" | "greater_than_equal" | "less_than" | "less_than_equal":
            return f"{value} is out of range; write a number {_bound(error['type'], context)}"
        case _:
            return f"{written} does not fit: {error['msg'][0].lower()}{error['msg'][1:]}"


def _bound(kind: str, context: Mapping[str, Any]) -> str:
    """Describe the range that a number must lie in, as ``of at least 2``."""
    words = {"greater_than": "above", "less_than": "below", "greater_than_equal": "of at least"}
    key = {"greater_than": "gt", "less_than": "lt", "greater_than_equal": "ge", "less_than_equal": "le"}[kind]
    return f"{words.get(kind, 'of at most')} {context[key]:g}"


def _count(written: int, needed: str) -> str:
    return f"{written} value{'s are' if written != 1 else ' is'} written; write {needed}"
