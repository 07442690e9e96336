"""Shared parts of the commands: refusals in one sentence, JSON documents, progress."""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import fields, is_dataclass
from functools import wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_type_hints

import typer

from gtau.cli.interruption import begin, exit_code, interrupted, report_ending
from gtau.documents.files import hold_folder
from gtau.errors import GtauError, tidy
from gtau.progress import Progress

if TYPE_CHECKING:
    from gtau.report.page import Page

_begun: list[float] = []  # start of the command, s
_held: list[Callable[[], None]] = []  # functions that release the folders held by the command
EVERY = float(os.environ.get("GTAU_PROGRESS_EVERY", 15.0))  # s between lines where stderr is no terminal


def progress_bar() -> AbstractContextManager[Progress]:
    """Show the stages that the yielded function is called with, on stderr."""
    return _bar("starting") if sys.stderr.isatty() else progress_lines("starting", EVERY)


@contextmanager
def _bar(first: str) -> Iterator[Progress]:
    from rich import progress
    from rich.console import Console

    named = progress.TextColumn("{task.description}")
    columns = (named, progress.BarColumn(), progress.TaskProgressColumn(), progress.TimeElapsedColumn())
    with progress.Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(first, total=None)

        def report(stage: str, done: int, total: int) -> None:
            bar.tasks[task].total = total if total > 1 else None  # None pulses; update() would keep the last total
            bar.update(task, description=stage, completed=done)

        yield report


@contextmanager
def progress_lines(first: str, every: float) -> Iterator[Progress]:
    """Print the progress at regular intervals, also while nothing is reported."""
    begun, finished, now = time.monotonic(), threading.Event(), [first]

    def report(stage: str, done: int, total: int) -> None:
        now[0] = f"{stage}, {100 * done / total:.0f} %" if total > 1 else stage

    def speak() -> None:
        while not finished.wait(every):
            print(f"gtau: {now[0]}, {time.monotonic() - begun:.0f} s", file=sys.stderr, flush=True)

    threading.Thread(target=speak, daemon=True).start()
    try:
        yield report
    finally:
        finished.set()


def refusing(command: Callable[..., None]) -> Callable[..., None]:
    """Turn refusals of a command into one sentence on stderr, with ``--json`` also a document, and exit code 2.

    A parameter that is a dataclass of options stands for these options.
    """
    hints, parameters = get_type_hints(command, include_extras=True), dict[str, Parameter]()
    groups = {name: hint for name, hint in hints.items() if isinstance(hint, type) and is_dataclass(hint)}
    for name, parameter in signature(command).parameters.items():
        inner = get_type_hints(groups[name], include_extras=True) if name in groups else {name: hints[name]}
        for option, hint in inner.items():
            default = getattr(groups[name], option) if name in groups else parameter.default
            parameters[option] = Parameter(option, Parameter.KEYWORD_ONLY, default=default, annotation=hint)

    @wraps(command)
    def run(**options: Any) -> None:
        begin()
        _begun[:] = [time.perf_counter()]
        together = {
            name: group(**{field.name: options.pop(field.name) for field in fields(group)})
            for name, group in groups.items()
        }
        try:
            command(**options, **together)
        except GtauError as error:
            if interrupted():
                raise KeyboardInterrupt from None
            raise refused(str(error), bool(options.get("json_"))) from None
        except KeyboardInterrupt as interruption:
            report_ending(str(interruption))
            raise typer.Exit(exit_code()) from None
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            raise typer.Exit(0) from None
        finally:
            while _held:
                _held.pop()()

    run.__signature__ = Signature(list(parameters.values()))  # type: ignore[attr-defined]
    run.__annotations__ = {name: parameter.annotation for name, parameter in parameters.items()}
    return run


def hold(folder: Path | None) -> None:
    """Keep other commands from writing to a folder while this one runs; raises GtauError where one does."""
    if folder is not None:
        _held.append(hold_folder(folder))


def refused(sentence: str, as_json: bool) -> typer.Exit:
    """Report a refusal; return the exit to raise."""
    sentence = tidy(sentence)  # also click's sentences
    typer.echo(f"gtau: {sentence}", err=True)
    with suppress(OSError):  # of a full disk
        if as_json:
            print_json({"error": sentence})
    return typer.Exit(2)


def seconds() -> float:
    """Return the time since the command began, s."""
    return time.perf_counter() - _begun[0]


def answer(
    as_json: bool, document: Callable[[], Any], page: Callable[[], Page] | None = None, written: Iterable[Path] = ()
) -> None:
    """Print the result of a command on stdout: one JSON document, or a page and the paths of the written files."""
    if as_json:
        print_json(document())
        return
    if page is not None:
        from gtau.report.render.terminal import show

        show(page())
    for path in written:
        typer.echo(f"written: {path}")


def print_json(document: Any) -> None:
    """Print one JSON document on stdout."""
    typer.echo(json.dumps(document, indent=1, allow_nan=False))
