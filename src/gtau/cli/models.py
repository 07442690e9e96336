"""Commands that use a model: validate, payload, use, export."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from gtau.cli.console import (
    CarriedPayload,
    Columns,
    Json,
    ModelFile,
    answer,
    argument,
    hold,
    option,
    progress_bar,
    refusing,
    seconds,
)
from gtau.cli.logs import LogOptions, Sources, experiment_of, is_log, said_if_refused
from gtau.documents.files import folder_of
from gtau.errors import GtauError, missing_extra
from gtau.findings import Grade

if TYPE_CHECKING:
    from gtau.estimation.results.payload_body import PayloadBody
    from gtau.estimation.results.result import IdentifiedModel
    from gtau.export.exported import Exported

CONTROLLERS = "ur, franka, kuka, abb, ros"  # as in export.payload, which --help need not import


@refusing
def validate(
    model: ModelFile,
    sources: Sources,
    stated: LogOptions,
    out: Annotated[
        Path | None, option("DIR", "Folder for report.html and tables of all samples. Default: no files.")
    ] = None,
    json_: Json = False,
) -> None:
    """Compare measured and predicted torques on logs, or on the validation runs of an experiment file.

    From logs it drafts DIR/experiment.yaml, or check/experiment.yaml, with the columns of the model.
    """
    hold(out)
    with progress_bar() as progress:
        from gtau.estimation.experiment_runs import read_validation
        from gtau.estimation.results.conclusions import without_temperature
        from gtau.estimation.results.model_file import load
        from gtau.report.html import write_report
        from gtau.report.logs import inputs_of, settings_of
        from gtau.report.torques import predicted
        from gtau.report.validation import validation_document, validation_page, validation_report, write_torques
        from gtau.uses.identify import experiment_of as experiment_for

        result = load(model)
        experiment, guessed = experiment_of(sources, stated, out, "check", model=result)
        with said_if_refused(guessed):
            described = experiment_for(result, experiment)
        if is_log(sources[0]):
            described = described.model_copy(update={"runs": (), "validation": described.runs})
        if not described.validation:
            raise GtauError(f"{experiment} keeps no run for validation; list one under 'validation'.")
        read, unread = read_validation(described, progress)
        if not read:
            raise GtauError(f"{unread[0]}.")
        runs = []
        for k, run in enumerate(read):
            progress("predicting torques", k, len(read))
            runs.append(predicted(result, run, whole=True, progress=progress))
    written: list[Path] = []
    notes = [*guessed, *unread, *without_temperature(result, described.signals)]
    if out is not None:
        page = validation_report(result, runs, described.expected_gains, notes)
        inputs = (("model", model), *inputs_of(experiment, described, runs=False))
        written = [write_report(page, folder_of(out), seconds(), inputs, settings_of(result))]
        written += write_torques(runs, out)
    answer(json_, lambda: validation_document(runs), lambda: validation_page(result, runs, notes), written)


WeighingGains = Annotated[
    Literal["identified", "prior"], option("identified|prior", "The model's gains, or the file's prior_gains.")
]
PayloadFrame = Annotated[
    str,
    option(
        "LINK|POSE",
        "Frame of centre of mass and inertia: a link of the URDF (tool0), or 'x y z roll pitch yaw' (m, rad) from "
        "the body that carries the payload. Default: that body's frame; --to needs one.",
    ),
]
Controller = Annotated[str | None, option("CONTROLLER", f"Also write for a controller: {CONTROLLERS}.")]
WeighingFolder = Annotated[
    Path | None, option("DIR", "Folder for report.html and files of --to. Default: payload with --to, else no report.")
]


@refusing
def payload(
    model: ModelFile,
    sources: Sources,
    stated: LogOptions,
    gains: WeighingGains = "identified",
    frame: PayloadFrame = "",
    to: Controller = None,
    out: WeighingFolder = None,
    json_: Json = False,
) -> None:
    """Weigh unknown payloads: mass, centre of mass and inertia, with 95 % intervals.

    Each log carries an unknown payload, unless --payload says otherwise; one without payload narrows the intervals.
    It drafts DIR/experiment.yaml, or payload/experiment.yaml; --robot names a file with the links of --frame.

    Exit code 3: a mass is negative, or the model contradicts the logs of the robot or the payload.
    """
    out = out or (None if to is None else Path("payload"))
    hold(out)
    with progress_bar() as progress:
        from gtau.estimation.results.model_file import load
        from gtau.report.html import write_report
        from gtau.report.logs import inputs_of, settings_of
        from gtau.report.validation import weighing_document, weighing_page
        from gtau.signals.reading.experiment import read_experiment
        from gtau.uses.weigh import exact_gains, weigh

        result = load(model)
        # of the links that a frame may name
        file = (stated.robot or "") if is_log(sources[0]) else read_experiment(sources[0]).robot_file
        if to is not None:
            _refuse_controller(to, frame, result, file)
        experiment, guessed = experiment_of(sources, stated, out, "payload", True, result)
        described = read_experiment(experiment)
        with said_if_refused(guessed):
            weighed = weigh(result, experiment, gains=gains, progress=progress)
    has_bodies = bool(frame or to or find_spec("clarabel"))
    bodies = [payload.in_frame(frame, file) for payload in weighed] if has_bodies else []
    notes = [] if has_bodies else [str(missing_extra("a centre of mass", "clarabel", "consistency"))]
    notes += [f"{guess.what}; {guess.advice}".removesuffix("; ") for guess in guessed]
    exports = [] if to is None or out is None else export_bodies(bodies, to, out)
    notes += [note for exported in exports for note in exported.notes]
    written = [path for exported in exports for path in exported.files]
    exact = exact_gains(result, described, gains)
    page = partial(weighing_page, result, weighed, gains, exact, bodies)
    if out is not None:
        inputs = (("model", model), *inputs_of(experiment, described))
        settings = {**settings_of(result), "drive gains": gains}
        written.insert(0, write_report(page(described.expected_gains), folder_of(out), seconds(), inputs, settings))
    document = weighing_document(weighed, bodies, gains, exact)
    answer(json_, lambda: document | {"files": [str(path) for path in written], "notes": notes}, page, written)
    _show_notes([] if json_ else notes)
    doubted = gains == "identified" and not exact and not result.believable
    if doubted or Grade.CONTRADICTORY in {payload.verdict.outcome for payload in weighed}:
        raise typer.Exit(3)  # so that scripts do not continue with this mass


def _refuse_controller(to: str, frame: str, result: IdentifiedModel, file: str) -> None:
    """Refuse an unknown controller, or one without a named frame, before the work."""
    from gtau.export.exported import refuse_unknown
    from gtau.export.payload import WRITERS, refuse_unnamed
    from gtau.robots.readers.read import links_on

    refuse_unknown(to, WRITERS)
    if not frame:
        tool = result.robot.tool
        refuse_unnamed(to, f"the frame of '{tool}'", links_on(tool, file))


def export_bodies(bodies: Sequence[PayloadBody], to: str, out: Path) -> list[Exported]:
    """Write payloads for a controller, each to its own files."""
    from gtau.documents.files import identifier
    from gtau.export.payload import export_payload
    from gtau.report.logs import unique_names

    names = unique_names([identifier(body.name) for body in bodies])
    return [export_payload(replace(body, name=name), to, out) for body, name in zip(bodies, names, strict=True)]


@dataclass(frozen=True)
class DrawOptions:
    """Parameter sets drawn beside the model."""

    samples: Annotated[
        int, option("N", "Also draw N parameter sets, for domain randomization: samples.npz.", min=0)
    ] = 0
    models: Annotated[int, option("N", "Number of draws to write as models, too.", min=0)] = 16
    seed: Annotated[int, option("SEED", "Seed of the draws.", min=0)] = 0


@dataclass(frozen=True)
class ThresholdOptions:
    """What thresholds of collision detection are made from."""

    experiment: Annotated[Path | None, option("EXPERIMENT.yaml", "For 'thresholds': its runs have no contact.")] = None
    hours: Annotated[float, option("HOURS", "For 'thresholds': mean time between false alarms.")] = 8.0
    observer: Annotated[float | None, option("HZ", "For 'thresholds': bandwidth of the momentum observer.")] = None


@refusing
def export(
    model: ModelFile,
    to: Annotated[str, option("KIND", "Format: {exports}.")],
    out: Annotated[Path, option("DIR", "Folder for the files.")] = Path("exported"),
    into: Annotated[Path | None, option("FILE", "URDF or MJCF to copy with the identified parameters.")] = None,
    *,
    draws: DrawOptions,
    thresholds: ThresholdOptions,
    json_: Json = False,
) -> None:
    """Export a model for controllers, simulators, papers and other programs."""
    from gtau.export.exported import export_model

    if to != "thresholds" and thresholds != ThresholdOptions():
        raise GtauError(f"--experiment, --hours and --observer are for 'thresholds', not for '{to}'; leave them out.")
    with progress_bar() as progress:
        progress("export", 0, 1)
        if to == "thresholds" and thresholds.experiment is not None:
            from gtau.estimation.experiment_runs import read_runs
            from gtau.estimation.results.model_file import load
            from gtau.export.thresholds import export_thresholds
            from gtau.uses.identify import experiment_of as experiment_for

            result = load(model)
            described = experiment_for(result, thresholds.experiment)
            runs = read_runs(described, described.validation, progress)
            exported = export_thresholds(result, runs, out, thresholds.hours, thresholds.observer)
        else:
            exported = export_model(model, to, out, into, **vars(draws))
    files = [str(path) for path in exported.files]
    document = {"kind": to, "files": files, "notes": list(exported.notes), "figures": dict(exported.figures)}
    _show_notes([exported.lost] if exported.lost and not json_ else [])
    answer(json_, lambda: document, written=exported.files)
    _show_notes([] if json_ else [note for note in exported.notes if note != exported.lost])


def _show_notes(notes: Sequence[str]) -> None:
    for note in notes:
        typer.echo(textwrap.fill(f"- {note}", 80, subsequent_indent="  "))


ContactFrame = Annotated[
    str | None,
    option(
        "LINK|POSE",
        "Also compute force and moment at a link of the experiment's URDF (tool0), or at 'x y z roll pitch yaw' "
        "(m, rad) from the body that carries the payload.",
    ),
]


@refusing
def use(
    model: ModelFile,
    log: Annotated[Path, argument("LOG", "Log of a run.")],
    out: Annotated[Path | None, option("FILE", "Table to write, one row a sample: .csv or .parquet.")] = None,
    experiment: Columns = None,
    carries: CarriedPayload = None,
    frame: ContactFrame = None,
    force_only: Annotated[
        bool, option("", "Contact at a point: no moment about the origin of --frame.", "--force-only")
    ] = False,
    observer: Annotated[
        float | None, option("HZ", "Also estimate external torques causally, by an observer of this bandwidth.")
    ] = None,
    json_: Json = False,
) -> None:
    """Compute external joint torques along a log, model minus motor, to see contacts and collisions.

    LOG has the columns of the model's logs, unless --experiment names others.
    """
    from gtau.estimation.results.model_file import load, torque_error
    from gtau.report.torques import external_page
    from gtau.robots.readers.read import frame_on
    from gtau.signals.reading.experiment import read_experiment
    from gtau.uses.external_torques import torques_along_log, write_table
    from gtau.uses.identify import read_log

    if force_only and frame is None:
        raise GtauError("--force-only applies to a contact frame; name it by --frame LINK, or omit --force-only.")
    if out is not None and out.exists() and log.exists() and out.samefile(log):
        raise GtauError(f"--out would replace the log {log}; give the table another name.")
    result = load(model)
    at = None
    if frame is not None:
        at = frame_on(result.robot.tool, frame, None if experiment is None else read_experiment(experiment).robot_file)
    with progress_bar() as progress:
        progress("torques along the log", 0, 1)
        run = read_log(result, log, experiment, payload=carries)
        torques = torques_along_log(result, run, at, force_only, observer)
    if out is not None:
        write_table(torques, out)
    document: dict[str, Any] = {
        "log": str(log),
        "out": None if out is None else str(out),
        "joints": [asdict(joint) for joint in torques.joints],
        "errors": list(map(torque_error, torques.errors)),
    }
    if (wrench := torques.wrench) is not None:
        document["wrench"] = {"frame": wrench.frame, "components": list(map(asdict, wrench.components))}
    if found := torques.observed:
        document["observed"] = {joint: {"largest": size, "time": time} for joint, (size, time) in found.items()}
    document["notes"] = notes = _remarks(result, log, carries, found)
    answer(json_, lambda: document, lambda: external_page(torques), [] if out is None else [out])
    _show_notes([] if json_ else notes)


def _remarks(result: IdentifiedModel, log: Path, carried: str | None, observed: dict[str, Any]) -> list[str]:
    from gtau.signals.reading.drafting import alternatives
    from gtau.signals.reading.statements import masses_in_name
    from gtau.uses.prediction import doubts

    notes = doubts(result)
    if sizes := ", ".join(f"{joint} {size:.3g} at {time:.4g} s" for joint, (size, time) in observed.items()):
        notes.append(f"largest torques by the observer, N m or N: {sizes}; --out writes all samples")
    if carried is None and (masses := masses_in_name(log.name)) and (known := ", ".join(result.payload_values)):
        notes.append(f"the name of the log says {alternatives(masses)} kg, but nothing is carried: --carries {known}?")
    return notes
