"""The list of commands."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from gtau import __version__
from gtau.cli.identification import compare, fleet, identify
from gtau.cli.logs import check, init
from gtau.cli.models import export, payload, use, validate
from gtau.cli.robots import demo, excite, robot, simulate, tutorial
from gtau.cli.watch import watch
from gtau.extensions import names


def show_version(wanted: bool) -> None:
    """Print the version, where it is asked for."""
    if wanted:
        typer.echo(f"gtau {__version__}")
        raise typer.Exit


class _Command(TyperCommand):
    """A command whose help names all exports, and arguments without the Python types that recent Typers add."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        for parameter in self.get_params(ctx):
            if parameter.param_type_name == "argument":
                parameter.display_type_rich = _no_type  # type: ignore[attr-defined, method-assign, unused-ignore]
            elif "{exports}" in (parameter.help or ""):  # type: ignore[attr-defined]
                listed = ", ".join(names("gtau.exports", "gtau.export"))
                parameter.help = parameter.help.format(exports=listed)  # type: ignore[attr-defined]
        super().format_help(ctx, formatter)


def _no_type(ctx: Any) -> None:
    """Describe no type."""


app = typer.Typer(
    name="gtau",
    no_args_is_help=True,
    rich_markup_mode=None,  # its tables name the type of every flag and cut long values
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.callback()
def gtau(
    version: Annotated[
        bool, typer.Option("--version", callback=show_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Identify drive gains and dynamic parameters of serial and parallel robots from logged positions and currents."""


COMMANDS: dict[Callable[..., None], str] = {
    tutorial: "Copy the logs of the ten-minute tutorial to a folder.",
    init: "Draft an experiment file from logs.",
    check: "Check the logs before identifying.",
    identify: "Identify drive gains and dynamic parameters.",
    fleet: "Identify many robots; mark outliers among them.",
    compare: "Identify with every estimator, and compare.",
    validate: "Compare measured and predicted torques on other runs.",
    payload: "Weigh unknown payloads.",
    watch: "Watch a robot: is it still the one that was identified?",
    use: "Compute external joint torques along a log.",
    export: "Export a model for other programs.",
    robot: "Show joints, loops and base parameters of a robot.",
    demo: "Simulate, identify and weigh on an Orthoglide.",
    simulate: "Simulate a robot under control, and write its logs.",
}
for command, short in COMMANDS.items():
    app.command(name=command.__name__.replace("_", "-"), cls=_Command, short_help=short)(command)
masses = {"allow_extra_args": True}  # those after --payload-mass are extra arguments
app.command(cls=_Command, context_settings=masses, short_help="Design the most informative motion.")(excite)
