"""BLAS in one thread."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

Parameters = ParamSpec("Parameters")
Returned = TypeVar("Returned")


def single_threaded_blas(function: Callable[Parameters, Returned]) -> Callable[Parameters, Returned]:
    """Run a function with one BLAS thread: on matrices as small as here, threads only wait for each other.

    As ``threadpool_limits.wrap``, which has no types: type checkers take what it decorates for Any.
    """

    @wraps(function)
    def limited(*args: Parameters.args, **kwargs: Parameters.kwargs) -> Returned:
        with threadpool_limits(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited
