"""Demonstration, case study of the paper, and the logs of the tutorial, shipped with the package."""

from __future__ import annotations

from pathlib import Path

from gtau.documents.files import folder_of, write_atomically
from gtau.errors import GtauError

TUTORIAL_LOGS = Path(__file__).with_name("tutorial_logs")


def write_tutorial(out: Path) -> list[Path]:
    """Copy the tutorial logs to a folder, created if missing, and return their paths.

    Raises GtauError where that cannot be written to, or has a log of that name with other content.
    """
    logs = {folder_of(out) / log.name: log.read_bytes() for log in sorted(TUTORIAL_LOGS.glob("*.csv"))}
    for copy, content in logs.items():
        if copy.exists() and copy.read_bytes() != content:
            raise GtauError(f"{copy} exists already, with other content; give another folder, or remove it.")
    for copy, content in logs.items():
        write_atomically(copy, content)
    return list(logs)
