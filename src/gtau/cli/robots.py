"""Commands on robots: robot, excite, simulate, demo, tutorial."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from gtau.cli.console import (
    Json,
    XacroArguments,
    answer,
    argument,
    base_choice,
    hold,
    named_values,
    option,
    progress_bar,
    refusing,
    seconds,
)
from gtau.cli.interruption import stop_request
from gtau.cli.logs import said_if_refused
from gtau.documents.files import folder_of
from gtau.errors import GtauError
from gtau.findings import Finding

RobotFile = Annotated[
    str | None,
    argument(
        "NAME_OR_FILE",
        "Catalog name, robot file, URDF, xacro, MJCF, .par or MDH table (.csv). Without it the catalog is listed.",
    ),
]
Base = Annotated[
    str | None,
    option(
        "fixed|floating|ROLL,PITCH,YAW",
        "Fix a floating base as in the file or rotated (rad, or deg(90)), or let it float.",
    ),
]


@refusing
def robot(
    source: RobotFile = None,
    save: Annotated[Path | None, option("ROBOT.yaml", "Write it as a robot file.")] = None,
    figure: Annotated[Path | None, option("ROBOT.png", "Draw it at home, as PNG or PDF.")] = None,
    base: Base = None,
    xacro_arg: XacroArguments = None,
    joints: Annotated[
        list[str] | None, option("PATTERN", "Joints that move ('FL_*'); the others are held. Repeatable.")
    ] = None,
    verbose: Annotated[
        bool, option("", "List the base parameters, and what each regroups.", "--verbose", "-v")
    ] = False,
    json_: Json = False,
) -> None:
    """Show the joints, loops, degrees of freedom and base parameters of a robot."""
    if source is None:
        if save or figure or base or joints:
            raise GtauError("no robot is named; give a catalog name or the path of a file.")
        _list_catalog(json_)
        return
    with progress_bar():
        from gtau.model.base_parameters import base_parameters
        from gtau.model.home import load_robot
        from gtau.model.inverse_dynamics import InverseDynamics
        from gtau.report.robot import robot_document, robot_page

        xacro = named_values(xacro_arg)
        described = load_robot(source, base=base_choice(base), joints=joints or (), xacro=xacro)
    if save is not None:
        from gtau.robots.readers.native import write_native
        from gtau.robots.readers.read import is_loops_file

        is_source = save.exists() and Path(source).exists() and save.samefile(source)
        if is_source or (save.exists() and save.suffix in (".yaml", ".yml") and is_loops_file(save)):
            raise GtauError(f"--save would replace {save}, which is being read; give it another name.")
        write_native(described, save)
    if figure is not None:
        from gtau.report.charts import robot_figure, save_figure

        save_figure(robot_figure(described), figure)
    saved = () if save is None else (Finding("file", text=f"{save} is written"),)
    with said_if_refused(saved), progress_bar() as progress:
        model = InverseDynamics(described)
        parameters = base_parameters(model, progress=progress)
    document = partial(robot_document, model, parameters)
    page = partial(robot_page, model, parameters, verbose)
    answer(json_, document, page, filter(None, (save, figure)))


def _list_catalog(as_json: bool) -> None:
    from gtau.report.page import Column, Page, Section, Table
    from gtau.robots.readers.read import catalog_names, read_robot

    robots = {name: read_robot(name) for name in catalog_names()}
    rows = [(name, f"{len(robot.motors)}", robot.source) for name, robot in robots.items()]
    catalog = [{"name": name, "source": source} for name, _, source in rows]
    shown = Table((Column("robot"), Column("motors"), Column("source")), rows)
    answer(as_json, lambda: {"catalog": catalog}, lambda: Page("", Section("Catalog", shown)))


STOPPING = "stopping the search and writing the best motion so far; Ctrl-C again stops at once."


@refusing
def excite(
    design: Annotated[Path, argument("DESIGN.yaml", "Robot, runs, limits, prior knowledge.")],
    out: Annotated[Path, option("DIR", "Folder for the motion, report.html and design.json.")] = Path("plan"),
    criterion: Annotated[
        str, option("CRITERION", "gains, condition, logdet, trace, or parameters to estimate best (gain_11,m_PR).")
    ] = "gains",
    payload_mass: Annotated[str | None, option("KG,KG", "Also show the effect of other payloads.")] = None,
    starts: Annotated[int, option("N", "Searches, each from another random motion.", min=1)] = 2,
    seed: Annotated[int, option("N", "Seed of the random motions.", min=0)] = 0,
    verbose: Annotated[bool, option("", "Print all parameters, limits and assumptions.", "--verbose", "-v")] = False,
    json_: Json = False,
) -> None:
    """Design the motion that identifies the drive gains best, and predict their standard deviations.

    Ctrl-C stops the search and keeps the best motion.
    """
    masses = _masses(payload_mass) if payload_mass else ()
    hold(out)
    with progress_bar() as progress:
        from gtau.excitation.design import Design, Stopped, excite as run
        from gtau.excitation.design_file import read_design
        from gtau.excitation.forecast import Outlook
        from gtau.report import design as pages
        from gtau.report.html import REPORT, write_report

        task, assumed = read_design(design)

        def keep(best: Design) -> None:
            if not (out / pages.DESIGN).exists():  # an older design stays complete until the new one is finished
                pages.write_trajectory(best, folder_of(out))

        try:
            with stop_request(STOPPING) as stop:
                best = run(task, criterion, starts, seed, progress, keep, stop)
        except Stopped as stopped:
            raise KeyboardInterrupt(str(stopped).rstrip(".")) from None
        progress("predicting standard deviations", 0, 1)
        outlook = Outlook(best, assumed, masses)
        for older in (REPORT, pages.DESIGN):
            (out / older).unlink(missing_ok=True)
        written = pages.write_design(outlook, folder_of(out))
        page = pages.design_page(outlook)
        report = write_report(page, out, seconds(), (("design", design),))
    shown = page if verbose else pages.design_summary(outlook)
    answer(json_, lambda: pages.design_document(outlook), lambda: shown, (report, *written))


def _masses(listed: str) -> tuple[float, ...]:
    """Read ``--payload-mass``, kg; raises GtauError."""
    try:
        masses = tuple(map(float, listed.split(",")))
    except ValueError:
        masses = ()
    if not masses or not all(0 < mass < float("inf") for mass in masses):
        raise GtauError(f"--payload-mass is '{listed}'; write positive numbers in kg, such as 1,2.5.")
    return masses


@refusing
def demo(
    out: Annotated[Path, option("DIR", "Folder for logs, model and figures.")] = Path("demo"), json_: Json = False
) -> None:
    """Simulate an Orthoglide, identify it from its logs, and weigh a second payload."""
    hold(out)
    with progress_bar() as progress:
        from gtau.demo import demo as run

        document, page = run(folder_of(out), progress)
    answer(json_, lambda: document, lambda: page)


@refusing
def tutorial(
    out: Annotated[Path, argument("DIR", "Folder for the logs.")] = Path("tutorial"), json_: Json = False
) -> None:
    """Copy the logs of the tutorial ('gtau docs tutorial') to a folder."""
    from gtau.pages import write_tutorial

    written = write_tutorial(out)
    answer(json_, lambda: {"files": [str(path) for path in written]}, written=written)
    if not json_:
        typer.echo(f"next: {f'cd {out} && ' * (out != Path())}gtau init empty_*.csv loaded_1200g.csv --robot five-bar")


@refusing
def docs(name: Annotated[str | None, argument("PAGE", "Default: list all pages.")] = None, json_: Json = False) -> None:
    """Print a page of the documentation; 'messages' lists all findings."""
    from gtau.pages import page_text, titles

    text = titles() if name is None else page_text(name)
    answer(json_, lambda: {"page": name, "text": text})
    if not json_:
        typer.echo(text)


@refusing
def simulate(
    simulation: Annotated[Path, argument("SIMULATION.yaml", "Robot, true parameters, drives, runs.")],
    out: Annotated[Path, option("DIR", "Folder for the logs and experiment.yaml.")] = Path("simulated"),
    json_: Json = False,
) -> None:
    """Simulate a robot under control; write its logs and the experiment file for 'gtau identify'."""
    hold(out)
    with progress_bar() as progress:
        from gtau.model.home import load_robot
        from gtau.robots.geometry import massless
        from gtau.simulation.simulate import parameters_of, read_simulation, simulate

        written = simulate(simulation, out, progress)
        described = read_simulation(simulation)
        robot = load_robot(described.robot)
    parameters = {} if described.model else parameters_of(described, robot)
    light = () if described.model else massless(robot, parameters)
    of_file = parameters != described.parameters
    files = [str(path) for path in written]
    answer(json_, lambda: {"files": files, "massless": light, "inertias_of_file": of_file}, written=written)
    if light and not json_:
        typer.echo(f"without mass and inertia, because 'parameters' lists none for them: {', '.join(light)}")
    if of_file and not json_:
        typer.echo(f"masses and inertias are of the robot's file {robot.source}, as 'parameters' states none")
