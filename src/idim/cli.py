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
    huber = "huber"
    ridge = "ridge"
    two_stage = "2sls"
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
    except KeyboardInterrupt as interruption:
        finished = str(interruption) or "files that were not finished have not been written"
        typer.echo(f"idim: interrupted; {finished}.", err=True)
        raise typer.Exit(130) from None
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise typer.Exit(0) from None


@contextmanager
def _progress() -> Iterator[Callable[[str, int, int], None]]:
    """A progress bar on stderr, where that is a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
    )
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
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
            help="The paper's r_sigma (10 to 30) for the essential parameters; default: BIC.",
        ),
    ] = None,
    as_paper: Annotated[
        bool,
        typer.Option(
            "--as-paper", help="Follow the paper step by step: its filter, friction and reduction, no delays."
        ),
    ] = False,
    consistent: Annotated[
        bool, typer.Option("--consistent", help="Also find standard parameters that rigid bodies can have.")
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
                consistent=consistent,
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
def compare(experiment: ExperimentFile, json_: Json = False) -> None:
    """Identify with every estimator, and compare gains, deviations, residuals and verdicts."""
    with _refusals():
        from idim.estimation.comparison import compare as run
        from idim.estimation.comparison import table, to_document

        with _progress() as progress:
            found = run(experiment, progress)
        if json_:
            _print_json(to_document(found))
        else:
            typer.echo(table(found))


@app.command()
def validate(model: ModelFile, experiment: ExperimentFile, json_: Json = False) -> None:
    """Torque errors of a model on the validation runs of an experiment."""
    with _refusals():
        from idim.estimation.data import experiment_of, read_runs
        from idim.estimation.result import Result

        result = Result.load(model)
        described = experiment_of(result, experiment)
        if not described.validation:
            raise IdimError(f"{experiment} has no validation runs; list them under 'validation'.")
        with _progress() as progress:
            runs = read_runs(described, described.validation)
            errors = []
            for k, run in enumerate(runs):
                progress("validation", k, len(runs))
                errors.append((run.name, result.validate(run)))
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
                        for name, found in errors
                    ]
                }
            )
            return
        for name, found in errors:
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
        str,
        typer.Argument(
            metavar="NAME_OR_FILE",
            help="Catalog name, robot file (YAML), URDF (with its loops beside it), MJCF, .par or MDH table (.csv).",
            show_default=False,
        ),
    ],
    save: Annotated[
        Path | None, typer.Option("--save", metavar="ROBOT.yaml", help="Write it as a robot file, to edit or keep.")
    ] = None,
    figure: Annotated[
        Path | None, typer.Option("--figure", metavar="ROBOT.png", help="Draw it at home (needs matplotlib).")
    ] = None,
    json_: Json = False,
) -> None:
    """Joints, loops, degrees of freedom and base parameters of a robot."""
    with _refusals():
        from idim.report.robot_page import describe, robot_page
        from idim.robots.load import load_robot

        found = load_robot(source)
        if save is not None:
            from idim.robots.native import write_native

            write_native(found, save)
        if figure is not None:
            from idim.report.robot_figure import robot_figure
            from idim.report.style import save_figure

            save_figure(robot_figure(found), figure)
        description = describe(found)
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


SimulationFile = Annotated[
    Path, typer.Argument(metavar="SIMULATION.yaml", help="Robot, true parameters, drives, runs.", show_default=False)
]


@app.command()
def simulate(
    simulation: SimulationFile,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for the logs and experiment.yaml.")],
    json_: Json = False,
) -> None:
    """Make logs of a simulated robot under control, and the experiment file for 'idim identify'."""
    with _refusals():
        from idim.simulation.experiment_files import simulate_experiment

        with _progress() as progress:
            written = simulate_experiment(simulation, _folder(out), progress)
        if json_:
            _print_json({"files": [str(path) for path in written]})
        else:
            typer.echo("\n".join(f"written: {path}" for path in written))


@app.command(name="compare-control")
def compare_control(
    simulation: SimulationFile,
    experiment: ExperimentFile,
    json_: Json = False,
) -> None:
    """Compare PID and computed torque with three sets of drive gains on a simulated robot (the paper's Table 4).

    The models of computed torque are identified from the logs of EXPERIMENT.yaml, those that 'idim simulate' wrote.
    """
    with _refusals():
        from idim.simulation.comparison import compare_control as run
        from idim.simulation.comparison import table, table_document

        with _progress() as progress:
            comparison = run(simulation, experiment, progress)
        if json_:
            _print_json({"tracking": table_document(comparison)})
        else:
            typer.echo(table(comparison))


@app.command()
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
    with _refusals():
        from idim.experiment.design import Design
        from idim.experiment.design import design as run
        from idim.experiment.design_file import read_design
        from idim.report.excite_page import describe_design, design_page, write_design, write_trajectory

        if more_masses and not payload_mass:
            raise IdimError("numbers stand after the design file; write them after --payload-mass.")
        task, assumed = read_design(design)
        folder, saved = _folder(out), [float("inf")]
        with _progress() as progress, _interruption() as interrupted:

            def keep(best: Design | None, done: int, total: int) -> None:
                if best is not None and best.value < saved[0]:
                    write_trajectory(best, folder / "trajectory.csv")
                    saved[0] = best.value
                progress("starts", done, total)

            found = run(task, criterion, starts, seed, keep, interrupted)
        document = describe_design(found, assumed, [*(payload_mass or []), *(more_masses or [])])
        written = write_design(found, document, folder)
        if json_:
            _print_json(document)
        else:
            typer.echo(design_page(document))
            typer.echo("\n".join(f"written: {path}" for path in written))


@contextmanager
def _interruption() -> Iterator[Callable[[], bool]]:
    """Whether Ctrl-C has been pressed, instead of an exception in the middle of things."""
    import signal

    pressed: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, frame: pressed.append(number))
    try:
        yield lambda: bool(pressed)
    finally:
        signal.signal(signal.SIGINT, before)


def main() -> None:
    """Run the command line; what it refuses, wrong options too, is one sentence on stderr and exit code 2."""
    if len(sys.argv) < 2:
        app()
    usage_error: type[Exception] = typer.BadParameter.__mro__[1]  # of the click that typer brings or finds
    try:
        code = app(standalone_mode=False)
    except typer.Abort:
        sys.exit(130)
    except usage_error as error:
        typer.echo(f"idim: {error.format_message()} See 'idim --help'.", err=True)  # type: ignore[attr-defined]
        sys.exit(2)
    except Exception as error:
        if "IDIM_DEBUG" in os.environ:
            raise
        typer.echo(
            f"idim: this should not have happened ({type(error).__name__}: {error}); please report it with what "
            "IDIM_DEBUG=1 shows.",
            err=True,
        )
        sys.exit(1)
    sys.exit(code if isinstance(code, int) else 0)
