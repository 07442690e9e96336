"""Commands on logs before an identification: init, check."""

from __future__ import annotations

import sys
import textwrap
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated

import typer

from gtau.cli.console import METHODS, Json, base_choice, print_json, progress_bar, refusals, show
from gtau.cli.drafting import KindOfLogs, Payloads, PresetOfLogs, RobotOfLogs, Sources, experiment_of
from gtau.documents.files import folder_of, refuse_as_folder
from gtau.errors import GtauError

if TYPE_CHECKING:
    from gtau.signals.discovery import Draft

WIDTH = 80


def init(
    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG",
            help="One log per run, all of one layout; or the logs of positions, then as many of commands.",
            show_default=False,
        ),
    ],
    robot: Annotated[
        str | None, typer.Option("--robot", metavar="ROBOT", help="Name in the catalog, or path of a robot file.")
    ] = None,
    base: Annotated[
        str | None,
        typer.Option("--base", metavar="fixed|ROLL,PITCH,YAW", help="Fix a floating base, or turned by angles in rad."),
    ] = None,
    preset: PresetOfLogs = None,
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="File to write.")] = Path("experiment.yaml"),
    yes: Annotated[bool, typer.Option("--yes", help="Ask nothing; mark in the file what to confirm.")] = False,
    json_: Json = False,
) -> None:
    """Draft an experiment file from logs: find the time, positions and currents, their units and the sampling rate."""
    with refusals(json_):
        from gtau.signals.draft_file import UNSURE
        from gtau.signals.drafting import draft_logs, write_draft
        from gtau.signals.formats import is_rosbag

        if out.exists():
            raise GtauError(f"{out} exists already; give another name (--out FILE), or remove it.")
        ask = not (yes or json_) and _on_terminal()
        if robot is None and ask and not is_rosbag(logs[0]):
            robot = typer.prompt("Robot (catalog name or path of a file; empty if unknown)", default="") or None
        if base is not None and robot is None:
            raise GtauError("--base places a robot; also give --robot ROBOT.")
        draft = draft_logs(logs, robot, base_choice(base), preset=preset)
        if ask:
            draft = _answered(draft)
        write_draft(draft, out)
        open_ = [UNSURE[key] for key in draft.open]
        if json_:
            print_json(
                {
                    "file": str(out),
                    "time": list(draft.time) or {"rate": draft.rate},
                    "position": dict(draft.position),
                    draft.kind: dict(draft.command),
                    "units": dict(draft.units),
                    "to_confirm": open_,
                }
            )
            return
        typer.echo(_page(draft, out, open_))


def _on_terminal() -> bool:
    return sys.stdin.isatty() and sys.stdout.isatty()


def _answered(draft: Draft) -> Draft:
    """Ask on the terminal what the logs do not say."""
    from gtau.signals.drafting import with_kind, with_masses

    if "rate" in draft.open:
        rate = typer.prompt("Sampling rate of the logs, Hz", type=float)
        draft = replace(draft, rate=rate, open=tuple(key for key in draft.open if key != "rate"))
    if "kind" in draft.open:
        named = ", ".join(list(draft.command.values())[:3])
        kind = typer.prompt(f"Are {named} ... currents or torques?", default=draft.kind)
        draft = with_kind(draft, "torque" if kind.lower().startswith("t") else "current")
    if draft.kind == "current":
        asked = {}
        for run in draft.logs:
            known = draft.masses.get(run[0], 0.0)
            asked[run[0]] = typer.prompt(f"Payload in {run[0].name}, kg (0 for none)", default=known, type=float)
        draft = with_masses(draft, {log: max(mass, 0.0) for log, mass in asked.items()})
    return draft


def _page(draft: Draft, out: Path, open_: list[str]) -> str:
    rate = f"{draft.rate:g} Hz" if draft.rate else "rate unknown"
    clock = " and ".join(draft.time) or f"no column, {rate}"
    why = draft.reasons.get("time")
    rows = {
        "time": clock + (f" ({why})" if why else ""),
        "position": ", ".join(f"{joint}: {column}" for joint, column in draft.position.items()),
        draft.kind: ", ".join(f"{joint}: {column}" for joint, column in draft.command.items()),
        "units": ", ".join(f"{key} in {unit}" for key, unit in draft.units.items()),
        "to check": ", ".join((*draft.motion, *draft.wrenches)),
        "not used": "; ".join(draft.others),
    }
    lines = [f"written: {out}, with these columns of the logs"]
    for name, words in rows.items():
        if words:
            lines += textwrap.wrap(words, WIDTH, initial_indent=f"  {name:<10}", subsequent_indent=" " * 12)
    if open_:
        lines += ["", "Before you go on, edit its lines marked CHECK:"]
        for each in open_:
            lines += textwrap.wrap(f"- {each}", WIDTH, subsequent_indent="  ")
    return "\n".join([*lines, "", f"Then: gtau check {out}"])


def check(
    sources: Sources,
    robot: RobotOfLogs = None,
    payload: Payloads = None,
    kind: KindOfLogs = None,
    preset: PresetOfLogs = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Folder for report.html, figures of the logs and singularities."),
    ] = None,
    figure: Annotated[
        Path | None,
        typer.Option(
            "--figure",
            metavar="DIR",
            help="Folder for a figure of each log's preparation: spectra, bandwidth, clock, rows left out.",
        ),
    ] = None,
    method: Annotated[
        str | None,
        typer.Option(
            metavar=METHODS, help="Estimator to be used afterwards; default: that of identify.", show_default=False
        ),
    ] = None,
    json_: Json = False,
) -> None:
    """Check the logs before identifying: errors, warnings, and what was repaired.

    Given logs instead of EXPERIMENT.yaml, it drafts that file without questions, in DIR or else 'result'.
    The exit code follows the worst finding: 2 for an error, 3 for a warning, otherwise 0.
    """
    with refusals(json_):
        refuse_as_folder(out)
        refuse_as_folder(figure)
        start = perf_counter()
        experiment, guessed = experiment_of(
            sources, robot, payload, kind, preset, Path("result") if out is None else out
        )
        with progress_bar() as progress:
            from gtau.estimation.check_logs import check_logs
            from gtau.estimation.grades import EXIT_CODES
            from gtau.report.check import check_document, check_page, write_check, write_preparation
            from gtau.report.write import inputs_of, write_report

            checked = check_logs(experiment, method=method, progress=progress)
        checked = replace(checked, notes=(*checked.notes, *guessed))
        page, written = check_page(checked), [experiment] if guessed else []
        if out is not None:
            written.append(write_report(page, folder_of(out), perf_counter() - start, inputs_of(experiment)))
            written += write_check(checked, out)
        if figure is not None:
            written += write_preparation(checked, folder_of(figure))
        if json_:
            print_json(check_document(checked))
        else:
            show(page, written)
        if code := EXIT_CODES[checked.worst]:
            raise typer.Exit(code)
