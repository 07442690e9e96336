"""What other distributions add by entry points: exports, log formats, robots and estimators.

Built-in ones are found the same way: a module of their package names them in a constant. Nothing is listed twice.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from pkgutil import iter_modules
from typing import Any

from gtau.errors import GtauError


@cache
def homes(group: str, package: str) -> Mapping[str, str]:
    """Find the modules of the built-in objects of a ``group`` by name, in the sources of a ``package``.

    A module names its objects in a constant called as the end of the group: ``EXPORTS = {"c": Export(...)}``. Nothing
    is imported before it is asked for.
    """
    modules: dict[str, str] = {}
    for module in iter_modules(import_module(package).__path__, f"{package}."):
        source: Any = module.module_finder.find_spec(module.name, None)
        for node in ast.parse(source.loader.get_source(module.name)).body:
            if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == _constant(group):
                modules |= dict.fromkeys(map(ast.literal_eval, getattr(node.value, "keys", ())), module.name)
    return modules


def names(group: str, package: str) -> list[str]:
    """List the names of all objects, built in or not."""
    return sorted({*homes(group, package), *registered(group)})


def find(group: str, package: str, name: str, kind: Any) -> Any:
    """Load the object of a name, None where there is none; raises GtauError as :func:`added`."""
    if name not in homes(group, package):
        return added(group, name, kind)
    return getattr(import_module(homes(group, package)[name]), _constant(group))[name]


def _constant(group: str) -> str:
    return group.rpartition(".")[2].upper()


@cache
def registered(group: str) -> Mapping[str, EntryPoint]:
    """Find the entry points of a group by name; nothing is imported."""
    return {point.name: point for point in entry_points(group=group)}


def added(group: str, name: str, kind: Any) -> Any:
    """Load what another distribution registers under a name, None where none does; raises GtauError.

    It is of the type ``kind``.
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
