"""The list of commands."""

from __future__ import annotations

from collections.abc import Callable
from importlib.resources import files
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from gtau import __version__
from gtau.cli.identification import campaign, compare, fleet, identify
from gtau.cli.logs import check, init
from gtau.cli.models import export, payload, use, validate
from gtau.cli.robots import demo, docs, excite, robot, simulate, tutorial
from gtau.cli.watch import app as app_command, mcp, watch
from gtau.extensions import names


def show_version(wanted: bool) -> None:
    """Print the version and exit, if wanted."""
    if wanted:
        typer.echo(f"gtau {__version__}")
        raise typer.Exit


class _Command(TyperCommand):
    """A command whose help names all exports, has examples, and no Python types of arguments."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        listed = ", ".join(names("gtau.exports", "gtau.export"))
        for parameter in self.get_params(ctx):
            if parameter.param_type_name == "argument":
                parameter.display_type_rich = lambda ctx: None  # type: ignore[attr-defined, method-assign, unused-ignore]
            elif "{exports}" in (template := getattr(parameter, "template", parameter.help) or ""):  # type: ignore[attr-defined]
                parameter.template = template  # type: ignore[attr-defined]
                parameter.help = template.format(exports=listed)  # type: ignore[attr-defined]
        super().format_help(ctx, formatter)
        with formatter.section("Examples"):
            for example in examples(str(self.name)):
                formatter.write(f"  {example}\n")


COMMANDS: dict[str, dict[Callable[..., None], str]] = {
    "Learn": {
        tutorial: "Copy the logs of the ten-minute tutorial to a folder.",
        demo: "Simulate, identify and weigh on an Orthoglide.",
        docs: "Print a page of the documentation.",
    },
    "Prepare": {
        robot: "Show joints, loops and base parameters of a robot.",
        excite: "Design the most informative motion.",
        simulate: "Simulate a robot under control, and write its logs.",
        init: "Draft an experiment file from logs.",
        check: "Check the logs before identifying.",
    },
    "Identify": {
        identify: "Identify drive gains and dynamic parameters.",
        compare: "Identify with every estimator, and compare.",
        fleet: "Identify many robots; mark outliers among them.",
        campaign: "From no log to trusted gains, motion after motion.",
    },
    "Use": {
        validate: "Compare measured and predicted torques on other runs.",
        payload: "Weigh unknown payloads.",
        use: "Compute external joint torques along a log.",
        watch: "Watch a robot: is it still the one that was identified?",
        export: "Export a model for other programs.",
    },
    "Serve": {
        app_command: "Open a page in the browser that does all this.",
        mcp: "Lend these commands to an agent, as tools.",
    },
}


def examples(command: str) -> list[str]:
    """List the examples of a command."""
    text = (files("gtau.cli") / "examples.txt").read_text(encoding="utf-8")
    return [line for line in text.splitlines() if line.split()[1] == command]


class _Commands(TyperGroup):
    """Commands grouped by purpose; ``help COMMAND`` is its help, and a word such as version suggests the option."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        for purpose, commands in COMMANDS.items():
            with formatter.section(purpose):
                formatter.write_dl([(command.__name__, short) for command, short in commands.items()])

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        if args == ["help"]:
            typer.echo(ctx.get_help())
            ctx.exit()
        if args[0] == "help":
            args = [*args[1:], "--help"]
        if any(f"--{args[0]}" in parameter.opts for parameter in self.get_params(ctx)):
            ctx.fail(f"No such command '{args[0]}'. Did you mean '--{args[0]}'?")
        return super().resolve_command(ctx, args)


app = typer.Typer(
    name="gtau",
    cls=_Commands,
    no_args_is_help=True,
    rich_markup_mode=None,  # its tables name the type of every flag and cut long values
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.callback()
def gtau(
    version: Annotated[
        bool, typer.Option("--version", "-V", callback=show_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Identify drive gains and dynamic parameters of serial and parallel robots from logged positions and currents."""


for command, short in (entry for commands in COMMANDS.values() for entry in commands.items()):
    app.command(command.__name__, cls=_Command, short_help=short)(command)
