"""The command for many robots: fleet."""

from __future__ import annotations

import os
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Annotated

import typer

from gtau.cli.console import Dask, Json, print_json, progress_bar, refusals, show
from gtau.cli.identification import METHODS
from gtau.documents.files import folder_of, refuse_as_folder
from gtau.errors import GtauError


def fleet(
    experiments: Annotated[
        list[str],
        typer.Argument(
            metavar="EXPERIMENT.yaml|FLEET.yaml",
            help="Experiment files of the robots, or patterns ('cells/*/experiment.yaml'); or a fleet file.",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder for report.html, models, table and figure.")
    ],
    method: Annotated[str, typer.Option(metavar=METHODS, help="Estimator; one that finds drive gains.")] = "ml",
    jobs: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Processes on this machine; default: one for each core.")
    ] = None,
    dask: Dask = None,
    json_: Json = False,
) -> None:
    """Identify many robots, and mark drive gains that are outliers among them.

    Finished robots stay in DIR/models: the same command again identifies those that are missing or have changed.
    """
    with refusals(json_):
        refuse_as_folder(out)
        start = perf_counter()
        from gtau.estimation.estimators.estimator import Gains
        from gtau.estimation.estimators.registry import estimator_of
        from gtau.fleet.dask_workers import connected, dask_map
        from gtau.fleet.fleet import identify_fleet, read_fleet
        from gtau.fleet.gains import fleet_table
        from gtau.fleet.processes import process_map
        from gtau.report.fleet import fleet_document, fleet_page, fleet_report, write_fleet
        from gtau.report.write import write_report

        if estimator_of(method).gains == Gains.GIVEN:
            raise GtauError(f"--method {method} takes the drive gains as given; choose one that finds them.")
        if dask is not None and jobs is not None:
            raise GtauError("--jobs is for processes without Dask; give one of --jobs and --dask.")
        members = read_fleet(experiments)
        folder = folder_of(out)
        try:
            with progress_bar() as progress, ExitStack() as stack:
                if dask is not None:
                    mapper = partial(dask_map, client=stack.enter_context(connected(dask)))
                else:
                    mapper = partial(process_map, jobs=min(jobs or os.cpu_count() or 1, len(members)))
                reports = identify_fleet(members, folder, mapper, method, progress)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(
                f"finished robots stay in {folder / 'models'}, and the same command continues with the others"
            ) from None
        table = fleet_table(reports)
        files = tuple(("experiment", member.experiment) for member in members)
        written = [
            write_report(fleet_report(table), folder, perf_counter() - start, files),
            *write_fleet(table, folder),
        ]
        if json_:
            print_json(fleet_document(table))
        else:
            show(fleet_page(table), written)
        if not table.robots:
            raise typer.Exit(3)  # so that a script does not go on with such a fleet
