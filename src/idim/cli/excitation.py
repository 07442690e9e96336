"""The command that designs exciting motions."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from idim.cli.console import Json, folder_of, interruption_flag, print_json, progress_bar, refusals
from idim.errors import IdimError


def excite(
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
    starts: Annotated[int, typer.Option(min=1, help="Random motions to start from.")] = 3,
    seed: Annotated[int, typer.Option(help="Of the random motions.")] = 0,
    more_masses: Annotated[list[float] | None, typer.Argument(hidden=True)] = None,
    json_: Json = False,
) -> None:
    """Design the motion that tells most about the drive gains, and what to expect of it.

    The best motion so far is kept in DIR; an interruption (Ctrl-C) ends the search and takes it.
    """
    with refusals():
        from idim.experiment.design import Design
        from idim.experiment.design import design as run
        from idim.experiment.design_file import read_design
        from idim.report.excite_page import describe_design, design_page, write_design, write_trajectory

        if more_masses and not payload_mass:
            raise IdimError("numbers stand after the design file; write them after --payload-mass.")
        task, assumed = read_design(design)
        folder, saved = folder_of(out), [float("inf")]
        with progress_bar() as progress, interruption_flag() as interrupted:

            def keep(best: Design | None, done: int, total: int) -> None:
                if best is not None and best.value < saved[0]:
                    write_trajectory(best, folder / "trajectory.csv")
                    saved[0] = best.value
                progress("starts", done, total)

            found = run(task, criterion, starts, seed, keep, interrupted)
        document = describe_design(found, assumed, [*(payload_mass or []), *(more_masses or [])])
        written = write_design(found, document, folder)
        if json_:
            print_json(document)
        else:
            typer.echo(design_page(document))
            typer.echo("\n".join(f"written: {path}" for path in written))
