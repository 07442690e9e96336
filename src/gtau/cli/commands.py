"""The list of commands."""

from __future__ import annotations

from typing import Annotated

import typer

from gtau import __version__
from gtau.cli.excitation import excite
from gtau.cli.export import export, use
from gtau.cli.fleet import fleet
from gtau.cli.identification import compare, identify, payload, validate
from gtau.cli.init import init
from gtau.cli.logs import check
from gtau.cli.robots import robot
from gtau.cli.simulations import compare_control, demo, simulate, tutorial


def show_version(wanted: bool) -> None:
    """Print the version, where it is asked for."""
    if wanted:
        typer.echo(f"gtau {__version__}")
        raise typer.Exit


app = typer.Typer(
    name="gtau",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.callback()
def gtau(
    version: Annotated[
        bool, typer.Option("--version", callback=show_version, is_eager=True, help="Print the version and stop.")
    ] = False,
) -> None:
    """Identify drive gains and dynamic parameters of serial and parallel robots from logged positions and currents."""


for command in (tutorial, init, check, identify, fleet, compare, validate, payload, use, export, robot, demo, simulate):
    app.command()(command)
app.command(name="compare-control")(compare_control)
app.command(context_settings={"allow_extra_args": True})(excite)  # the masses after --payload-mass
