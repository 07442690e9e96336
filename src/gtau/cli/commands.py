"""The list of commands."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from gtau import __version__
from gtau.cli.identification import campaign, compare, fleet, identify
from gtau.cli.logs import check, init
from gtau.cli.models import export, payload, use, validate
from gtau.cli.robots import demo, docs, excite, robot, simulate, tutorial
from gtau.cli.watch import watch
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
                parameter.display_type_rich = _no_type  # type: ignore[attr-defined, method-assign, unused-ignore]
            elif "{exports}" in (template := getattr(parameter, "template", parameter.help) or ""):  # type: ignore[attr-defined]
                parameter.template = template  # type: ignore[attr-defined]
                parameter.help = template.format(exports=listed)  # type: ignore[attr-defined]
        super().format_help(ctx, formatter)
        with formatter.section("Examples"):
            for example in EXAMPLES[str(self.name)]:
                formatter.write(f"  {example}\n")


def _no_type(ctx: Any) -> None:
    """Replace the type in the help of arguments."""


COMMANDS: dict[str, dict[Callable[..., None], tuple[str, str, str]]] = {
    "Learn": {
        tutorial: (
            "Copy the logs of the ten-minute tutorial to a folder.",
            "gtau tutorial",
            "gtau tutorial ~/first-steps",
        ),
        demo: ("Simulate, identify and weigh on an Orthoglide.", "gtau demo", "gtau demo --out ~/demo"),
        docs: ("Print a page of the documentation.", "gtau docs", "gtau docs experiment-file"),
    },
    "Prepare": {
        robot: (
            "Show joints, loops and base parameters of a robot.",
            "gtau robot five-bar",
            "gtau robot arm.urdf --figure arm.png",
        ),
        excite: (
            "Design the most informative motion.",
            "gtau excite design.yaml",
            "gtau excite design.yaml --out plan --payload-mass 1,2,5",
        ),
        simulate: (
            "Simulate a robot under control, and write its logs.",
            "gtau simulate simulation.yaml",
            "gtau simulate simulation.yaml --out simulated",
        ),
        init: (
            "Draft an experiment file from logs.",
            "gtau init empty.csv loaded_1.2kg.csv --robot arm.urdf",
            "gtau init run.csv --robot arm.urdf --position 'enc_J*' --current 'iq_J*'",
        ),
        check: (
            "Check the logs before identifying.",
            "gtau check experiment.yaml",
            "gtau check empty.csv loaded.csv --robot arm.urdf --payload loaded.csv=1.2",
        ),
    },
    "Identify": {
        identify: (
            "Identify drive gains and dynamic parameters.",
            "gtau identify experiment.yaml",
            "gtau identify empty.csv loaded_1.2kg.csv --robot arm.urdf",
        ),
        compare: (
            "Identify with every estimator, and compare.",
            "gtau compare experiment.yaml",
            "gtau compare experiment.yaml --out compared",
        ),
        fleet: (
            "Identify many robots; mark outliers among them.",
            "gtau fleet 'cells/*/experiment.yaml'",
            "gtau fleet fleet.yaml --out fleet --jobs 4",
        ),
        campaign: (
            "From no log to trusted gains, motion after motion.",
            "gtau campaign camp --robot arm.urdf --payload-mass 2",
            "gtau campaign camp",
        ),
    },
    "Use": {
        validate: (
            "Compare measured and predicted torques on other runs.",
            "gtau validate result/model.json check.csv",
            "gtau validate result/model.json experiment.yaml --out check",
        ),
        payload: (
            "Weigh unknown payloads.",
            "gtau payload result/model.json empty.csv unknown.csv --payload empty.csv=0",
            "gtau payload result/model.json unknown.csv --frame tool0 --to ur --out weighed",
        ),
        use: (
            "Compute external joint torques along a log.",
            "gtau use result/model.json contact.csv --out torques.csv",
            "gtau use result/model.json contact.csv --carries steel --observer 10",
        ),
        watch: (
            "Watch a robot: is it still the one that was identified?",
            "gtau watch result/model.json logs/ --out histories/SN1234",
            "gtau watch histories/",
        ),
        export: (
            "Export a model for other programs.",
            "gtau export result/model.json --to c",
            "gtau export result/model.json --to urdf --into arm.urdf --out exported",
        ),
    },
}
"""Every command with its short help and two examples."""
EXAMPLES = {command.__name__: examples for group in COMMANDS.values() for command, (_, *examples) in group.items()}


class _Commands(TyperGroup):
    """Commands grouped by purpose; ``help COMMAND`` is its help, and a word such as version suggests the option."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        for purpose, commands in COMMANDS.items():
            with formatter.section(purpose):
                formatter.write_dl([(command.__name__, short) for command, (short, *_) in commands.items()])

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


for command, (short, *_) in (entry for commands in COMMANDS.values() for entry in commands.items()):
    app.command(command.__name__, cls=_Command, short_help=short)(command)
