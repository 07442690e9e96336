"""The effects that every fit is held against: all modules of :mod:`gtau.estimation.effects.known`."""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules

from gtau.estimation.effects import known
from gtau.estimation.effects.effect import Effect


def _effects_of(module: str) -> tuple[Effect, ...]:
    """Return the effects of a module: its ``EFFECTS``, or its one ``EFFECT``."""
    members = vars(import_module(f"{known.__name__}.{module}"))
    return tuple(members["EFFECTS"]) if "EFFECTS" in members else (members["EFFECT"],)


EFFECTS = tuple(effect for module in iter_modules(known.__path__) for effect in _effects_of(module.name))
