"""Commands that make logs: demo, simulate, compare-control."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gtau.cli.console import ExperimentFile, Json, print_json, progress_bar, refusals, show
from gtau.documents.files import folder_of, refuse_as_folder


def demo(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for logs, model, tables and figures.")],
    json_: Json = False,
) -> None:
    """Simulate an Orthoglide, identify it from its logs, and weigh a second payload with the result."""
    with refusals(json_):
        refuse_as_folder(out)
        with progress_bar() as progress:
            from gtau.demo.run import demo as run

            document, page = run(folder_of(out), progress)
        if json_:
            print_json(document)
        else:
            show(page)


def tutorial(
    out: Annotated[Path, typer.Argument(metavar="DIR", help="Folder for the logs.", show_default=False)],
    json_: Json = False,
) -> None:
    """Copy the logs of the ten-minute tutorial (docs/tutorial.md) to a folder, and say how to go on."""
    with refusals(json_):
        from gtau.demo.tutorial import write_tutorial

        written = write_tutorial(out)
        if json_:
            print_json({"files": [str(path) for path in written]})
            return
        typer.echo("\n".join(f"written: {path}" for path in written))
        typer.echo(f"next: cd {out} && gtau init empty_*.csv loaded_1200g.csv --robot five-bar")


SimulationFile = Annotated[
    Path, typer.Argument(metavar="SIMULATION.yaml", help="Robot, true parameters, drives, runs.", show_default=False)
]


def simulate(
    simulation: SimulationFile,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for the logs and experiment.yaml.")],
    json_: Json = False,
) -> None:
    """Simulate a robot under control; write its logs and the experiment file for 'gtau identify'."""
    with refusals(json_):
        refuse_as_folder(out)
        with progress_bar() as progress:
            from gtau.model.home import load_robot
            from gtau.robots.plausibility import massless
            from gtau.simulation.experiment_files import simulate_experiment
            from gtau.simulation.simulation_file import read_simulation

            written = simulate_experiment(simulation, out, progress)
        described = read_simulation(simulation)
        light = massless(load_robot(described.robot), described.parameters)
        if json_:
            print_json({"files": [str(path) for path in written], "massless": light})
        else:
            typer.echo("\n".join(f"written: {path}" for path in written))
            if light:
                typer.echo(f"without mass and inertia, as 'parameters' names none of theirs: {', '.join(light)}")


def compare_control(
    simulation: SimulationFile,
    experiment: ExperimentFile,
    json_: Json = False,
) -> None:
    """Compare PID and computed torque with three sets of drive gains on a simulated robot (the paper's Table 4).

    The models of computed torque are identified from the logs of EXPERIMENT.yaml, those that 'gtau simulate' wrote.
    """
    with refusals(json_):
        with progress_bar() as progress:
            from gtau.simulation.control_comparison import compare_control as run
            from gtau.simulation.control_comparison import table_document

            comparison = run(simulation, experiment, progress)
        if json_:
            print_json({"tracking": table_document(comparison)})
        else:
            from gtau.report.control import control_page

            show(control_page(comparison))
