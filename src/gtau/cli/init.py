"""The command that drafts an experiment file from logs: init."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gtau.cli.console import Json, print_json, refusals
from gtau.errors import GtauError

if TYPE_CHECKING:
    from gtau.robots.robot import Robot
    from gtau.signals.discovery import Draft


def init(
    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG...",
            help="Logs that were recorded alike, one a run; or those of positions, then as many of commands.",
            show_default=False,
        ),
    ],
    robot: Annotated[
        str | None, typer.Option("--robot", metavar="ROBOT", help="A name of the catalog, or the path of a robot file.")
    ] = None,
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="The experiment file.")] = Path("experiment.yaml"),
    yes: Annotated[bool, typer.Option("--yes", help="Ask nothing; mark in the file what to check.")] = False,
    json_: Json = False,
) -> None:
    """Draft an experiment file from logs: find the time, positions and currents, their units and the sampling rate."""
    with refusals(json_):
        from gtau.documents.files import write_atomically
        from gtau.model.home import load_robot
        from gtau.robots.floating import refuse_floating
        from gtau.signals.discovery import discover
        from gtau.signals.draft_text import UNSURE, draft_text

        if out.exists():
            raise GtauError(f"{out} exists already; give another name (--out FILE), or remove it.")
        ask = not (yes or json_) and _on_terminal()
        if robot is None and ask:
            robot = typer.prompt("Robot, a name of the catalog or a path (empty: unknown)", default="") or None
        known: Robot | None = None if robot is None else load_robot(robot)
        if known is not None:
            refuse_floating(known, "drafting its experiment file is")
        draft = discover(logs, known, robot)
        if ask:
            draft = _answered(draft)
        write_atomically(out, draft_text(draft, out.parent))
        open_ = [UNSURE[key] for key in draft.open]
        if json_:
            print_json(
                {
                    "file": str(out),
                    "time": list(draft.time) or {"rate": draft.rate},
                    "position": dict(draft.position),
                    draft.kind: dict(draft.command),
                    "units": dict(draft.units),
                    "to_settle": open_,
                }
            )
            return
        typer.echo(_page(draft, out, open_))


def _on_terminal() -> bool:
    return sys.stdin.isatty() and sys.stdout.isatty()


def _answered(draft: Draft) -> Draft:
    """Ask on the terminal what the logs do not say."""
    settled = set()
    if "rate" in draft.open:
        draft = replace(draft, rate=typer.prompt("Sampling rate of the logs, Hz", type=float))
        settled.add("rate")
    if "kind" in draft.open:
        named = ", ".join(list(draft.command.values())[:3])
        kind = typer.prompt(f"Are {named} ... currents or torques?", default="current")
        draft = replace(draft, kind="torque" if kind.lower().startswith("t") else "current")
        settled.add("kind")
    masses = dict(draft.masses)
    if draft.kind == "current":
        for run in draft.logs:
            known = masses.get(run[0])
            answer = typer.prompt(f"Payload carried in {run[0].name}, kg (0: none)", default=known or 0.0, type=float)
            masses.pop(run[0], None)
            if answer > 0:
                masses[run[0]] = answer
    return replace(draft, masses=masses, open=tuple(key for key in draft.open if key not in settled))


def _page(draft: Draft, out: Path, open_: list[str]) -> str:
    rate = f"{draft.rate:g} Hz" if draft.rate else "unknown rate"
    clock = " and ".join(draft.time) or f"no column, {rate}"
    lines = [
        f"  time      {clock}" + (f"  ({draft.reasons['time']})" if draft.reasons.get("time") else ""),
        f"  position  {', '.join(f'{joint}: {column}' for joint, column in draft.position.items())}",
        f"  {draft.kind:<8}  {', '.join(f'{joint}: {column}' for joint, column in draft.command.items())}",
    ]
    if draft.units:
        lines.append(f"  units     {', '.join(f'{key} in {unit}' for key, unit in draft.units.items())}")
    if draft.others:
        lines.append(f"  not used  {'; '.join(draft.others)}")
    lines += ["", f"written: {out}"]
    lines += [f"to settle in it: {each}" for each in open_]
    lines.append(f"next: gtau check {out}")
    return "\n".join(lines)
