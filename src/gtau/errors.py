"""User-facing errors, which also derive from built-in ones where scripts expect these."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from typing import Any, TypeVar
from unicodedata import category

Class = TypeVar("Class", bound=type)

LONGEST = 60  # characters of a value of a file in a sentence
SENTENCE = 3000  # characters of a sentence: 40 columns of that length
WORD = re.compile(r"[^\s/]{121,}")  # longer than a name may be
VALUE = re.compile(rf"(?<!\w)'(?!gtau )(\S[^']{{{LONGEST},}})(?<=\S)'(?!\w)")


def printable(text: str) -> str:
    """Write what does not print, such as line breaks and what a terminal obeys, as Python does."""
    return "".join(c if c.isprintable() or category(c) == "Zs" else repr(c)[1:-1] for c in text)


def short(value: object, longest: int = LONGEST) -> str:
    """Write a value of a file so that it fits a sentence; of a path the end says which file it is."""
    text = str(value)
    if len(text) > longest and "/" in text[-longest:]:
        return f"{printable(text[: longest // 3])}...{printable(text[3 + longest // 3 - longest :])}"
    text = printable(text[: longest + 1])
    return text if len(text) <= longest else f"{text[: longest - 3]}..."


def quoted(value: object) -> str:
    """Quote a value of a file so that it fits a sentence."""
    return f"'{short(value)}'"


def meant(name: str, choices: Iterable[str], otherwise: str = "", cutoff: float = 0.6) -> str:
    """Ask whether the closest of some choices was meant; ``otherwise`` where none is close."""
    close = get_close_matches(name, [*choices], n=1, cutoff=cutoff)
    return f"did you mean '{close[0]}'?" if close else otherwise


def tidy(sentence: str) -> str:
    """Make a sentence printable, and shorten the values that it quotes, and endless words."""
    sentence = VALUE.sub(lambda value: quoted(value[1]), sentence)
    return short(WORD.sub(lambda word: short(word[0]), sentence), SENTENCE)


class GtauError(ValueError):
    """Error raised for input that gtau cannot use.

    The message is one sentence for a person: what is wrong, where (file, key, joint, time), and
    what to do about it. It begins with the ``source``, a file, where that is given.
    """

    def __init__(self, sentence: str, source: object = "") -> None:
        self.sentence, self.source = tidy(sentence), printable(str(source))
        super().__init__(f"{self.source}: {self.sentence}" if self.source else self.sentence)

    __str__ = BaseException.__str__  # a KeyError shows its message in quotes


@contextmanager
def errors_at(place: object) -> Iterator[None]:
    """Begin the sentences of errors with the place, such as a file, that they are about."""
    try:
        yield
    except GtauError as error:
        raise type(error)(f"{place}: {error}") from None


class UnknownName(GtauError, KeyError):
    """Error raised for a name (of a joint, a parameter) that is not among those there are."""


class OtherSpelling(GtauError, AttributeError):
    """Error raised for an attribute that has another name here."""


def spelled(**calls: str) -> Callable[[Class], Class]:
    """Let a class answer attributes that it lacks by the calls that do the same: ``plot="gtau.plot(robot)"``."""

    def decorate(owner: Class) -> Class:
        def refuse(self: Any, name: str) -> Any:
            names = () if name in dir(self) or name.startswith("_") else dir(self)  # the error of a property is its own
            hint = f"did you mean {calls[name]}?" if name in calls else meant(name, names, cutoff=0.75)
            if hint:
                kind = f"{'an' if owner.__name__[0] in 'AEIOU' else 'a'} {owner.__name__}"
                raise OtherSpelling(f"{kind} has no '{name}'; {hint}")
            return object.__getattribute__(self, name)  # for its own error

        owner.__getattr__ = refuse  # type: ignore[attr-defined]
        return owner

    return decorate


class NoFile(GtauError, FileNotFoundError):
    """Error raised for a file that does not exist."""

    __new__ = FileNotFoundError.__new__  # type: ignore[assignment]  # the layout's, which tblib (Dask) calls by name


def unreadable(sentence: str, error: OSError) -> GtauError:
    """Make the error for what the system refuses to read."""
    return (NoFile if isinstance(error, FileNotFoundError) else GtauError)(sentence)


def missing_extra(purpose: str, package: str, extra: str) -> GtauError:
    """Make the error for a ``package`` that is not installed, with the commands that install it as an ``extra``."""
    return GtauError(
        f"{purpose} needs the package {package}, which is not installed; install it with: "
        f"pip install 'gtau[{extra}]' (in a clone: pip install '.[{extra}]')."
    )


@contextmanager
def needing(purpose: str, package: str, extra: str) -> Iterator[None]:
    """Refuse what needs a ``package`` that cannot be imported here, see :func:`missing_extra`."""
    try:
        yield
    except ImportError:
        raise missing_extra(purpose, package, extra) from None
