"""Shared parts of the commands: arguments, refusals in one sentence, JSON documents, progress."""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gtau.cli.interruption import UNFINISHED, begin, exit_code, interrupted
from gtau.cli.interruption import report as report_interruption
from gtau.errors import GtauError
from gtau.estimation.estimators.registry import NAMES
from gtau.model.interpreter.compiled import is_compiled

if TYPE_CHECKING:
    from gtau.report.page import Page

METHODS = "|".join(NAMES)
EVERY = 60.0  # s between lines where stderr is no terminal
STARTING = "starting"
COMPILING = "starting; compiling once, about 6 s"  # 5.6 s of one core at 3 GHz, measured without the file that is kept


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
    """Print the progress at regular intervals, also while nothing is reported."""
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


ExperimentFile = Annotated[Path, typer.Argument(metavar="EXPERIMENT.yaml", help="Experiment file.", show_default=False)]
ModelFile = Annotated[
    Path, typer.Argument(metavar="MODEL.json", help="What 'gtau identify' wrote.", show_default=False)
]
Columns = Annotated[
    Path | None,
    typer.Option("--experiment", metavar="EXPERIMENT.yaml", help="Take columns and units from an experiment file."),
]
CarriedPayload = Annotated[
    str | None,
    typer.Option("--payload", metavar="NAME", help="Payload that the robot carries, by its name in the model."),
]
ReportFolder = Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Folder for report.html.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document on stdout instead of tables.")]

Dask = Annotated[
    str | None,
    typer.Option(
        "--dask", metavar="ADDRESS", help="Work on the workers of a Dask scheduler (tcp://host:8786), or 'local'."
    ),
]


def base_choice(text: str | None) -> Any:
    """Read ``--base``: a word, or three angles in rad."""
    if text is None or text in ("fixed", "floating"):
        return text
    angles, choices = (
        [each.strip() for each in text.split(",")],
        "write fixed, floating, or three angles in rad, such as 0,0,deg(90)",
    )
    if len(angles) != 3:
        raise GtauError(f"--base is '{text}'; {choices}.")
    from gtau.robots.readers.source import angle

    try:
        for each in angles:
            angle(each)
    except ValueError as error:
        raise GtauError(f"--base is '{text}': {error}; {choices}.") from None
    return {"rpy": angles}


@contextmanager
def refusals(as_json: bool) -> Iterator[None]:
    """Turn what gtau refuses into one sentence on stderr, ``as_json`` also a document on stdout, and exit code 2."""
    begin()
    try:
        yield
    except GtauError as error:
        if interrupted():
            raise KeyboardInterrupt from None
        raise refused(str(error), as_json) from None
    except KeyboardInterrupt as interruption:
        report_interruption(str(interruption) or UNFINISHED)
        raise typer.Exit(exit_code()) from None
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise typer.Exit(0) from None


def refused(sentence: str, as_json: bool, code: int = 2) -> typer.Exit:
    """Report the refusal; the exit to raise."""
    typer.echo(f"gtau: {sentence}", err=True)
    if as_json:
        print_json({"error": sentence})
    return typer.Exit(code)


def show(page: Page, written: Iterable[Path] = ()) -> None:
    """Print a page on stdout, and the paths of what was written."""
    from gtau.report.render.terminal import show as show_page

    show_page(page)
    show_written(written)


def show_written(paths: Iterable[Path]) -> None:
    """Print the paths of what was written on stdout."""
    for path in paths:
        typer.echo(f"written: {path}")


def print_json(document: Any) -> None:
    """Print one JSON document on stdout."""
    typer.echo(json.dumps(document, indent=1, allow_nan=False))
