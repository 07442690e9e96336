"""The effects that every fit is held against: a module each, with its ``EFFECT`` or ``EFFECTS``."""

from importlib import import_module
from pkgutil import iter_modules

from gtau.estimation.effects.effect import Effect

_MODULES = [import_module(f"{__name__}.{module.name}") for module in iter_modules(__path__)]
EFFECTS: tuple[Effect, ...] = tuple(
    effect for module in _MODULES for effect in getattr(module, "EFFECTS", None) or [module.EFFECT]
)
