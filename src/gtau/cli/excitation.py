"""The command that designs exciting motions."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gtau.cli.console import Json, interruption_flag, print_json, progress_bar, refusals
from gtau.documents.files import folder_of
from gtau.errors import GtauError


def excite(
    context: typer.Context,
    design: Annotated[
        Path, typer.Argument(metavar="DESIGN.yaml", help="Robot, runs, limits, prior knowledge.", show_default=False)
    ],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for the trajectory, figure and table.")],
    criterion: Annotated[
        str,
        typer.Option(help="gains, condition, logdet, trace, or names of parameters (gain_11,m_PR) to be known best."),
    ] = "gains",
    payload_mass: Annotated[
        list[float] | None,
        typer.Option(metavar="KG [KG...]", help="Show also what payloads of other masses would buy.", min=1e-9),
    ] = None,
    starts: Annotated[int, typer.Option(min=1, help="Searches, each from the best of some random motions.")] = 2,
    seed: Annotated[int, typer.Option(help="Of the random motions.")] = 0,
    json_: Json = False,
) -> None:
    """Design the motion that tells most about the drive gains, and what to expect of it.

    The best motion so far is kept in DIR; an interruption (Ctrl-C) ends the search and takes it.
    """
    with refusals(json_):
        from gtau.excitation.design import Design
        from gtau.excitation.design import design as run
        from gtau.excitation.design_file import read_design
        from gtau.report.excite_page import describe_design, design_page, write_design, write_trajectories

        more_masses = _masses(context.args, after=payload_mass)
        task, assumed = read_design(design)
        folder, saved = folder_of(out), [float("inf")]
        with progress_bar() as progress, interruption_flag() as interrupted:

            def keep(best: Design | None, done: int, total: int) -> None:
                if best is not None and best.value < saved[0]:
                    write_trajectories(best, folder)
                    saved[0] = best.value
                progress("starts", done, total)

            found = run(task, criterion, starts, seed, keep, interrupted)
        document = describe_design(found, assumed, [*(payload_mass or []), *more_masses])
        written = write_design(found, document, folder)
        if json_:
            print_json(document)
        else:
            typer.echo(design_page(document))
            typer.echo("\n".join(f"written: {path}" for path in written))


def _masses(words: list[str], after: list[float] | None) -> list[float]:
    """The masses that follow the first one behind ``--payload-mass``, which click leaves over."""
    try:
        masses = [float(word) for word in words]
    except ValueError:
        masses = []
    if len(masses) < len(words) or not all(mass > 0 for mass in masses) or (words and not after):
        raise GtauError(
            f"'{' '.join(words)}' is left over; give one design file, and masses (kg) after --payload-mass."
        )
    return masses
