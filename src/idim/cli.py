"""The command line: parses, calls, prints."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from idim.errors import IdimError

app = typer.Typer(
    name="idim",
    help="Drive gains and dynamic parameters of robots, serial and parallel, from logged positions and motor currents.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)


class Method(StrEnum):
    """Estimators of ``idim identify``."""

    ml = "ml"
    mixed = "mixed"
    tls = "tls"
    wls = "wls"
    ols = "ols"


class Gains(StrEnum):
    """Which drive gains to weigh with."""

    identified = "identified"
    prior = "prior"


ExperimentFile = Annotated[Path, typer.Argument(metavar="EXPERIMENT.yaml", help="Experiment file.", show_default=False)]
ModelFile = Annotated[
    Path, typer.Argument(metavar="MODEL.json", help="What 'idim identify' wrote.", show_default=False)
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document on stdout instead of tables.")]


@contextmanager
def _refusals() -> Iterator[None]:
    """Turn what idim refuses into one sentence on stderr and exit code 2."""
    try:
        yield
    except IdimError as error:
        typer.echo(f"idim: {error}", err=True)
        raise typer.Exit(2) from None
    except KeyboardInterrupt:
        typer.echo("idim: interrupted; files that were not finished have not been written.", err=True)
        raise typer.Exit(130) from None
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise typer.Exit(0) from None


@contextmanager
def _progress() -> Iterator[Callable[[str, int, int], None]]:
    """A progress bar on stderr."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        tasks: dict[str, Any] = {}

        def report(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bar.add_task(what, total=total)
            bar.update(tasks[what], completed=done, total=total)

        yield report


def _print_json(document: Any) -> None:
    typer.echo(json.dumps(document, indent=1, allow_nan=False))


def _folder(path: Path) -> Path:
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise IdimError(f"the folder {path} cannot be made ({error.strerror}); choose another one.") from None
    return path


@app.command()
def identify(
    experiment: ExperimentFile,
    out: Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Folder for model.json.")] = None,
    method: Annotated[Method, typer.Option(help="Estimator; wls and ols take the file's prior_gains.")] = Method.ml,
    ratio: Annotated[
        float | None,
        typer.Option(
            min=1.0,
            help="The paper's r_sigma (10 to 30) for the essential parameters; else those within 2 std of 0 go.",
        ),
    ] = None,
    as_paper: Annotated[
        bool,
        typer.Option(
            "--as-paper", help="Follow the paper step by step: its filter, friction and reduction, no delays."
        ),
    ] = False,
    json_: Json = False,
) -> None:
    """Identify drive gains and dynamic parameters, and write DIR/model.json."""
    with _refusals():
        from idim.estimation.identify import identify as run
        from idim.estimation.model_file import to_document

        with _progress() as progress:
            result = run(
                experiment,
                method=method.value,
                ratio=ratio,
                as_paper=as_paper,
                progress=progress,
            )
        if out is not None:
            result.save(_folder(out) / "model.json")
        if json_:
            _print_json(to_document(result))
        else:
            typer.echo(result.summary())
            if out is not None:
                typer.echo(f"written: {out / 'model.json'}")


@app.command()
def validate(model: ModelFile, experiment: ExperimentFile, json_: Json = False) -> None:
    """Torque errors of a model on the validation runs of an experiment."""
    with _refusals():
        from idim.estimation.data import read_runs
        from idim.estimation.result import Result
        from idim.signals.experiment import read_experiment

        result, described = Result.load(model), read_experiment(experiment)
        if not described.validation:
            raise IdimError(f"{experiment} has no validation runs; list them under 'validation'.")
        with _progress() as progress:
            runs = read_runs(described, described.validation)
            errors = {}
            for k, run in enumerate(runs):
                progress("validation", k, len(runs))
                errors[run.name] = result.validate(run)
        if json_:
            _print_json(
                {
                    "runs": [
                        {
                            "log": name,
                            "joints": [
                                {
                                    "joint": e.joint,
                                    "rms": e.rms,
                                    "signal": e.signal,
                                    "relative": e.relative,
                                    "unit": e.unit,
                                }
                                for e in found
                            ],
                        }
                        for name, found in errors.items()
                    ]
                }
            )
            return
        for name, found in errors.items():
            typer.echo(f"{name}\n  {'joint':<22}{'error rms':>12}{'signal rms':>12}{'error %':>9}   unit")
            for e in found:
                typer.echo(f"  {e.joint:<22}{e.rms:>12.4g}{e.signal:>12.4g}{e.relative:>9.2f}   {e.unit}")
        typer.echo(
            "A small error does not prove the gains: both sides carry them. Weigh a known payload ('idim "
            "payload') for that."
        )


@app.command()
def payload(
    model: ModelFile,
    experiment: ExperimentFile,
    gains: Annotated[Gains, typer.Option(help="The model's gains, or the file's prior_gains.")] = Gains.identified,
    json_: Json = False,
) -> None:
    """Weigh the unknown payloads of an experiment's loaded runs."""
    with _refusals():
        from idim.estimation.model_file import payload_documents
        from idim.estimation.payload import weigh
        from idim.estimation.result import Result
        from idim.estimation.summary import payload_lines

        with _progress() as progress:
            found = weigh(Result.load(model), experiment, gains.value, progress)
        if json_:
            _print_json({"payloads": payload_documents(found), "gains": gains.value})
            return
        for each in found:
            typer.echo("\n".join(payload_lines(each)))
        typer.echo(f"weighed with the {gains.value} drive gains")


@app.command()
def robot(
    source: Annotated[
        str, typer.Argument(metavar="NAME_OR_FILE", help="Catalog name, robot file (YAML) or URDF.", show_default=False)
    ],
    json_: Json = False,
) -> None:
    """Joints, loops, degrees of freedom and base parameters of a robot."""
    with _refusals():
        from idim.report.robot_page import describe, robot_page
        from idim.robots.load import load_robot

        description = describe(load_robot(source))
        if json_:
            _print_json(description)
        else:
            typer.echo(robot_page(description))


@app.command()
def demo(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for logs, model, tables and figures.")],
    json_: Json = False,
) -> None:
    """Identify an Orthoglide from logs made on the spot, and weigh a second payload with the result."""
    with _refusals():
        from idim.report.demo import demo as run

        with _progress() as progress:
            document, text = run(_folder(out), progress)
        if json_:
            _print_json(document)
        else:
            typer.echo(text)
