"""Options and arguments that several commands have."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from gtau.errors import GtauError
from gtau.estimation.estimators.registry import NAMES

METHODS = "|".join(NAMES)


def option(metavar: str, text: str, *names: str, **more: Any) -> Any:
    """Describe an option by its metavar (none for a flag) and its help."""
    return typer.Option(*names, metavar=metavar or None, help=text, **more)


def argument(metavar: str, text: str) -> Any:
    """Describe an argument by its metavar and its help."""
    return typer.Argument(metavar=metavar, help=text, show_default=False)


ModelFile = Annotated[Path, argument("MODEL.json", "What 'gtau identify' wrote.")]
Columns = Annotated[Path | None, option("EXPERIMENT.yaml", "Take columns and units from an experiment file.")]
CarriedPayload = Annotated[str | None, option("NAME", "Payload that the robot carries, by its name in the model.")]
ReportFolder = Annotated[Path | None, option("DIR", "Folder for report.html. Default: no files.")]
XacroArguments = Annotated[
    list[str] | None, option("NAME=VALUE", "Argument of the robot's xacro file. Repeatable.", "--xacro-arg")
]
Json = Annotated[bool, option("", "Print one JSON document on stdout instead of tables.", "--json")]


def named_values(stated: list[str] | None) -> dict[str, str]:
    """Read ``--xacro-arg``: values by name."""
    pairs = [text.partition(":=" if ":=" in text else "=") for text in stated or ()]
    if wrong := [name + equals for name, equals, _ in pairs if not name or not equals]:
        raise GtauError(f"--xacro-arg is '{wrong[0]}'; write the name of an argument and its value: ur_type=ur10e.")
    return {name: value for name, _, value in pairs}


def base_choice(text: str | None) -> Any:
    """Read ``--base``: a word, or three angles in rad."""
    if text is None or text in ("fixed", "floating"):
        return text
    from gtau.robots.readers.source import angle

    angles, why = [part.strip() for part in text.split(",")], ""
    if len(angles) == 3:
        try:
            list(map(angle, angles))
            return {"rpy": angles}
        except ValueError as error:
            why = f": {error}"
    raise GtauError(f"--base is '{text}'{why}; write fixed, floating, or three angles in rad, such as 0,0,deg(90).")
