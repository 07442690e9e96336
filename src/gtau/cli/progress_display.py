"""How commands show where they stand: a bar on a terminal from the start, a line a minute elsewhere."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from gtau.model.interpreter.compiled import is_compiled

EVERY = 60.0  # s between lines where stderr is no terminal
STARTING = "starting"
COMPILING = "starting; compiling once, about 15 s"  # 14 s of one core at 3 GHz, measured without Numba's cache


@contextmanager
def progress_bar() -> Iterator[Callable[[str, int, int], None]]:
    """Show the stages that the yielded function is called with, on stderr."""
    first = STARTING if is_compiled() else COMPILING
    with _bar(first) if sys.stderr.isatty() else _lines(first, EVERY) as report:
        yield report


@contextmanager
def _bar(first: str) -> Iterator[Callable[[str, int, int], None]]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        beginning = bar.add_task(first, total=None)
        tasks: dict[str, Any] = {}

        def report(stage: str, done: int, total: int) -> None:
            bar.update(beginning, visible=False)
            if stage not in tasks:
                tasks[stage] = bar.add_task(stage, total=total)
            bar.update(tasks[stage], completed=done, total=total)

        yield report


@contextmanager
def _lines(first: str, every: float) -> Iterator[Callable[[str, int, int], None]]:
    """Print the progress once every so many seconds, also while nothing is reported."""
    begun, finished, now = time.monotonic(), threading.Event(), [first]

    def report(stage: str, done: int, total: int) -> None:
        now[0] = f"{stage}, {100 * done / max(total, 1):.0f} %"

    def speak() -> None:
        while not finished.wait(every):
            print(f"gtau: {now[0]}, {time.monotonic() - begun:.0f} s", file=sys.stderr, flush=True)

    threading.Thread(target=speak, daemon=True).start()
    try:
        yield report
    finally:
        finished.set()
