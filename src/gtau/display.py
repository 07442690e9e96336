"""Registry of views: results find their report and plots here without importing them.

``gtau/__init__`` names the module that has the views; it is imported when something is first shown.
"""

from __future__ import annotations

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import ModuleType

_load: Callable[[], ModuleType] | None = None


def register(load: Callable[[], ModuleType]) -> None:
    """Register how the module with the views is loaded."""
    global _load
    _load = load


def views() -> ModuleType:
    """Load the module with the views: ``html`` of an object; ``text``, ``plots``, ``write`` (a report) of a result."""
    if _load is None:
        raise RuntimeError("no views are registered; import gtau first")
    return _load()
