"""The command that looks at logs before anything is identified."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter
from typing import Annotated

import typer

from gtau.cli.console import ExperimentFile, Json, print_json, progress_bar, refusals, show
from gtau.documents.files import folder_of, refuse_as_folder


def check(
    experiment: ExperimentFile,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Folder for report.html, figures of the logs and singularities."),
    ] = None,
    figure: Annotated[
        Path | None,
        typer.Option(
            "--figure",
            metavar="DIR",
            help="Folder for a figure of each log's preparation: spectra, bandwidth, clock, rows left out.",
        ),
    ] = None,
    json_: Json = False,
) -> None:
    """Check the logs before identifying: errors, warnings, and what was repaired.

    The exit code follows the worst finding: 2 for an error, 3 for a warning, otherwise 0.
    """
    with refusals(json_):
        refuse_as_folder(out)
        refuse_as_folder(figure)
        start = perf_counter()
        with progress_bar() as progress:
            from gtau.estimation.check_logs import check_logs
            from gtau.estimation.grades import EXIT_CODES
            from gtau.report.check import check_document, check_page, write_check, write_preparation
            from gtau.report.write import inputs_of, write_report

            checked = check_logs(experiment, progress)
        page, written = check_page(checked), list[Path]()
        if out is not None:
            written = [write_report(page, folder_of(out), perf_counter() - start, inputs_of(experiment))]
            written += write_check(checked, out)
        if figure is not None:
            written += write_preparation(checked, folder_of(figure))
        if json_:
            print_json(check_document(checked))
        else:
            show(page, written)
        if code := EXIT_CODES[checked.worst]:
            raise typer.Exit(code)
