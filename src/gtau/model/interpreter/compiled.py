"""Numba decorators of the compiled functions, and the edition of these.

The edition is part of the functions' names in the cache of Numba, new with every change of source.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

_HERE = Path(__file__).parent
EDITION = sha256(b"".join(path.read_bytes() for path in sorted(_HERE.glob("*.py")))).hexdigest()[:12]


def is_compiled() -> bool:
    """Return whether this edition's interpreter has been compiled on this machine before; imports nothing heavy."""
    pattern = f"*.interpret_{EDITION}-*.nbi"  # the last function that is compiled
    elsewhere = os.environ.get("NUMBA_CACHE_DIR")
    try:
        if elsewhere:
            return any(Path(elsewhere).rglob(pattern))
        return any((_HERE / "__pycache__").glob(pattern)) or any(_own_cache().rglob(pattern))
    except (OSError, RuntimeError):  # the home is another user's, or there is none
        return False


def _own_cache() -> Path:
    """Return where Numba caches for a package in a folder that this user cannot write to."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "numba"


def compiled(function: Callable[..., Any]) -> Any:
    """Compile a function and cache it on disk, once for all robots."""
    from numba import njit

    return _cached(partial(njit, nogil=True, error_model="numpy"), _of_this_edition(function))


def compiled_once(signature: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function of this signature that others call by address instead of inlining it."""
    from numba import cfunc

    return lambda function: _cached(partial(cfunc, signature), _of_this_edition(function))


def _cached(decorator: Callable[..., Any], function: Callable[..., Any]) -> Any:
    """Decorate a function with the cache on disk, or without it where no folder for one can be written to."""
    try:
        return decorator(cache=True)(function)
    except RuntimeError as error:
        if "cannot cache" not in str(error):
            raise
        return decorator(cache=False)(function)


def _of_this_edition(function: Callable[..., Any]) -> Callable[..., Any]:
    """Name the function after the edition, and so its file on disk.

    Numba looks for changes in the function's own file alone, though it compiles in what is called of others.
    """
    function.__qualname__ += f"_{EDITION}"
    return function
