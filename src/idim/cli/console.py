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

from idim.errors import IdimError

ExperimentFile = Annotated[Path, typer.Argument(metavar="EXPERIMENT.yaml", help="Experiment file.", show_default=False)]
ModelFile = Annotated[
    Path, typer.Argument(metavar="MODEL.json", help="What 'idim identify' wrote.", show_default=False)
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document on stdout instead of tables.")]


@contextmanager
def refusals() -> Iterator[None]:
    """Turn what idim refuses into one sentence on stderr and exit code 2."""
    try:
        yield
    except IdimError as error:
        typer.echo(f"idim: {error}", err=True)
        raise typer.Exit(2) from None
    except KeyboardInterrupt as interruption:
        finished = str(interruption) or "files that were not finished have not been written"
        typer.echo(f"idim: interrupted; {finished}.", err=True)
        raise typer.Exit(130) from None
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise typer.Exit(0) from None


@contextmanager
def progress_bar() -> Iterator[Callable[[str, int, int], None]]:
    """A progress bar on stderr, where that is a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
    )
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        tasks: dict[str, Any] = {}

        def report(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bar.add_task(what, total=total)
            bar.update(tasks[what], completed=done, total=total)

        yield report


def print_json(document: Any) -> None:
    """Print one JSON document on stdout."""
    typer.echo(json.dumps(document, indent=1, allow_nan=False))


def folder_of(path: Path) -> Path:
    """The folder itself, made where it is missing."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise IdimError(f"the folder {path} cannot be made ({error.strerror}); choose another one.") from None
    return path


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
