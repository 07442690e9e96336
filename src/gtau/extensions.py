"""What other distributions add by entry points: exports, log formats, robots and estimators.

The built-in ones are found alike: a module of their package names them in a constant. Nothing is listed twice.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from pkgutil import iter_modules
from typing import Any

from gtau.errors import GtauError


@cache
def built_in(group: str, package: str) -> Mapping[str, Any]:
    """Collect the built-in objects of a ``group`` by name, in the order of the modules of their ``package``.

    A module names them in a constant called as the end of the group: ``EXPORTS = {"c": Export(...)}``.
    """
    constant = group.rpartition(".")[2].upper()
    names = (module.name for module in iter_modules(import_module(package).__path__))
    modules = [import_module(f"{package}.{name}") for name in names]
    return {name: value for module in modules for name, value in getattr(module, constant, {}).items()}


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
        value = point.load()
    except Exception as error:  # whatever another distribution does
        raise GtauError(f"{called} cannot be loaded ({type(error).__name__}: {error}); mend or uninstall it.") from None
    if not isinstance(value, kind):
        raise GtauError(f"{called} is no {kind.__name__} but of type {type(value).__name__}; mend or uninstall it.")
    return value
