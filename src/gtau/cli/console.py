"""What every command shares: refusals in one sentence, a progress bar, documents and folders."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from gtau.errors import GtauError

ExperimentFile = Annotated[Path, typer.Argument(metavar="EXPERIMENT.yaml", help="Experiment file.", show_default=False)]
ModelFile = Annotated[
    Path, typer.Argument(metavar="MODEL.json", help="What 'gtau identify' wrote.", show_default=False)
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document on stdout instead of tables.")]

Dask = Annotated[
    str | None,
    typer.Option(
        "--dask", metavar="ADDRESS", help="Work on the workers of a Dask scheduler (tcp://host:8786), or 'local'."
    ),
]


@contextmanager
def refusals(as_json: bool) -> Iterator[None]:
    """Turn what gtau refuses into one sentence on stderr, ``as_json`` also a document on stdout, and exit code 2."""
    try:
        yield
    except GtauError as error:
        raise refused(str(error), as_json) from None
    except KeyboardInterrupt as interruption:
        finished = str(interruption) or "files that were not finished have not been written"
        raise refused(f"interrupted; {finished}.", as_json, 130) from None
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise typer.Exit(0) from None


def refused(sentence: str, as_json: bool, code: int = 2) -> typer.Exit:
    """Say why nothing comes of it; the exit to raise."""
    typer.echo(f"gtau: {sentence}", err=True)
    if as_json:
        print_json({"error": sentence})
    return typer.Exit(code)


@contextmanager
def progress_bar(lines: bool = False) -> Iterator[Callable[[str, int, int], None]]:
    """A progress bar on stderr, where that is a terminal; elsewhere, with ``lines``, a line as each stage begins."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        tasks: dict[str, Any] = {}

        def report(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bar.add_task(what, total=total)
                if lines and not console.is_terminal:
                    typer.echo(f"gtau: {what} ...", err=True)
            bar.update(tasks[what], completed=done, total=total)

        yield report


def print_json(document: Any) -> None:
    """Print one JSON document on stdout."""
    typer.echo(json.dumps(document, indent=1, allow_nan=False))


@contextmanager
def interruption_flag() -> Iterator[Callable[[], bool]]:
    """Whether Ctrl-C has been pressed, instead of an exception in the middle of things."""
    import signal

    pressed: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, frame: pressed.append(number))
    try:
        yield lambda: bool(pressed)
    finally:
        signal.signal(signal.SIGINT, before)
