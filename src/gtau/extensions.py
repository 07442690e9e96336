"""What other distributions add by entry points: exports, log formats, robots and estimators.

The built-in ones are found alike: a module of their package names them in a constant. Nothing is listed twice.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
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
    type: Any

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
        """Return the object of a name, None where there is none; raises GtauError where it cannot be loaded."""
        return self.built_in[name] if name in self.built_in else added(self.group, name, self.type)


@cache
def registered(group: str) -> Mapping[str, EntryPoint]:
    """Find the entry points of a group by name; nothing is imported."""
    return {point.name: point for point in entry_points(group=group)}


def added(group: str, name: str, kind: Any) -> Any:
    """Load what another distribution registers under a name; None where none does.

    Raises
    ------
    GtauError
        Where it cannot be loaded, or is not of the type ``kind``.
    """
    if (point := registered(group).get(name)) is None:
        return None
    distribution = "" if point.dist is None else f" of the distribution {point.dist.name}"
    called = f"the entry point '{name}' of {group}{distribution} ({point.value})"
    try:
        found = point.load()
    except Exception as error:  # whatever another distribution does
        raise GtauError(f"{called} cannot be loaded ({type(error).__name__}: {error}); mend or uninstall it.") from None
    if not isinstance(found, kind):
        raise GtauError(f"{called} is no {kind.__name__} but of type {type(found).__name__}; mend or uninstall it.")
    return found
