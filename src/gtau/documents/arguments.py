"""Check the argument types of public functions; refuse a wrong type in one sentence."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from inspect import signature
from numbers import Integral, Real
from pathlib import Path
from typing import ParamSpec, TypeVar

from gtau.errors import GtauError

P = ParamSpec("P")
R = TypeVar("R")
Accepted = tuple[str, tuple[type, ...]]
"""What to give in words, and its types."""

PATH: Accepted = ("a path", (str, Path))
TEXT: Accepted = ("a text", (str,))
NUMBER: Accepted = ("a number", (Real,))
WHOLE: Accepted = ("a whole number", (Integral,))
NAMES: Accepted = ("a list of names", (Sequence,))
TRUTH: Accepted = ("True or False", (bool,))
MAPPING: Accepted = ("a mapping such as a dict", (Mapping,))
FUNCTION: Accepted = ("a function", (Callable,))  # type: ignore[assignment]


def takes(**accepted: Accepted) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Check the types of a function's arguments before it runs; defaults are always accepted.

    The function raises GtauError where an argument has another type.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        parameters = signature(function)

        @wraps(function)
        def checked(*args: P.args, **kwargs: P.kwargs) -> R:
            for name, value in parameters.bind(*args, **kwargs).arguments.items():
                if name in accepted and value is not parameters.parameters[name].default:
                    expect(f"'{name}'", value, accepted[name])
            return function(*args, **kwargs)

        return checked

    return decorate


def expect(what: str, value: object, accepted: Accepted) -> None:
    """Refuse a value of another type than those accepted; raises GtauError."""
    words, types = accepted
    if not isinstance(value, types) or (isinstance(value, bool) and bool not in types):
        raise GtauError(f"{what} cannot be of type {type(value).__name__}; give {words}.")
