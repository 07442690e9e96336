"""The list of commands."""

from __future__ import annotations

import typer

from idim.cli.excitation import excite
from idim.cli.identification import compare, identify, payload, validate
from idim.cli.robots import robot
from idim.cli.simulations import compare_control, demo, simulate

app = typer.Typer(
    name="idim",
    help="Drive gains and dynamic parameters of robots, serial and parallel, from logged positions and motor currents.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)
for command in (identify, compare, validate, payload, robot, demo, simulate):
    app.command()(command)
app.command(name="compare-control")(compare_control)
app.command()(excite)
