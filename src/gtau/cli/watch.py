"""Commands that stay: watch follows robots log by log; app and mcp serve a page and an agent."""

from __future__ import annotations

import sys
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gtau.cli.console import (
    EVERY,
    CarriedPayload,
    Columns,
    answer,
    argument,
    option,
    progress_bar,
    progress_lines,
    refusing,
    seconds,
)
from gtau.cli.identification import identify
from gtau.cli.logs import check
from gtau.cli.models import export, payload, validate
from gtau.cli.robots import excite, robot
from gtau.documents.files import refuse_as_folder
from gtau.errors import GtauError, needing

if TYPE_CHECKING:
    from gtau.watch.follow import Read
    from gtau.watch.watch import Status, Watch

Watched = Annotated[
    Path, argument("MODEL.json|DIR", "A model, or a folder of histories: a page with a line per robot.")
]
HistoryFolder = Annotated[Path, option("DIR", "Folder of the history, which is continued, and of report.html.")]


@dataclass(frozen=True)
class HistoryOptions:
    """Settings that a history keeps."""

    baseline: Annotated[int | None, option("NUMBER", "Healthy logs that form the baseline (10).")] = None
    false_alarms_per_year: Annotated[
        float | None, option("NUMBER", "False alarms a year, of the whole fleet (1).", min=1e-6)
    ] = None
    robots: Annotated[int | None, option("NUMBER", "Robots in the fleet (1).", min=1)] = None
    logs_per_year: Annotated[float | None, option("NUMBER", "Logs a year of each robot (365).", min=1.0)] = None


@dataclass(frozen=True)
class Actions:
    """What a user does about a history."""

    reset: Annotated[str | None, option("DATE", "Begin a new baseline with the first log from this date.")] = None
    acknowledge: Annotated[str | None, option("NOTE", "End the alarm and accept the change as the new reference.")] = (
        None
    )
    forget: Annotated[str | None, option("LOG", "Leave out a log.")] = None
    undo: Annotated[str | None, option("LOG|DATE", "Undo the last action on a log or a date.")] = None


Follow = Annotated[
    bool, option("", "Follow a folder of finished logs, or a growing text log, until Ctrl-C.", "--follow")
]
Power = Annotated[bool, option("", "Only show which changes the motion of a log reveals.", "--power")]


@refusing
def watch(
    model: Watched,
    *,
    logs: Annotated[list[Path] | None, argument("LOG...", "Finished logs, or folders of them.")] = None,
    out: HistoryFolder = Path("history"),
    experiment: Columns = None,
    carries: CarriedPayload = None,
    settings: HistoryOptions,
    actions: Actions,
    follow: Follow = False,
    block: Annotated[float, option("SECONDS", "Blocks of a growing log.", min=10.0, max=60.0)] = 30.0,
    power: Power = False,
    json_: Annotated[bool, option("", "Print a line of JSON for each log instead of a table.", "--json")] = False,
) -> None:
    """Compare the logs of a robot with its model and with each other, and name the change.

    An alarm is raised if the last week is out of the `tolerances` of --experiment, or a load, gain, friction, zero
    or lag has changed since the first healthy logs. Unreadable logs are set aside.

    Exit code 3: a robot needs attention. It is not a safety function.
    """
    if model.is_dir():
        _fleet(model, json_)
        return
    refuse_as_folder(out)
    from gtau.estimation.results.model_file import load
    from gtau.signals.reading.experiment import read_experiment
    from gtau.uses.identify import read_log, require_payload
    from gtau.watch.follow import follow as followed, logs_of
    from gtau.watch.watch import Watch

    sources = logs or []
    asked = {action: subject for action, subject in vars(actions).items() if subject is not None}
    _refuse_logs(sources, follow, power, out, asked)
    with progress_bar() as progress:
        given = [] if follow else logs_of(sources)
        result = load(model)
        if carries is not None:
            require_payload(result, carries)
        tolerances = read_experiment(experiment).tolerances if experiment else None
        read = partial(read_log, result, experiment=experiment, payload=carries)
        watched = Watch(result, None if power else out, tolerances, **vars(settings))
        if power:
            progress(f"reading {given[-1].name}", 0, 1)
            watched.imagine(read(given[-1]))
    if power:
        from gtau.report.watch import power_page, power_rows

        answer(json_, lambda: power_rows(watched), lambda: power_page(watched))
        return
    for action, subject in asked.items():
        getattr(watched, action)(subject)
    statuses = _taken(watched, given, read)
    if follow:  # silent while it waits for the next log
        statuses = followed(watched, sources[0], read, block, busy=lambda log: progress_lines(f"reading {log}", EVERY))
    if _told(watched, statuses, (model, *given), json_, follow):
        raise typer.Exit(3)


def _refuse_logs(sources: list[Path], follow: bool, power: bool, out: Path, actions: Collection[str]) -> None:
    """Refuse logs, or none, that the options do not go with, and ``actions`` without the history in ``out``."""
    from gtau.watch.history import HISTORY

    if follow and len(sources) != 1:
        raise GtauError("--follow takes one folder or one growing text log; give it alone.")
    if not (sources or actions):
        raise GtauError("there is no log to compare; give logs.")
    if power and (follow or not sources):
        raise GtauError("--power shows what the motion of a finished log can reveal; give one.")
    if {*actions} - ({"reset"} if sources else set()) and not (out / HISTORY).exists():
        raise GtauError(f"{out} holds no history to act on; give the folder of a watched robot by --out.")


def _taken(watched: Watch, logs: list[Path], read: Read) -> Iterator[Status]:
    from gtau.watch.follow import date_of, take

    with progress_bar() as progress:
        for k, log in enumerate(sorted(logs, key=lambda log: date_of(log)[:10])):
            progress(f"log {log.name}", k, len(logs))
            if (status := take(watched, log, read)) is not None:
                yield status


def _told(watched: Watch, statuses: Iterator[Status], files: tuple[Path, ...], as_json: bool, follow: bool) -> bool:
    """Print a line for logs set aside or followed, or JSON for every log, and the last page; return whether to attend.

    A report is written at the end, at Ctrl-C, and when the state of a followed robot changes.
    """
    from gtau.report.html import write_report
    from gtau.report.watch import status_words, watch_page, watch_report

    history = watched.history.path
    inputs = tuple(("log" if k else "model", file) for k, file in enumerate(files))

    def report() -> list[Path]:
        with progress_bar() as progress:
            progress("writing the report", 0, 1)
            return [write_report(watch_report(watched), history.parent, seconds(), inputs), history]

    aside, healthy = False, watched.alarm is None
    try:
        for status in statuses:
            aside = aside or bool(status.skipped)
            if as_json or follow or status.skipped:
                print(status.model_dump_json() if as_json else status_words(status), flush=True)
            if follow and healthy != (watched.alarm is None):
                healthy = not healthy
                report()
    except KeyboardInterrupt:
        report()
        raise KeyboardInterrupt(f"all finished logs are in {history}") from None
    written = report()
    if not as_json:
        answer(False, dict, lambda: watch_page(watched), written)
    return aside or watched.alarm is not None


def _fleet(folder: Path, as_json: bool) -> None:
    from gtau.report.html import write_report
    from gtau.report.watch import STATES, fleet_lines, fleet_page
    from gtau.watch.history import HISTORY

    lines = fleet_lines(folder)
    page = fleet_page(lines)
    alone = (folder / HISTORY).exists()  # beside its own report
    answer(as_json, lambda: lines, lambda: page, [] if alone else [write_report(page, folder, seconds())])
    if any(line["state"] in STATES[:2] for line in lines):
        raise typer.Exit(3)


@refusing
def app(
    folder: Annotated[Path, argument("FOLDER", "Folder of the project.")] = Path(),
    port: Annotated[int, option("PORT", "Default: a free one.", min=0, max=65535)] = 0,
    browser: Annotated[bool, option("", "Open the page in a browser.", "--browser/--no-browser")] = True,
) -> None:
    """Open a page in the browser: drop a robot file and logs. Nothing leaves this machine."""
    from gtau.doors.app import serve

    serve(folder, port, browser)


@refusing
def mcp(
    folder: Annotated[Path, argument("FOLDER", "The only folder it writes to; default: the current one.")] = Path(),
) -> None:
    """Serve an agent over stdin and stdout, by the Model Context Protocol: its client starts this command."""
    with needing("serving an agent", "mcp", "mcp"):
        from gtau.doors.mcp import serve
    if sys.stdin.isatty():
        typer.echo("gtau: the client of an agent starts this command and speaks to it; Ctrl-C ends it.", err=True)
    same = {command.__name__: command for command in (check, identify, validate, export, robot)}
    try:
        serve(folder, same | {"weigh": payload, "design_motion": excite})
    except* BrokenPipeError:  # the client is gone
        pass
