"""Commands that hand a model on: export, use."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gtau.cli.console import Json, ModelFile, print_json, progress_bar, refusals

KINDS = "c, mjcf, urdf, yaml, csv, latex, orders, matlab, fmu"  # those of the registry, which --help need not import


def export(
    model: ModelFile,
    to: Annotated[str, typer.Option("--to", metavar="KIND", help=f"What to write: {KINDS}.")],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for the files.")],
    into: Annotated[
        Path | None,
        typer.Option(
            "--into", metavar="FILE", help="Robot file (URDF or MJCF) to copy with the identified parameters put in."
        ),
    ] = None,
    json_: Json = False,
) -> None:
    """Export a model for controllers, simulators, papers and other programs."""
    with refusals(json_):
        from gtau.export.registry import export_model

        with progress_bar() as progress:
            progress("export", 0, 1)
            exported = export_model(model, to, out, into)
            progress("export", 1, 1)
        if json_:
            files = [str(path) for path in exported.files]
            print_json({"kind": to, "files": files, "notes": list(exported.notes), "figures": dict(exported.figures)})
        else:
            lines = [f"written: {path}" for path in exported.files]
            typer.echo("\n".join([*lines, *(f"- {note}" for note in exported.notes)]))
