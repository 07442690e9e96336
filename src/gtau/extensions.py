"""What other distributions add by entry points: exports, log formats, robots and estimators.

The built-in ones are found alike: a module of their package names them in a constant. Nothing is listed twice.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from pkgutil import iter_modules
from typing import Any, Generic, TypeVar

from gtau.errors import GtauError

T = TypeVar("T")


@dataclass(frozen=True)
class Extensions(Generic[T]):
    """Objects of one type by name: the built-in ones, and those of other distributions.

    Attributes
    ----------
    group : str
        Of the entry points, ``gtau.exports``; their names are the names of the objects.
    package : str
        Its modules may have a constant, called as the end of the group (``EXPORTS``): a mapping of names to objects.
    type : type
        Of the objects.
    """

    group: str
    package: str
    type: type[T]

    @cached_property
    def built_in(self) -> Mapping[str, T]:
        """The built-in objects, in the order of their modules."""
        constant = self.group.rpartition(".")[2].upper()
        names = (module.name for module in iter_modules(import_module(self.package).__path__))
        modules = [import_module(f"{self.package}.{name}") for name in names]
        return {name: value for module in modules for name, value in getattr(module, constant, {}).items()}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all objects; those of other distributions have not been loaded."""
        return tuple(dict.fromkeys((*self.built_in, *registered(self.group))))

    def find(self, name: str) -> T | None:
        """Return the object of a name, loaded now where it is not built in; None where there is none.

        Raises
        ------
        GtauError
            Where it cannot be loaded, or is of another type.
        """
        if name in self.built_in or (point := registered(self.group).get(name)) is None:
            return self.built_in.get(name)
        found = load(point)
        if not isinstance(found, self.type):
            raise GtauError(f"{_called(point)} is no {self.type.__name__} but a {type(found).__name__}; mend it.")
        return found


def registered(group: str) -> dict[str, EntryPoint]:
    """Find the entry points of a group by name; nothing is imported."""
    return {point.name: point for point in entry_points(group=group)}


def load(point: EntryPoint) -> Any:
    """Import what an entry point names; raises GtauError where that fails."""
    try:
        return point.load()
    except Exception as error:  # whatever another distribution does
        raise GtauError(
            f"{_called(point)} cannot be loaded ({type(error).__name__}: {error}); mend or uninstall it."
        ) from None


def _called(point: EntryPoint) -> str:
    distribution = "" if point.dist is None else f" of the distribution {point.dist.name}"
    return f"the entry point '{point.name}' of {point.group} ({point.value}){distribution}"
