"""Logs given instead of an experiment file: options, notes, and the draft that is then used."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gtau.documents.files import EXPERIMENT, LOG, kind_of
from gtau.errors import GtauError

if TYPE_CHECKING:
    from gtau.signals.notes import Note


class Commands(StrEnum):
    """What drives were commanded."""

    current = "current"
    torque = "torque"


Sources = Annotated[
    list[Path],
    typer.Argument(
        metavar="EXPERIMENT.yaml|LOG...",
        help="Experiment file, or logs, from which one is drafted (DIR/experiment.yaml).",
        show_default=False,
    ),
]
RobotOfLogs = Annotated[
    str | None,
    typer.Option(
        "--robot",
        metavar="ROBOT",
        help="With logs: name in the catalog or of robot_descriptions, or path of a robot file; default: "
        "/robot_description of a bag.",
        show_default=False,
    ),
]
Payloads = Annotated[
    list[str] | None,
    typer.Option(
        "--payload",
        metavar="LOG=KG",
        help="With logs: payload mass of a log (kg, 0 for none); default: from names such as loaded_0.48kg.mcap. "
        "Repeatable.",
        show_default=False,
    ),
]
KindOfLogs = Annotated[
    Commands | None,
    typer.Option(
        "--kind",
        metavar="current|torque",
        help="With logs: what command columns such as 'effort' contain; default: judged by name.",
        show_default=False,
    ),
]

PresetOfLogs = Annotated[
    str | None,
    typer.Option(
        "--preset",
        metavar="PRESET",
        help="With logs: their source (ur-current, ur-torque, franka-ros, kinova, lerobot, ...).",
        show_default=False,
    ),
]


def experiment_of(
    sources: list[Path],
    robot: str | None,
    payloads: list[str] | None,
    kind: Commands | None,
    preset: str | None,
    folder: Path,
) -> tuple[Path, tuple[Note, ...]]:
    """Take an experiment file as it is; draft one from logs to ``folder``, with a note on every guess in it.

    Raises
    ------
    GtauError
        Experiment files are mixed with logs, or the logs cannot be drafted without a question.
    """
    stated = {"robot": robot, "payload": payloads, "kind": kind, "preset": preset}
    if len(sources) == 1 and not _is_log(sources[0]):
        if given := [f"--{name}" for name, value in stated.items() if value]:
            raise GtauError(f"{given[0]} is for logs; an experiment file states this itself, so omit it.")
        return sources[0], ()
    if others := [each for each in sources if each.suffix in (".yaml", ".yml") or kind_of(each) == EXPERIMENT]:
        raise GtauError(f"{others[0]} is an experiment file; give either it or logs.")
    from gtau.signals.draft_file import guesses
    from gtau.signals.drafting import draft_logs, with_sensors, write_draft

    masses = _masses(payloads or [])
    drafted = draft_logs(sources, robot, masses=masses, kind=None if kind is None else kind.value, preset=preset)
    draft = with_sensors(drafted)
    if draft.robot is None:
        raise GtauError(
            f"{sources[0]} does not name its robot; give it by --robot ROBOT, a catalog name (gtau robot) or the path "
            "of a URDF, MJCF or robot file."
        )
    if "rate" in draft.open:
        raise GtauError(
            f"{sources[0]} has neither times nor velocities to find its sampling rate from; draft a file by 'gtau "
            "init', write the rate there (time: {rate: HZ}), and give that file."
        )
    file = folder / "experiment.yaml"
    write_draft(draft, file)
    typer.echo(f"gtau: {file} is drafted from {len(sources)} log{'s' * (len(sources) != 1)}.", err=True)
    return file, guesses(draft, file)


def _is_log(path: Path) -> bool:
    from gtau.signals.formats import READERS, is_log_folder

    return path.suffix.lower() in (*READERS, ".csv") or (is_log_folder(path) if path.is_dir() else kind_of(path) == LOG)


def _masses(payloads: list[str]) -> dict[str, float]:
    found = {}
    for each in payloads:
        log, _, mass = each.rpartition("=")
        try:
            found[log] = float(mass)
        except ValueError:
            log = ""
        if not log:
            raise GtauError(f"--payload is '{each}'; write the name of a log and kg, such as loaded.mcap=0.48.")
    return found
