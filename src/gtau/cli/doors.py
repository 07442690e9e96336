"""Commands that open other doors: app, mcp."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from gtau.cli.console import argument, option, refusing
from gtau.cli.identification import identify
from gtau.cli.logs import check
from gtau.cli.models import export, payload, validate
from gtau.cli.robots import excite, robot
from gtau.errors import missing_extra


@refusing
def app(
    folder: Annotated[Path, argument("FOLDER", "Folder of the project.")] = Path(),
    port: Annotated[int, option("PORT", "Default: a free one.", min=0, max=65535)] = 0,
    browser: Annotated[bool, option("", "Open the page in a browser.", "--browser/--no-browser")] = True,
) -> None:
    """Open a page in the browser: drop a robot file and logs. Nothing leaves this machine."""
    from gtau.doors.app import serve

    serve(folder, port, browser)


@refusing
def mcp(
    folder: Annotated[Path, argument("FOLDER", "Folder to which alone it writes; default: this one.")] = Path(),
) -> None:
    """Serve an agent over stdin and stdout, by the Model Context Protocol: its client starts this command."""
    try:
        from gtau.doors.mcp import serve
    except ImportError:
        raise missing_extra("serving an agent", "mcp", "mcp") from None
    if sys.stdin.isatty():
        typer.echo("gtau: the client of an agent starts this command and speaks to it; Ctrl-C ends it.", err=True)
    same = {command.__name__: command for command in (check, identify, validate, export, robot)}
    try:
        serve(folder, same | {"weigh": payload, "design_motion": excite})
    except* BrokenPipeError:  # the client is gone
        pass
