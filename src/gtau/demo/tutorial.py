"""Tutorial logs shipped with the package."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from gtau.documents.files import folder_of, write_atomically
from gtau.errors import GtauError

FOLDER = "tutorial_logs"  # beside this module


def write_tutorial(out: Path) -> list[Path]:
    """Copy the tutorial logs to a folder, created if missing.

    Returns
    -------
    list of Path
        The logs.

    Raises
    ------
    GtauError
        Where the folder cannot be made or written to, or has a log of that name with other content.
    """
    folder = folder_of(out)
    logs = sorted(
        (each for each in files("gtau.demo").joinpath(FOLDER).iterdir() if each.name.endswith(".csv")),
        key=lambda each: each.name,
    )
    for each in logs:
        if (there := folder / each.name).exists() and there.read_bytes() != each.read_bytes():
            raise GtauError(f"{there} exists already, with other content; give another folder, or remove it.")
    for each in logs:
        write_atomically(folder / each.name, each.read_bytes())
    return [folder / each.name for each in logs]
