"""Share samples among threads, since the compiled loops release Python's lock; run BLAS in one."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache

from threadpoolctl import threadpool_limits

from gtau.model.interpreter.instructions import LANES

_inside = threading.local()
SHARE = 16 * LANES  # minimum number of samples per thread


def threads() -> int:
    """Return the number of threads: ``GTAU_THREADS``, or one for each core."""
    try:
        return max(int(os.environ["GTAU_THREADS"]), 1)
    except (KeyError, ValueError):
        return _cores()


_cores = cache(lambda: os.cpu_count() or 1)


def share(work: Callable[[int, int], None], samples: int, worth: int = SHARE) -> None:
    """Call ``work(start, stop)`` for stretches of whole lanes that together are ``samples``.

    In threads, where each gets at least ``worth`` samples; the results do not depend on their number. Work that
    is itself done by one of them is not shared again.
    """
    parts = 1 if hasattr(_inside, "pool") else min(threads(), samples // worth)
    if parts < 2:
        work(0, samples)
        return
    lanes = samples // LANES
    cuts = [LANES * (lanes * k // parts) for k in range(parts)] + [samples]
    list(_pool(os.getpid(), parts).map(work, cuts[:-1], cuts[1:]))


@cache
def _pool(process: int, workers: int) -> ThreadPoolExecutor:
    """Return the thread pool, created once per process; a forked process needs its own."""
    return ThreadPoolExecutor(workers, "gtau", lambda: setattr(_inside, "pool", True))


@contextmanager
def single_threaded_blas() -> Iterator[None]:
    """Run BLAS and OpenMP in one thread, as a context or a decorator.

    On small matrices and busy cores, threads mainly wait for each other (a QR takes 100 times longer).
    """
    with threadpool_limits(limits=1):
        yield
