"""Numba decorators of the compiled functions."""

from collections.abc import Callable
from functools import partial
from typing import Any

from numba import cfunc, njit

from gtau.model.interpreter.edition import EDITION


def compiled(function: Callable[..., Any]) -> Any:
    """Compile a function and cache it on disk, once for all robots."""
    return _cached(partial(njit, nogil=True, error_model="numpy"), _of_this_edition(function))


def compiled_once(signature: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function of this signature that others call by address instead of inlining it."""
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
