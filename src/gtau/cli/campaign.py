"""The command from no log to trusted gains: campaign."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from gtau.cli.console import Json, answer, argument, hold, option, progress_bar, refusing, seconds
from gtau.cli.interruption import stop_request

EXIT = {"play": 0, "done": 0, "stopped": 3, "blocked": 3}


@refusing
def campaign(
    folder: Annotated[Path, argument("DIR", "Folder of the campaign, its only state.")],
    robot: Annotated[str | None, option("ROBOT", "Robot file or catalog name, of a new campaign.")] = None,
    payload: Annotated[float | None, option("KG", "Mass of the payload, of a new campaign.", min=0.0)] = None,
    accuracy: Annotated[
        float | None, option("PERCENT", "Required half-width of every gain's 95 % interval (default 3).")
    ] = None,
    json_: Json = False,
) -> None:
    """Identify the robot from the motions played, and decide: done, the next motion, or why none can help.

    Run the command again to resume from the folder. The exit code is 3 if the campaign cannot continue.
    """
    hold(folder)
    with progress_bar() as progress:
        from gtau.campaigns.campaign import campaign as run
        from gtau.campaigns.page import campaign_page
        from gtau.report.write import write_report

        state = run(folder, robot, payload, accuracy, progress, partial(stop_request, ""))
        report = write_report(campaign_page(state), folder, seconds())
    answer(json_, lambda: state.document, lambda: campaign_page(state), [report])
    if code := EXIT[state.next]:
        raise typer.Exit(code)
