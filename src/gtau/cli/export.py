"""Commands that export and use a model."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gtau.cli.console import CarriedPayload, Columns, Json, ModelFile, print_json, progress_bar, refusals
from gtau.errors import GtauError

if TYPE_CHECKING:
    from gtau.estimation.results.result import Result
    from gtau.robots.robot import Placement

# those of the registry, which --help need not import
KINDS = "c, mjcf, mujoco-actuators, mjlab, isaaclab, urdf, yaml, csv, latex, orders, matlab, fmu"


def export(
    model: ModelFile,
    to: Annotated[str, typer.Option("--to", metavar="KIND", help=f"What to write: {KINDS}.")],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for the files.")],
    into: Annotated[
        Path | None,
        typer.Option(
            "--into", metavar="FILE", help="Robot file (URDF or MJCF) to copy with the identified parameters inserted."
        ),
    ] = None,
    samples: Annotated[
        int,
        typer.Option(
            "--samples",
            min=0,
            metavar="N",
            help="Also draw N models from the identified distribution, for domain randomization: samples.npz.",
        ),
    ] = 0,
    models: Annotated[
        int, typer.Option("--models", min=0, metavar="N", help="Number of draws also written as models.")
    ] = 16,
    seed: Annotated[int, typer.Option("--seed", min=0, metavar="SEED", help="Seed of the draws.")] = 0,
    json_: Json = False,
) -> None:
    """Export a model for controllers, simulators, papers and other programs."""
    with refusals(json_):
        from gtau.export.registry import export_model

        with progress_bar() as progress:
            progress("export", 0, 1)
            exported = export_model(model, to, out, into, samples, models, seed)
            progress("export", 1, 1)
        if json_:
            files = [str(path) for path in exported.files]
            print_json({"kind": to, "files": files, "notes": list(exported.notes), "figures": dict(exported.figures)})
        else:
            lines = [f"written: {path}" for path in exported.files]
            notes = (textwrap.fill(f"- {each}", 80, subsequent_indent="  ") for each in exported.notes)
            typer.echo("\n".join([*lines, *notes]))


def use(
    model: ModelFile,
    log: Annotated[Path, typer.Argument(metavar="LOG", help="Log of a run: CSV, Parquet.", show_default=False)],
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="Table to write: .csv or .parquet, one row per sample.")
    ] = None,
    experiment: Columns = None,
    payload: CarriedPayload = None,
    frame: Annotated[
        str | None,
        typer.Option(
            "--frame",
            metavar="LINK|POSE",
            help="Also compute the external force and moment at a link of the experiment's URDF (tool0), or at 'x y z "
            "roll pitch yaw' (m, rad) from the frame of the body that carries the payload.",
        ),
    ] = None,
    force_only: Annotated[
        bool,
        typer.Option("--force-only", help="The contact exerts no moment about the origin of --frame, as a point does."),
    ] = False,
    observer: Annotated[
        float | None,
        typer.Option(
            "--observer", metavar="HZ", help="Also estimate external torques causally, by a momentum observer."
        ),
    ] = None,
    json_: Json = False,
) -> None:
    """Compute motor, model and external joint torques along a log, to see contacts and collisions.

    External torque is what the environment exerts on a joint: the model's torque minus the motor's, N m (or N). For
    each joint it prints the rms away from reversals and over all samples, the largest value and its time, the
    residual of the identification, and the share of samples beyond four residuals. With --frame it also prints the
    wrench of these torques with its intervals; components that a pose does not show have no value. LOG has the
    columns t, qJOINT and vJOINT (tauJOINT for a model of torques; s, rad or m, A), unless an experiment file names
    others. FILE gets motor, model and external torque of every sample.
    """
    with refusals(json_):
        from dataclasses import asdict

        from gtau.estimation.experiment_runs import carrying, read_log
        from gtau.estimation.results.result import Result
        from gtau.export.external_torques import summary_text, torques_along_log, write_table

        if force_only and frame is None:
            raise GtauError(
                "--force-only applies to a contact frame; name the frame by --frame LINK, or omit --force-only."
            )
        result = Result.load(model)
        at = None if frame is None else _frame(result, frame, experiment)
        with progress_bar() as progress:
            progress("torques along the log", 0, 1)
            run = read_log(result, log, experiment)
            run = run if payload is None else carrying(result, run, payload)
            found = torques_along_log(result, run, at, force_only, observer)
            progress("torques along the log", 1, 1)
        if out is not None:
            write_table(found, out)
        if json_:
            joints = [asdict(each) for each in found.joints]
            document: dict[str, Any] = {"log": str(log), "out": None if out is None else str(out), "joints": joints}
            if (wrench := found.wrench) is not None:
                document["wrench"] = {"frame": wrench.frame, "components": list(map(asdict, wrench.components))}
            print_json(document)
        else:
            typer.echo("\n".join([summary_text(found), *([] if out is None else [f"written: {out}"])]))


def _frame(result: Result, frame: str, experiment: Path | None) -> tuple[str, Placement]:
    """Find a frame on the body that carries the payload, as for 'gtau payload'."""
    from gtau.robots.readers.frames import frame_on
    from gtau.signals.experiment import read_experiment

    robot = None if experiment is None else read_experiment(experiment).robot
    return frame_on(result.robot.tool, frame, robot if robot is None or isinstance(robot, str) else robot.file)
