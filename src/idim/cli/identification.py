"""Commands from logs to results: identify, compare, validate, payload."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from idim.cli.console import ExperimentFile, Json, ModelFile, folder_of, print_json, progress_bar, refusals
from idim.errors import IdimError


class Method(StrEnum):
    """Estimators of ``idim identify``."""

    ml = "ml"
    huber = "huber"
    ridge = "ridge"
    two_stage = "2sls"
    mixed = "mixed"
    tls = "tls"
    wls = "wls"
    ols = "ols"


class Gains(StrEnum):
    """Which drive gains to weigh with."""

    identified = "identified"
    prior = "prior"


def identify(
    experiment: ExperimentFile,
    out: Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Folder for model.json.")] = None,
    method: Annotated[Method, typer.Option(help="Estimator; wls and ols take the file's prior_gains.")] = Method.ml,
    ratio: Annotated[
        float | None,
        typer.Option(
            min=1.0,
            help="The paper's r_sigma (10 to 30) for the essential parameters; default: BIC.",
        ),
    ] = None,
    as_paper: Annotated[
        bool,
        typer.Option(
            "--as-paper", help="Follow the paper step by step: its filter, friction and reduction, no delays."
        ),
    ] = False,
    consistent: Annotated[
        bool, typer.Option("--consistent", help="Also find standard parameters that rigid bodies can have.")
    ] = False,
    json_: Json = False,
) -> None:
    """Identify drive gains and dynamic parameters, and write DIR/model.json."""
    with refusals():
        from idim.estimation.identify import identify as run
        from idim.estimation.model_file import to_document

        with progress_bar() as progress:
            result = run(
                experiment,
                method=method.value,
                ratio=ratio,
                as_paper=as_paper,
                consistent=consistent,
                progress=progress,
            )
        if out is not None:
            result.save(folder_of(out) / "model.json")
        if json_:
            print_json(to_document(result))
        else:
            typer.echo(result.summary())
            if out is not None:
                typer.echo(f"written: {out / 'model.json'}")


def compare(experiment: ExperimentFile, json_: Json = False) -> None:
    """Identify with every estimator, and compare gains, deviations, residuals and verdicts."""
    with refusals():
        from idim.estimation.comparison import compare as run
        from idim.estimation.comparison import table, to_document

        with progress_bar() as progress:
            found = run(experiment, progress)
        if json_:
            print_json(to_document(found))
        else:
            typer.echo(table(found))


def validate(model: ModelFile, experiment: ExperimentFile, json_: Json = False) -> None:
    """Torque errors of a model on the validation runs of an experiment."""
    with refusals():
        from idim.estimation.data import experiment_of, read_runs
        from idim.estimation.result import Result

        result = Result.load(model)
        described = experiment_of(result, experiment)
        if not described.validation:
            raise IdimError(f"{experiment} has no validation runs; list them under 'validation'.")
        with progress_bar() as progress:
            runs = read_runs(described, described.validation)
            errors = []
            for k, run in enumerate(runs):
                progress("validation", k, len(runs))
                errors.append((run.name, result.validate(run)))
        if json_:
            print_json(
                {
                    "runs": [
                        {
                            "log": name,
                            "joints": [
                                {
                                    "joint": e.joint,
                                    "rms": e.rms,
                                    "signal": e.signal,
                                    "relative": e.relative,
                                    "unit": e.unit,
                                }
                                for e in found
                            ],
                        }
                        for name, found in errors
                    ]
                }
            )
            return
        for name, found in errors:
            typer.echo(f"{name}\n  {'joint':<22}{'error rms':>12}{'signal rms':>12}{'error %':>9}   unit")
            for e in found:
                typer.echo(f"  {e.joint:<22}{e.rms:>12.4g}{e.signal:>12.4g}{e.relative:>9.2f}   {e.unit}")
        typer.echo(
            "A small error does not prove the gains: both sides carry them. Weigh a known payload ('idim "
            "payload') for that."
        )


def payload(
    model: ModelFile,
    experiment: ExperimentFile,
    gains: Annotated[Gains, typer.Option(help="The model's gains, or the file's prior_gains.")] = Gains.identified,
    json_: Json = False,
) -> None:
    """Weigh the unknown payloads of an experiment's loaded runs."""
    with refusals():
        from idim.estimation.model_file import payload_documents
        from idim.estimation.payload import weigh
        from idim.estimation.result import Result
        from idim.estimation.summary import payload_lines

        with progress_bar() as progress:
            found = weigh(Result.load(model), experiment, gains.value, progress)
        if json_:
            print_json({"payloads": payload_documents(found), "gains": gains.value})
            return
        for each in found:
            typer.echo("\n".join(payload_lines(each)))
        typer.echo(f"weighed with the {gains.value} drive gains")
