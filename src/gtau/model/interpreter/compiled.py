"""Numba decorators of the compiled functions."""

from collections.abc import Callable
from typing import Any

from numba import cfunc, njit

from gtau.model.interpreter.edition import EDITION


def compiled(function: Callable[..., Any]) -> Any:
    """Compile a function and cache it on disk, once for all robots."""
    return njit(cache=True, nogil=True, error_model="numpy")(_of_this_edition(function))


def compiled_once(signature: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function of this signature that others call by address instead of inlining it."""
    return lambda function: cfunc(signature, cache=True)(_of_this_edition(function))


def _of_this_edition(function: Callable[..., Any]) -> Callable[..., Any]:
    """Name the function after the edition, and so its file on disk.

    Numba looks for changes in the function's own file alone, though it compiles in what is called of others.
    """
    function.__qualname__ += f"_{EDITION}"
    return function
