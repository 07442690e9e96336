"""The command that designs exciting motions."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter
from typing import Annotated

import typer

from gtau.cli.console import Json, print_json, progress_bar, refusals, show
from gtau.cli.interruption import stop_request
from gtau.documents.files import folder_of, refuse_as_folder
from gtau.errors import GtauError

STOPPING = "stopping the search and writing the best motion so far; Ctrl-C again stops at once."


def excite(
    context: typer.Context,
    design: Annotated[
        Path, typer.Argument(metavar="DESIGN.yaml", help="Robot, runs, limits, prior knowledge.", show_default=False)
    ],
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder for report.html, the trajectory and design.json.")
    ],
    criterion: Annotated[
        str,
        typer.Option(
            metavar="CRITERION",
            help="gains, condition, logdet, trace, or names of parameters to estimate best (gain_11,m_PR).",
        ),
    ] = "gains",
    payload_mass: Annotated[
        list[float] | None,
        typer.Option(metavar="KG [KG...]", help="Also show the effect of payloads of other masses."),
    ] = None,
    starts: Annotated[
        int, typer.Option(metavar="N", min=1, help="Number of searches, each from the best of some random motions.")
    ] = 2,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Seed of the random motions.")] = 0,
    json_: Json = False,
) -> None:
    """Design the motion that is most informative about the drive gains, and predict their standard deviations.

    The best motion so far is kept in DIR; Ctrl-C stops the search and takes it.
    """
    with refusals(json_):
        masses = _masses(payload_mass or [], context.args)
        refuse_as_folder(out)
        start = perf_counter()
        with progress_bar() as progress:
            from gtau.excitation.design import Design, Stopped
            from gtau.excitation.design import design as run
            from gtau.excitation.design_file import read_design
            from gtau.report.design import (
                design_document,
                design_page,
                design_report,
                write_design,
                write_trajectories,
            )
            from gtau.report.write import write_report

            task, assumed = read_design(design)

            def keep(best: Design) -> None:
                write_trajectories(best, folder_of(out))

            try:
                with stop_request(STOPPING) as stop:
                    found = run(task, criterion, starts, seed, progress, keep, stop)
            except Stopped as stopped:
                raise KeyboardInterrupt(str(stopped).rstrip(".")) from None
            progress("predicting standard deviations", 0, 1)
            document = design_document(found, assumed, masses)
            page, inputs = design_report(found, document), (("design", design),)
            report = write_report(page, folder_of(out), perf_counter() - start, inputs)
            written = (report, *write_design(found, document, out))
        if json_:
            print_json(document)
        else:
            show(design_page(document), written)


def _masses(first: list[float], words: list[str]) -> list[float]:
    """Collect all masses of ``--payload-mass``: those that click took, and the others that follow."""
    for word in words:
        try:
            first = [*first, float(word)] if first else first
        except ValueError:
            first = []
        if not first:
            raise GtauError(
                f"'{' '.join(words)}' is superfluous; give one design file, and masses (kg) after --payload-mass."
            )
    for mass in first:
        if not 0 < mass < float("inf"):
            raise GtauError(f"--payload-mass {mass:g} is not a mass; write one in kg, above 0.")
    return first
