"""Numba's decorators as all compiled functions here use them."""

from collections.abc import Callable
from typing import Any

from numba import cfunc, njit

from gtau.model.interpreter.edition import EDITION


def compiled(function: Callable[..., Any]) -> Any:
    """Compile a function, and keep the result on disk for all robots."""
    return njit(cache=True, nogil=True, error_model="numpy")(_of_this_edition(function))


def compiled_once(signature: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function of this signature that others call by its address, so that they need no copy of it."""
    return lambda function: cfunc(signature, cache=True)(_of_this_edition(function))


def _of_this_edition(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function, its name on disk telling the sources.

    Numba looks for changes in the function's own file alone, though it compiles in what is called of others.
    """
    function.__qualname__ += f"_{EDITION}"
    return function
