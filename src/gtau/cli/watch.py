"""The command that watches robots log by log."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gtau.cli.console import (
    CarriedPayload,
    Columns,
    answer,
    argument,
    option,
    progress_bar,
    refusing,
    seconds,
)
from gtau.documents.files import refuse_as_folder
from gtau.errors import GtauError

if TYPE_CHECKING:
    from gtau.estimation.results.result import Result
    from gtau.signals.run import Run
    from gtau.watch.follow import Skipped
    from gtau.watch.watch import Status, Watch

Watched = Annotated[Path, argument("MODEL.json|DIR", "What 'gtau identify' wrote, or a folder of histories: one page.")]
Logs = Annotated[list[Path] | None, argument("LOG...", "Finished logs, or folders of them.")]
History = Annotated[Path, option("DIR", "Folder of the history, continued if it exists, and of report.html.")]
Baseline = Annotated[
    str | None, option("N|DIR", "Number of healthy logs that form the baseline (10), or their folder.")
]
FalseAlarms = Annotated[
    float | None,
    option("NUMBER", "False alarms a year of the whole fleet (1).", "--false-alarms-per-year", min=1e-6),
]
Robots = Annotated[int | None, option("NUMBER", "Number of robots in the fleet (1).", min=1)]
LogsPerYear = Annotated[float | None, option("NUMBER", "Logs a year of each robot (365).", min=1.0)]
Reset = Annotated[str | None, option("DATE", "Begin a new baseline with the first log from this date on.")]
Acknowledge = Annotated[str | None, option("NOTE", "End the alarm: what has changed is the new reference.")]
Forget = Annotated[str | None, option("LOG", "Leave out a log that was not of this robot or of this state.")]
Undo = Annotated[str | None, option("LOG|DATE", "Undo what was last done about a log or a date.")]
Follow = Annotated[
    bool, option("", "Follow one folder of finished logs, or a growing text log, until Ctrl-C.", "--follow")
]
Block = Annotated[float, option("SECONDS", "Length of the blocks of a growing log.", min=10.0, max=60.0)]
JsonLines = Annotated[bool, option("", "Print a line of JSON for each log instead of a table.", "--json")]


@refusing
def watch(
    model: Watched,
    logs: Logs = None,
    out: History = Path("history"),
    experiment: Columns = None,
    payload: CarriedPayload = None,
    baseline: Baseline = None,
    false_alarms: FalseAlarms = None,
    robots: Robots = None,
    logs_per_year: LogsPerYear = None,
    reset: Reset = None,
    acknowledge: Acknowledge = None,
    forget: Forget = None,
    undo: Undo = None,
    follow: Follow = False,
    block: Block = 30.0,
    json_: JsonLines = False,
) -> None:
    """Watch a robot: compare its logs with its model and with each other, and name what has changed.

    Each log is weighed against the model: undeclared load, drive gains at fixed inertia, friction, encoder zeros, lags
    and residuals. An alarm is raised where the last week is beyond tolerance (`tolerances` of --experiment), and where
    a quantity has changed since the first healthy logs. Logs that are in the history are skipped, logs that cannot be
    read set aside. Of a folder of histories one page is made, a line a robot.

    The exit code is 3 while a robot needs attention. It is no safety function.
    """
    if model.is_dir():
        _fleet(model, json_)
        return
    refuse_as_folder(out)
    from gtau.estimation.results.result import Result
    from gtau.report.watch import watch_page
    from gtau.signals.reading.experiment import read_experiment
    from gtau.watch.follow import Skipped, date_of, logs_of, take
    from gtau.watch.follow import follow as blocks
    from gtau.watch.history import HISTORY
    from gtau.watch.watch import Watch

    healthy, count = _baseline(baseline)
    sources = logs or []
    if follow and len(sources) != 1:
        raise GtauError("--follow takes one folder or one growing text log; give it alone.")
    given = sorted(logs_of([*healthy, *([] if follow else sources)]), key=lambda log: date_of(log)[:10])
    done = {"reset": reset, "acknowledge": acknowledge, "forget": forget, "undo": undo}
    if not (given or follow or any(done.values())):
        raise GtauError("there is no log to compare; give logs.")
    result = Result.load(model)
    tolerances = None if experiment is None else read_experiment(experiment).tolerances
    watched = Watch(result, out, count, false_alarms, robots, logs_per_year, tolerances)
    for what, subject in done.items():
        if subject is not None:
            getattr(watched, what)(subject)
    read = partial(_read, result, experiment, payload)
    inputs = (("model", model), *(("log", log) for log in given))
    aside = 0
    with progress_bar() as progress:
        for k, log in enumerate(given):
            progress("logs", k, len(given))
            if (status := take(watched, log, read)) is not None:
                aside += isinstance(status, Skipped)
                _say(status, json_)
    if follow:
        _follow(blocks(watched, sources[0], read, block), watched, out, inputs, json_)
    written = [_report(watched, out, inputs), out / HISTORY]
    if not json_:
        answer(False, dict, lambda: watch_page(watched), written)
    if watched.alarm is not None or aside:
        raise typer.Exit(3)


def _read(result: Result, experiment: Path | None, payload: str | None, log: Path) -> Run:
    """Read a log, with the payload that the robot carries."""
    from gtau.uses.runs import carrying, read_log

    run = read_log(result, log, experiment)
    return run if payload is None else carrying(result, run, payload)


def _report(watched: Watch, out: Path, inputs: tuple[tuple[str, Path], ...]) -> Path:
    """Write the report."""
    from gtau.report.watch import watch_report
    from gtau.report.write import write_report

    return write_report(watch_report(watched), out, seconds(), inputs)


def _follow(
    statuses: Iterable[Status | Skipped], watched: Watch, out: Path, inputs: tuple[tuple[str, Path], ...], as_json: bool
) -> None:
    """Print a line for each block as it comes, and write a report when the state changes, and at Ctrl-C."""
    from gtau.watch.history import HISTORY

    healthy = watched.alarm is None
    try:
        for status in statuses:
            _say(status, as_json, True)
            if healthy != (watched.alarm is None):
                healthy = not healthy
                _report(watched, out, inputs)
    except KeyboardInterrupt:
        history = _report(watched, out, inputs).with_name(HISTORY)
        raise KeyboardInterrupt(f"all finished blocks are in {history}") from None


def _say(status: Status | Skipped, as_json: bool, each_log: bool = False) -> None:
    """Print a line for a log: for each that is set aside, and for the others as JSON or where they are followed."""
    from gtau.report.watch import alarm_words
    from gtau.watch.follow import Skipped

    if isinstance(status, Skipped):
        line = json.dumps({"log": status.log, "skipped": status.why}) if as_json else f"{status.log}: {status.why}"
    elif as_json:
        line = status.entry.model_dump_json()
    elif each_log:
        said = "no change" if status.entry.alarm is None else alarm_words(status.entry.alarm)[0]
        line = f"{status.entry.log}: {'baseline' if status.entry.phase == 'baseline' and status.healthy else said}"
    else:
        return
    typer.echo(line)
    sys.stdout.flush()


def _fleet(folder: Path, as_json: bool) -> None:
    """Write one page for all histories in the folders of a folder."""
    from gtau.report.watch import fleet_lines, fleet_page
    from gtau.report.write import write_report

    lines = fleet_lines(folder)
    page = fleet_page(lines)
    written = [write_report(page, folder, seconds())]
    answer(as_json, lambda: lines, lambda: page, written)
    if any(line["state"] in ("check", "replace") for line in lines):
        raise typer.Exit(3)


def _baseline(text: str | None) -> tuple[list[Path], int | None]:
    """Read ``--baseline``: a number of logs, or a folder whose logs they are."""
    from gtau.watch.follow import logs_of

    if text is None or text.isdigit():
        return [], None if text is None else int(text)
    folder = Path(text)
    if not folder.is_dir():
        raise GtauError(f"--baseline is '{text}'; write a number of healthy logs, or the folder that holds them.")
    return [folder], len(logs_of([folder]))
