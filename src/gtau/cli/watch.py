"""The command that watches a robot log by log."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter
from typing import Annotated

import typer

from gtau.cli.console import ModelFile, progress_bar, refusals, show
from gtau.documents.files import folder_of, refuse_as_folder
from gtau.errors import GtauError


def watch(
    model: ModelFile,
    logs: Annotated[
        list[Path] | None,
        typer.Argument(metavar="LOG...", help="Finished logs, oldest first, or folders of them.", show_default=False),
    ] = None,
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder of the history, which is gone on with; report.html.")
    ] = Path("history"),
    experiment: Annotated[
        Path | None,
        typer.Option("--experiment", metavar="EXPERIMENT.yaml", help="Take columns and units from an experiment file."),
    ] = None,
    payload: Annotated[
        str | None, typer.Option("--payload", metavar="NAME", help="Payload of the model that the robot carries.")
    ] = None,
    baseline: Annotated[
        str,
        typer.Option(
            "--baseline", metavar="N|DIR", help="Number of healthy logs that set what is normal, or a folder of them."
        ),
    ] = "10",
    false_alarms: Annotated[
        float,
        typer.Option("--false-alarms-per-year", min=1e-6, metavar="NUMBER", help="Of all charts of the whole fleet."),
    ] = 1.0,
    robots: Annotated[int, typer.Option("--robots", min=1, metavar="NUMBER", help="Robots of the fleet.")] = 1,
    logs_per_year: Annotated[
        float, typer.Option("--logs-per-year", min=1.0, metavar="NUMBER", help="Logs of each robot.")
    ] = 365.0,
    reset: Annotated[
        str | None,
        typer.Option("--reset", metavar="DATE", help="Begin a new baseline with the first new log from this date on."),
    ] = None,
    json_: Annotated[bool, typer.Option("--json", help="Print a line of JSON a log instead of a table.")] = False,
) -> None:
    """Watch a robot: compare its logs with what is normal, and name what has changed.

    The first healthy logs of a repeated motion set what is normal between days; every further log is compared with
    them: payload, drive gains at fixed inertia, friction, encoder zeros, delays and residuals. Logs that are in the
    history already are skipped. The exit code is 3 while there is an alarm. It is no safety function.
    """
    with refusals(json_):
        refuse_as_folder(out)
        start = perf_counter()
        from gtau.estimation.experiment_runs import carrying, read_log
        from gtau.estimation.results.result import Result
        from gtau.report.watch import watch_page, watch_report
        from gtau.report.write import write_report
        from gtau.watch.logs import date_of, logs_of, reset_date
        from gtau.watch.state import digest_of, open_history
        from gtau.watch.watch import Watch

        healthy, count = _baseline(baseline)
        given = logs_of([*healthy, *(logs or [])])
        if not given:
            raise GtauError("there is no log to compare; give logs, oldest first.")
        since = None if reset is None else reset_date(reset)
        result = Result.load(model)
        watched = Watch(result, out, count, false_alarms, robots, logs_per_year)
        last = None
        with progress_bar() as progress:
            for k, log in enumerate(given):
                progress("logs", k, len(given))
                if (digest := digest_of(log)) in watched.seen:
                    continue
                run = read_log(result, log, experiment)
                run = run if payload is None else carrying(result, run, payload)
                date = date_of(log)
                begins = since is not None and date >= since
                last = watched.update(run, digest, date, begins)
                since = None if begins else since
                if json_:
                    typer.echo(last.entry.model_dump_json())
        entries = list(open_history(folder_of(out), watched.settings))
        inputs = (("model", model), *(("log", log) for log in given))
        written = [write_report(watch_report(watched, last, entries), out, perf_counter() - start, inputs)]
        if not json_:
            show(watch_page(watched, last), [*written, out / "history.jsonl"])
        if watched.alarm is not None:
            raise typer.Exit(3)


def _baseline(text: str) -> tuple[list[Path], int]:
    """Read ``--baseline``: a number of logs, or a folder whose logs they are."""
    from gtau.watch.logs import logs_of

    if text.isdigit():
        return [], int(text)
    folder = Path(text)
    if not folder.is_dir():
        raise GtauError(f"--baseline is '{text}'; write a number of healthy logs, or the folder that holds them.")
    return [folder], len(logs_of([folder]))
