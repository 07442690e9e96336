"""Late imports: results find what predicts with them, shows and writes them here, without resting on it."""

from __future__ import annotations

TYPE_CHECKING = False
if TYPE_CHECKING:
    from types import ModuleType


def late(module: str) -> ModuleType:
    """Import a module of gtau that itself rests on the caller's, when it is used."""
    from importlib import import_module

    return import_module(f"gtau.{module}")


def html(shown: object) -> str:
    """Show an object in a notebook."""
    text: str = views().html(shown)
    return text


def views() -> ModuleType:
    """Import the views: ``html`` of an object; ``text``, ``plots``, ``write`` (a report) of a result."""
    return late("report.notebook")
