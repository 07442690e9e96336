"""The command that reads, shows and converts robots."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gtau.cli.console import Json, base_choice, print_json, progress_bar, refusals, show
from gtau.errors import GtauError


def robot(
    source: Annotated[
        str | None,
        typer.Argument(
            metavar="NAME_OR_FILE",
            help="Catalog name, robot file (YAML), URDF (with its loops beside it), MJCF, .par or MDH table (.csv). "
            "Without it the catalog is listed.",
            show_default=False,
        ),
    ] = None,
    save: Annotated[
        Path | None, typer.Option("--save", metavar="ROBOT.yaml", help="Write it as a robot file that you can edit.")
    ] = None,
    figure: Annotated[
        Path | None, typer.Option("--figure", metavar="ROBOT.png", help="Draw it in its home pose, as PNG or PDF.")
    ] = None,
    base: Annotated[
        str | None,
        typer.Option(
            "--base",
            metavar="fixed|floating|ROLL,PITCH,YAW",
            help="Fix a floating base as in the file, or rotated by angles in rad, as deg(90); or let it float.",
        ),
    ] = None,
    joints: Annotated[
        list[str] | None,
        typer.Option("--joints", metavar="PATTERN", help="Joints that move ('FL_*'); others are held. Repeatable."),
    ] = None,
    json_: Json = False,
) -> None:
    """Show the joints, loops, degrees of freedom and base parameters of a robot."""
    with refusals(json_):
        if source is None:
            if save or figure or base or joints:
                raise GtauError("no robot is named; give a name of the catalog or the path of a file.")
            _list_catalog(json_)
            return
        with progress_bar():
            from gtau.model.home import load_robot
            from gtau.report.robot import robot_document, robot_page

            found = load_robot(source, base=base_choice(base), joints=joints or ())
        if save is not None:
            from gtau.robots.readers.native_text import write_native
            from gtau.robots.readers.urdf_loops import is_loops_file

            if save.exists() and (
                (Path(source).exists() and save.samefile(source))
                or (save.suffix in (".yaml", ".yml") and is_loops_file(save))
            ):
                raise GtauError(f"--save would replace {save}, which is being read; give it another name.")
            write_native(found, save)
        if figure is not None:
            from gtau.report.render.charts import save_figure
            from gtau.report.robot_figure import robot_figure

            save_figure(robot_figure(found), figure)
        with progress_bar():
            description = robot_document(found)
        if json_:
            print_json(description)
        else:
            written = [path for path in (save, figure) if path is not None]
            show(robot_page(description), written)


def _list_catalog(as_json: bool) -> None:
    from gtau.robots.readers.read import catalog_names, read_robot

    robots = {name: read_robot(name) for name in catalog_names()}
    if as_json:
        print_json({"catalog": [{"name": name, "source": robot.source} for name, robot in robots.items()]})
        return
    from gtau.report.page import Column, page, section, table

    rows = [(name, f"{len(robot.motors)}", robot.source) for name, robot in robots.items()]
    show(page("", section("Catalog", table((Column("robot"), Column("motors"), Column("source")), rows))))
