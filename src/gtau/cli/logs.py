"""Commands on logs before an identification: init, check; and logs given instead of an experiment file."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from gtau.cli.console import (
    METHOD,
    Json,
    XacroArguments,
    answer,
    argument,
    base_choice,
    hold,
    named_values,
    option,
    print_json,
    progress_bar,
    refusing,
    seconds,
)
from gtau.documents.files import EXPERIMENT, LOG, folder_of, kind_of, refuse_other_kind, write_atomically
from gtau.errors import GtauError, tidy

if TYPE_CHECKING:
    from gtau.estimation.results.result import IdentifiedModel
    from gtau.findings import Finding
    from gtau.robots.robot import Robot
    from gtau.signals.reading.drafting import Stated

WIDTH = 80
EXPERIMENTS = (".yaml", ".yml")  # endings of experiment files
Sources = Annotated[list[Path], argument("EXPERIMENT.yaml|LOG...", "Experiment file, or logs.")]


@dataclass(frozen=True)
class LogOptions:
    """What is stated of logs that are given in place of an experiment file."""

    robot: Annotated[
        str | None,
        option(
            "ROBOT",
            "With logs: catalog name, name of robot_descriptions, or robot file; default: /robot_description of a bag.",
        ),
    ] = None
    payload: Annotated[
        list[str] | None,
        option(
            "LOG=KG",
            "With logs: payload of a log, kg, 0 for none; default: from names such as loaded_0.48kg.mcap. Repeatable.",
        ),
    ] = None
    position: Annotated[
        str | None,
        option(
            "COLUMNS",
            "With logs: columns of the positions (enc_J1,enc_J2) or a pattern ('enc_J*'), in the order of the joints.",
        ),
    ] = None
    current: Annotated[str | None, option("COLUMNS", "With logs: columns of the currents.")] = None
    torque: Annotated[str | None, option("COLUMNS", "With logs: columns of the torques.")] = None
    time: Annotated[str | None, option("COLUMN", "With logs: column of the time.")] = None
    kind: Annotated[
        Literal["current", "torque"] | None,
        option("current|torque", "With logs: what columns such as 'effort' contain; default: by name."),
    ] = None
    preset: Annotated[
        str | None, option("PRESET", "With logs: their recorder (ur-current, franka-ros, lerobot, ...).")
    ] = None
    xacro_arg: XacroArguments = None

    @property
    def given(self) -> list[str]:
        """Names of the options that are given."""
        return [f"--{name.replace('_', '-')}" for name, value in vars(self).items() if value]

    def stated(self, kind: Literal["current", "torque"] | None = None) -> Stated:
        """Read the options, the ``kind`` of commands known where none is stated; raises GtauError."""
        from gtau.signals.reading.drafting import Stated

        columns = {name: value for name in ("position", "current", "torque", "time") if (value := getattr(self, name))}
        masses = {}
        for stated in self.payload or []:
            log, _, mass = stated.rpartition("=")
            try:
                masses[log] = float(mass)
            except ValueError:
                log = ""
            if not log:
                raise GtauError(f"--payload is '{stated}'; write the name of a log and kg, such as loaded.mcap=0.48.")
        return Stated(masses, self.kind or kind, self.preset, columns, named_values(self.xacro_arg))


@refusing
def init(
    logs: Annotated[list[Path], argument("LOG", "One log per run; or logs of positions, then as many of commands.")],
    stated: LogOptions,
    base: Annotated[
        str | None, option("fixed|ROLL,PITCH,YAW", "Fix a floating base, or rotate it by these angles, rad.")
    ] = None,
    out: Annotated[Path, option("FILE", "File to write.")] = Path("experiment.yaml"),
    json_: Json = False,
) -> None:
    """Draft an experiment file from logs; lines marked CHECK are to be confirmed."""
    from gtau.signals.reading.discovery import QUESTIONS
    from gtau.signals.reading.drafting import draft_logs, write_draft

    if out.exists():
        raise GtauError(f"{out} exists already; give another name (--out FILE), or remove it.")
    robot = stated.robot
    if base is not None and robot is None:
        raise GtauError("--base places a robot; also give --robot ROBOT.")
    known = stated.stated()
    with skeleton_if_unrecognised(logs, robot, known, out):
        draft = draft_logs(logs, robot, base_choice(base), known)
    write_draft(draft, out)
    open_ = [QUESTIONS[key] for key in draft.open]
    if not json_:
        typer.echo(_page(out, open_))
        return
    signals = draft.signals
    columns = {"position": dict(signals.position), signals.kind: dict(signals.command), "units": dict(draft.units)}
    clock = list(signals.time_columns) or {"rate": None if "rate" in draft.open else signals.rate}
    print_json({"file": str(out), "time": clock, **columns, "to_confirm": open_})


def _page(out: Path, open_: list[str]) -> str:
    from gtau.signals.reading.drafting import SEAL

    lines = [out.read_text(encoding="utf-8").rpartition(SEAL)[0].partition("\n\n")[2], f"written: {out}"]
    if open_:
        lines += ["", "Before you go on, edit its lines marked CHECK:"]
        for doubt in open_:
            lines += textwrap.wrap(f"- {doubt}", WIDTH, subsequent_indent="  ")
    return "\n".join([*lines, "", f"Then: gtau check {out}"])


@refusing
def check(
    sources: Sources,
    stated: LogOptions,
    out: Annotated[Path | None, option("DIR", "Folder for report.html. Default: no files.")] = None,
    method: Annotated[str | None, option(METHOD, "Estimator that will identify.")] = None,
    json_: Json = False,
) -> None:
    """Check the logs before identifying: errors, warnings, and repairs.

    From logs it drafts DIR/experiment.yaml, or result/experiment.yaml. Exit code 2: an error; 3: a warning.
    """
    hold(out)
    experiment, guessed = experiment_of(sources, stated, out)
    with said_if_refused(guessed), progress_bar() as progress:
        from gtau.estimation.check_logs import check
        from gtau.estimation.experiment_runs import Options
        from gtau.report.html import write_report
        from gtau.report.logs import check_document, check_page, inputs_of

        checked = check(experiment, None, Options(method), progress)
    checked = replace(checked, notes=(*checked.notes, *guessed))
    page, written = check_page(checked), [experiment] if guessed else []
    if out is not None:
        written.append(write_report(page, folder_of(out), seconds(), inputs_of(experiment)))
    answer(json_, lambda: check_document(checked), lambda: page, written)
    if code := checked.worst.exit_code:
        raise typer.Exit(code)


def experiment_of(
    sources: list[Path],
    stated: LogOptions,
    out: Path | None,
    default: str = "result",
    weigh: bool = False,
    model: IdentifiedModel | None = None,
) -> tuple[Path, tuple[Finding, ...]]:
    """Return an experiment file, drafted from logs if need be, and a note on every guess in the draft.

    The draft is in ``out``, which is held, or in a ``default`` folder. Logs without a stated payload carry none, or
    with ``weigh`` an unknown one. By default they are of the robot of a ``model``, and have the columns of its logs.
    Raises GtauError if experiment files are mixed with logs, or the draft needs an answer of the user.
    """
    if len(sources) == 1 and not is_log(sources[0]):
        if stated.given and sources[0].exists():
            refuse_other_kind(sources[0], EXPERIMENT)
            raise GtauError(f"{stated.given[0]} is for logs; an experiment file states this itself, so omit it.")
        return sources[0], ()
    if others := [source for source in sources if source.suffix in EXPERIMENTS or kind_of(source) == EXPERIMENT]:
        raise GtauError(f"{others[0]} is an experiment file; give either it or logs.")
    from gtau.signals.reading.drafting import guesses, write_draft
    from gtau.uses.identify import drafted

    if out is None:
        hold(Path(default))
    file = (out or Path(default)) / "experiment.yaml"
    robots: AbstractContextManager[str | None] = nullcontext(stated.robot)
    if model is not None:
        robots = robots if stated.robot else _beside(file, model.robot)
    known = stated.stated(None if model is None else model.kind)  # type: ignore[arg-type]
    with robots as robot, skeleton_if_unrecognised(sources, robot, known, file):
        draft = drafted(sources, robot, known, weigh, model)
        write_draft(draft, file)
    held = f", whose columns {', '.join(draft.unused.moving)} move and are not used" * ("unmatched" in draft.open)
    held += f". CHECK: {draft.open['unit']}" if "unit" in draft.open else ""
    typer.echo(tidy(f"gtau: {file} is drafted from {len(sources)} log{'s' * (len(sources) != 1)}{held}."), err=True)
    return file, guesses(draft, file)


@contextmanager
def _beside(file: Path, robot: Robot) -> Iterator[str]:
    """Write a robot beside the draft in a ``file``; without a new draft the folder stays as it was."""
    from gtau.robots.readers.native import native_text

    path = folder_of(file.parent) / "robot.yaml"
    before, draft = (written.read_bytes() if written.is_file() else None for written in (path, file))
    write_atomically(path, native_text(robot))
    try:
        yield str(path)
    except BaseException:
        if draft == (file.read_bytes() if file.is_file() else None):
            write_atomically(path, before) if before else path.unlink()
        raise


@contextmanager
def skeleton_if_unrecognised(logs: list[Path], robot: str | None, known: Stated, file: Path) -> Iterator[None]:
    """Write an experiment file without columns where none are recognised, and say so in the refusal."""
    from gtau.signals.reading.discovery import NoColumns

    try:
        yield
    except NoColumns as refusal:
        from gtau.signals.reading.drafting import write_skeleton

        write_skeleton(logs, robot, known.masses, folder_of(file.parent) / file.name)
        written = f"{file} is written with all but these columns"
        raise GtauError(f"{refusal.sentence.rstrip('.')}; {written}.", source=refusal.source) from None


@contextmanager
def said_if_refused(guesses: tuple[Finding, ...]) -> Iterator[None]:
    """Print the guesses about logs, each with the option that corrects it, before a refusal that may be due to them."""
    try:
        yield
    except GtauError:
        for guess in guesses:
            typer.echo(tidy(f"gtau: {guess}."), err=True)
        raise


def is_log(path: Path) -> bool:
    """Return whether a file is a log, by its ending or content."""
    if path.suffix in EXPERIMENTS:  # without the readers, which take 0.1 s to load
        return False
    from gtau.signals.reading.logs import is_log_folder, reader_of

    return reader_of(path.suffix.lower()) is not None or (
        is_log_folder(path) if path.is_dir() else kind_of(path) == LOG
    )
