"""The command that watches a robot log by log."""

from __future__ import annotations

import json
import sys
from collections import deque
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gtau.cli.console import (
    CarriedPayload,
    Columns,
    ModelFile,
    answer,
    argument,
    option,
    progress_bar,
    refusing,
    seconds,
)
from gtau.documents.files import folder_of, refuse_as_folder
from gtau.errors import GtauError

if TYPE_CHECKING:
    from gtau.estimation.results.result import Result
    from gtau.signals.run import Run
    from gtau.watch.follow import Skipped
    from gtau.watch.watch import Status, Watch

REPORTED = 1000  # last logs that a report draws
Logs = Annotated[list[Path] | None, argument("LOG...", "Finished logs, oldest first, or folders of them.")]
History = Annotated[Path, option("DIR", "Folder of the history, continued if it exists, and of report.html.")]
Baseline = Annotated[str, option("N|DIR", "Number of healthy logs that form the baseline, or a folder of them.")]
FalseAlarms = Annotated[
    float,
    option("NUMBER", "False alarms a year, over all charts of the whole fleet.", "--false-alarms-per-year", min=1e-6),
]


Robots = Annotated[int, option("NUMBER", "Number of robots in the fleet.", min=1)]
LogsPerYear = Annotated[float, option("NUMBER", "Logs a year of each robot.", min=1.0)]
Reset = Annotated[str | None, option("DATE", "Begin a new baseline with the first new log from this date on.")]
Follow = Annotated[
    bool, option("", "Follow one folder of finished logs, or a growing text log, until Ctrl-C.", "--follow")
]
Block = Annotated[float, option("SECONDS", "Length of the blocks of a growing log.", min=10.0, max=60.0)]
JsonLines = Annotated[bool, option("", "Print a line of JSON for each log instead of a table.", "--json")]


@refusing
def watch(
    model: ModelFile,
    logs: Logs = None,
    out: History = Path("history"),
    experiment: Columns = None,
    payload: CarriedPayload = None,
    baseline: Baseline = "10",
    false_alarms: FalseAlarms = 1.0,
    robots: Robots = 1,
    logs_per_year: LogsPerYear = 365.0,
    reset: Reset = None,
    follow: Follow = False,
    block: Block = 30.0,
    json_: JsonLines = False,
) -> None:
    """Watch a robot: compare its logs with what is normal, and name what has changed.

    The first healthy logs of a repeated motion set what is normal between days; every further log is compared with
    them: payload, drive gains at fixed inertia, friction, encoder zeros, delays and residuals. Logs that are in the
    history already are skipped. With --follow a robot in production is followed block by block.

    The exit code is 3 while there is an alarm. It is no safety function.
    """
    refuse_as_folder(out)
    from gtau.estimation.results.result import Result
    from gtau.report.watch import watch_page
    from gtau.watch.follow import follow as blocks
    from gtau.watch.state import HISTORY, date_of, digest_of, logs_of
    from gtau.watch.watch import Watch

    healthy, count = _baseline(baseline)
    sources = logs or []
    if follow and len(sources) != 1:
        raise GtauError("--follow takes one folder or one growing text log; give it alone.")
    given = logs_of([*healthy, *([] if follow else sources)])
    if not (given or follow):
        raise GtauError("there is no log to compare; give logs, oldest first.")
    result = Result.load(model)
    watched = Watch(result, out, count, false_alarms, robots, logs_per_year)
    if reset is not None:
        watched.reset(reset)
    read = partial(_read, result, experiment, payload)
    report = partial(_report, watched, out, (("model", model), *(("log", log) for log in given)))
    last = None
    with progress_bar() as progress:
        for k, log in enumerate(given):
            progress("logs", k, len(given))
            if (digest := digest_of(log)) in watched.seen:
                continue
            last = watched.update(read(log), digest, date_of(log))
            if json_:
                typer.echo(last.entry.model_dump_json())
    if follow:
        last = _follow(blocks(watched, sources[0], read, block), last, report, json_)
    written = [report(last), out / HISTORY]
    if not json_:
        answer(False, dict, lambda: watch_page(watched, last), written)
    if watched.alarm is not None:
        raise typer.Exit(3)


def _read(result: Result, experiment: Path | None, payload: str | None, log: Path) -> Run:
    """Read a log, with the payload that the robot carries."""
    from gtau.uses.runs import carrying, read_log

    run = read_log(result, log, experiment)
    return run if payload is None else carrying(result, run, payload)


def _report(watched: Watch, out: Path, inputs: tuple[tuple[str, Path], ...], last: Status | None) -> Path:
    """Write the report of the last logs."""
    from gtau.report.watch import watch_report
    from gtau.report.write import write_report
    from gtau.watch.state import open_history

    entries = deque(open_history(folder_of(out), watched.settings), maxlen=REPORTED)
    return write_report(watch_report(watched, last, list(entries)), out, seconds(), inputs)


def _follow(
    statuses: Iterable[Status | Skipped], last: Status | None, report: Callable[[Status | None], Path], as_json: bool
) -> Status | None:
    """Print a line for each block as it comes, and write a report at the first that is not healthy, and at Ctrl-C."""
    from gtau.watch.state import HISTORY
    from gtau.watch.watch import Status

    try:
        for status in statuses:
            _say(status, as_json)
            if isinstance(status, Status):
                if not status.healthy and (last is None or last.healthy):
                    report(status)
                last = status
    except KeyboardInterrupt:
        history = report(last).with_name(HISTORY)
        raise KeyboardInterrupt(f"all finished blocks are in {history}") from None
    return last


def _say(status: Status | Skipped, as_json: bool) -> None:
    """Print a line for a block."""
    from gtau.report.watch import alarm_words
    from gtau.watch.follow import Skipped

    if isinstance(status, Skipped):
        line = json.dumps({"log": status.log, "skipped": status.why}) if as_json else f"{status.log}: {status.why}"
    elif as_json:
        line = status.entry.model_dump_json()
    else:
        said = "no change" if status.entry.alarm is None else alarm_words(status.entry.alarm)[0]
        line = f"{status.entry.log}: {'baseline' if status.entry.phase == 'baseline' else said}"
    typer.echo(line)
    sys.stdout.flush()


def _baseline(text: str) -> tuple[list[Path], int]:
    """Read ``--baseline``: a number of logs, or a folder whose logs they are."""
    from gtau.watch.state import logs_of

    if text.isdigit():
        return [], int(text)
    folder = Path(text)
    if not folder.is_dir():
        raise GtauError(f"--baseline is '{text}'; write a number of healthy logs, or the folder that holds them.")
    return [folder], len(logs_of([folder]))
