"""Commands that open other doors: app."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from gtau.cli.console import argument, option, refusing


@refusing
def app(
    folder: Annotated[Path, argument("FOLDER", "Folder of the project: its robot, logs and experiment file.")] = Path(),
    port: Annotated[int, option("PORT", "Port of this machine; default: a free one.", min=0, max=65535)] = 0,
    browser: Annotated[bool, option("", "Open the page in a browser.", "--browser/--no-browser")] = True,
) -> None:
    """Open a page in the browser: drop a robot file and logs, read the answer. Nothing leaves this machine."""
    from gtau.doors.app import serve

    serve(folder, port, browser)
