"""Validate user input: files against pydantic models, and argument types of public functions; one-sentence errors."""

from __future__ import annotations

import types
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import wraps
from inspect import signature
from numbers import Integral, Real
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Annotated, Any, ParamSpec, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from gtau.documents.markup import Document, KeyPath
from gtau.errors import GtauError, meant

if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass as Group
    from pydantic_core import ErrorDetails
else:

    class Group(type(BaseModel)):
        """Refuse values given in Python in the sentences of files."""

        def __call__(cls, *args: Any, **values: Any) -> Any:
            """Make an instance of named values; raises GtauError."""
            if args:
                keys = ", ".join(f"{key}=..." for key in cls.model_fields)
                raise GtauError(f"the values of a {cls.__name__} are named; write {cls.__name__}({keys}).")
            try:
                return super().__call__(**values)
            except ValidationError:
                return validate(cls, Document(cls.__name__, values))


Model = TypeVar("Model", bound=BaseModel)
P = ParamSpec("P")
R = TypeVar("R")
LONGEST_NAME = 100  # characters: longer ones fit no table, and with a suffix no file name
LARGEST = 1e30  # largest number and inverse of a number: products of larger ones overflow, and no robot has them


def _sized(number: float) -> float:
    if number and not 1 / LARGEST < abs(number) < LARGEST:
        raise ValueError(f"{number:g} is out of range; write a size between {1 / LARGEST:g} and {LARGEST:g}")
    return number


Number = Annotated[FiniteFloat, AfterValidator(_sized)]
Positive = Annotated[Number, Field(gt=0)]


def text_or_group(value: Any) -> str:
    """Return the tag, for pydantic, of a text or a group."""
    return "text" if isinstance(value, str) else "group"


class Keys(BaseModel, metaclass=Group):
    """A group of a file; unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    def __repr_args__(self) -> Iterator[tuple[str | None, Any]]:
        """List the fields that differ from their defaults."""
        given = (name for name in type(self).model_fields if name in self.model_fields_set)
        yield from ((name, getattr(self, name)) for name in given)


def validate(model_class: type[Model], document: Document, context: Any = None) -> Model:
    """Check a document against a pydantic model (configured with ``extra="forbid"``), and return an instance of it.

    Validators may raise ValueError with the correct form as text, without a full stop, and get the ``context`` as
    ``info.context``. Raises GtauError with one sentence on the first error, unknown keys first, with file, line and
    dotted key.
    """
    try:
        return model_class.model_validate(document.data, context=context)
    except ValidationError as failure:
        errors = failure.errors()
    # A misspelt key also leaves the right one missing: report the spelling.
    error = min(errors, key=lambda error: error["type"] != "extra_forbidden")
    location, keys = error["loc"], _written(error["loc"], document.data)
    match error["type"], location[-1] if location else "":
        case "extra_forbidden", key:
            choices = _fields(model_class, keys[:-1])
            problem = unknown(f"key '{key}'", str(key), choices)
        case "missing", int(position):  # of a tuple that is too short
            places = [missing["loc"] for missing in errors if missing["loc"][:-1] == location[:-1]]
            problem = _count(position, f"{1 + max(int(place[-1]) for place in places)}")
        case "missing", _:
            keys, problem = _missing(location, errors, document.data)
        case _:
            choices = _fields(model_class, keys) if error["type"] == "model_type" else set()
            problem = _sentence(error) + f"; its keys are {', '.join(sorted(choices))}" * bool(choices)
    raise document.error(keys, problem)


def read_group(model_class: type[Model], name: str, value: Any) -> Model:
    """Return an instance, or validate a mapping like a file called ``name``; raises GtauError."""
    return value if isinstance(value, model_class) else validate(model_class, Document(name, value))


def name_problem(name: str) -> str | None:
    """Explain why a name cannot appear in tables, files and generated code, or return None."""
    if len(name) > LONGEST_NAME:
        return f"the name {name[:20]!r}... has {len(name)} characters; write {LONGEST_NAME} at most"
    for character in name:
        if not character.isprintable():
            return f"the name {name!r} holds U+{ord(character):04X}, a non-printing character; remove it"
    return None


def unknown(what: str, name: str, choices: typing.Iterable[str]) -> str:
    """Report that `what` is unknown, with the closest of `choices` to `name`, or with all of them."""
    choices = sorted(choices)
    cutoff = 0.5 if len(name) <= 2 else 0.52  # one letter of two is close
    return f"unknown {what}; " + meant(name, choices, f"choose from {', '.join(choices)}", cutoff)


def _written(location: KeyPath, data: Any) -> KeyPath:
    """Drop union members and missing keys, which are not in the file, from pydantic's location."""
    keys: list[str | int] = []
    for key in location:
        inside = range(len(data)) if isinstance(data, list) else data if isinstance(data, dict) else ()
        if key in inside:
            keys.append(key)
            data = data[key]
    return tuple(keys)


def _missing(location: KeyPath, errors: Sequence[ErrorDetails], data: Any) -> tuple[KeyPath, str]:
    """Say which keys are missing: all those in groups that have one form; return the group that holds them, too."""
    places = dict.fromkeys(error["loc"] for error in errors if error["type"] == "missing")
    certain = [place for place in places if _written(place[:-1], data) == place[:-1] and isinstance(place[-1], str)]
    if location not in certain:
        return _written(location[:-1], data), f"the key '{location[-1]}' is missing; add it"
    group = location[:-1] if len({place[:-1] for place in certain}) == 1 else ()
    names = [f"'{'.'.join(map(str, place[len(group) :]))}'" for place in certain]
    several = f"s {', '.join(names[:-1])} and {names[-1]} are missing; add them"
    return group, f"the key{several}" if names[1:] else f"the key {names[0]} is missing; add it"


def _fields(annotation: Any, keys: KeyPath) -> set[str]:
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
        return _fields(fields.get(str(keys[0])), keys[1:])
    if not keys or not arguments:
        return set()
    # values of a dict, or items of a list or tuple
    in_tuple = origin is tuple and isinstance(keys[0], int) and keys[0] < len(arguments)
    item = arguments[int(keys[0]) if in_tuple else -1]
    return _fields(arguments[0] if item is Ellipsis else item, keys[1:])


BOUNDS = {
    "greater_than": ("above", "gt"),
    "less_than": ("below", "lt"),
    "greater_than_equal": ("of at least", "ge"),
    "less_than_equal": ("of at most", "le"),
}
KINDS: dict[type, str] = {type(None): "null", list: "a list", dict: "a group of keys"}


def _sentence(error: ErrorDetails) -> str:
    value, context = error["input"], error.get("ctx", {})
    written = next((words for kind, words in KINDS.items() if isinstance(value, kind)), f"'{shorten(str(value), 60)}'")
    match error["type"]:
        case "value_error":
            return str(context["error"])
        case "float_parsing" | "float_type" | "finite_number":
            return f"{written} is not a number; write one such as 0.1"
        case "int_parsing" | "int_type" | "int_from_float":
            return f"{written} is not a whole number; write one such as 3"
        case "bool_parsing" | "bool_type":
            return f"write true or false, not {written}"
        case "string_type":
            return f"write a single value, not {written}"
        case "dict_type" | "model_type" | "model_attributes_type" | "dataclass_type":
            return f"write 'key: value' lines under it, not {written}"
        case "list_type" | "tuple_type":
            return f"write a list such as [..., ...], not {written}"
        case "literal_error" | "enum":
            return f"write {shorten(context['expected'], 200, placeholder=' ...')}, not {written}"
        case "too_short" | "too_long":
            bound = context.get("min_length", context.get("max_length"))
            most = "at least " if "min_length" in context else "at most "
            most = "" if context["field_type"] == "Tuple" else most
            return _count(context["actual_length"], f"{most}{bound}")
        case kind if kind in BOUNDS:
            words, key = BOUNDS[kind]
            return f"{value} is out of range; write a number {words} {context[key]:g}"
        case _:
            return f"{written} does not fit: {error['msg'][0].lower()}{error['msg'][1:]}"


def _count(written: int, needed: str) -> str:
    return f"{written} value{'s are' if written != 1 else ' is'} written; write {needed}"


Accepted = tuple[str, tuple[type, ...]]  # a description, and its types
PATH: Accepted = ("a path", (str, Path))
TEXT: Accepted = ("a text", (str,))
NUMBER: Accepted = ("a number", (Real,))
WHOLE: Accepted = ("a whole number", (Integral,))
NAMES: Accepted = ("a list of names", (Sequence,))
TRUTH: Accepted = ("True or False", (bool,))
MAPPING: Accepted = ("a mapping such as a dict", (Mapping,))
MASSES: Accepted = ("masses in kg by log, such as {'loaded.csv': 1.2}", (Mapping,))
FUNCTION: Accepted = ("a function", (Callable,))  # type: ignore[assignment]


def takes(**accepted: Accepted) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Make a function check the types of its arguments, defaults always accepted, and raise GtauError."""

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        parameters, called = signature(function), function.__qualname__.removesuffix(".__init__")

        @wraps(function)
        def checked(*args: P.args, **kwargs: P.kwargs) -> R:
            try:
                given = parameters.bind(*args, **kwargs).arguments
            except TypeError:
                return function(*args, **kwargs)  # its own error names the argument
            for name, value in given.items():
                if name in accepted and value is not parameters.parameters[name].default:
                    expect(f"'{name}' of {called}()", value, accepted[name])
            return function(*args, **kwargs)

        return checked

    return decorate


def expect(what: str, value: object, accepted: Accepted) -> None:
    """Refuse a value of another type; raises GtauError."""
    words, types = accepted
    if not isinstance(value, types) or (isinstance(value, bool) and bool not in types):
        advice = f"give {words}."
        if "..." in words and isinstance(value, (str, Path)):
            advice = f"did you mean {words.replace('...', repr(str(value)))}?"
        raise GtauError(f"{what} cannot be of type {type(value).__name__}; {advice}")


def some_of(texts: Sequence[str], most: int, between: str = ", ") -> str:
    """List texts in a sentence, the first ``most`` of many."""
    return between.join(texts[:most]) + (f" and {len(texts) - most} more" if len(texts) > most else "")
