"""Shared parts of the commands: options, refusals in one sentence, JSON documents, progress."""

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
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from gtau.cli.interruption import begin, exit_code, interrupted, report_ending
from gtau.documents.files import hold_folder
from gtau.errors import GtauError, tidy
from gtau.estimation.estimators import NAMES
from gtau.findings import Progress

if TYPE_CHECKING:
    from gtau.report.page import Page

METHOD = "|".join(NAMES)  # metavar of the option


def option(metavar: str, text: str, *names: str, **more: Any) -> Any:
    """Describe an option by its metavar (none for a flag) and its help."""
    return typer.Option(*names, metavar=metavar or None, help=text, **more)


def argument(metavar: str, text: str) -> Any:
    """Describe an argument by its metavar and its help."""
    return typer.Argument(metavar=metavar, help=text, show_default=False)


ModelFile = Annotated[Path, argument("MODEL.json", "What 'gtau identify' wrote.")]
Columns = Annotated[Path | None, option("EXPERIMENT.yaml", "Take columns and units from an experiment file.")]
CarriedPayload = Annotated[str | None, option("NAME", "Payload that the robot carries, by its name in the model.")]
ReportFolder = Annotated[Path | None, option("DIR", "Folder for report.html. Default: no files.")]
XacroArguments = Annotated[
    list[str] | None, option("NAME=VALUE", "Argument of the robot's xacro file. Repeatable.", "--xacro-arg")
]
Json = Annotated[bool, option("", "Print one JSON document on stdout instead of tables.", "--json")]


def named_values(stated: list[str] | None) -> dict[str, str]:
    """Read ``--xacro-arg``: values by name."""
    pairs = [text.partition(":=" if ":=" in text else "=") for text in stated or ()]
    if wrong := [name + equals for name, equals, _ in pairs if not name or not equals]:
        raise GtauError(f"--xacro-arg is '{wrong[0]}'; write the name of an argument and its value: ur_type=ur10e.")
    return {name: value for name, _, value in pairs}


def base_choice(text: str | None) -> Any:
    """Read ``--base``: a word, or three angles in rad."""
    if text is None or text in ("fixed", "floating"):
        return text
    from gtau.robots.readers.source import angle

    angles, why = [part.strip() for part in text.split(",")], ""
    if len(angles) == 3:
        try:
            list(map(angle, angles))
            return {"rpy": angles}
        except ValueError as error:
            why = f": {error}"
    raise GtauError(f"--base is '{text}'{why}; write fixed, floating, or three angles in rad, such as 0,0,deg(90).")


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
        from gtau.report.terminal import show

        show(page())
    for path in written:
        typer.echo(f"written: {path}")


def print_json(document: Any) -> None:
    """Print one JSON document on stdout."""
    typer.echo(json.dumps(document, indent=1, allow_nan=False))
