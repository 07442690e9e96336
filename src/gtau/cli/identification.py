"""Commands from logs to results: identify, compare, validate, payload."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from gtau.cli.console import Dask, ExperimentFile, Json, ModelFile, print_json, progress_bar, refusals
from gtau.documents.files import folder_of
from gtau.errors import GtauError


class Method(StrEnum):
    """Estimators of ``gtau identify``."""

    ml = "ml"
    huber = "huber"
    ridge = "ridge"
    iv = "iv"
    didim = "didim"
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
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Folder for model.json and singularities.parquet.")
    ] = None,
    method: Annotated[
        Method | None,
        typer.Option(
            help="Estimator; wls and ols take the file's prior_gains. Default: ml, tls with --as-paper, "
            "wls where logs hold torques.",
            show_default=False,
        ),
    ] = None,
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
            "--as-paper",
            help="Follow the paper step by step: its TLS (or wls, ols), filter, friction and reduction, no delays.",
        ),
    ] = False,
    consistent: Annotated[
        bool, typer.Option("--consistent", help="Also find standard parameters that rigid bodies can have.")
    ] = False,
    dask: Dask = None,
    no_cache: Annotated[
        bool, typer.Option("--no-cache", help="Reduce long logs anew, and keep nothing of it for the next time.")
    ] = False,
    json_: Json = False,
) -> None:
    """Identify drive gains and dynamic parameters, and write DIR/model.json.

    The exit code is 3 where no drive gain can be believed: all are contradictory or not identifiable.
    """
    with refusals(json_):
        from gtau.estimation.identify import identify as run
        from gtau.estimation.results.model_file import to_document
        from gtau.parallel.cache import cache_folder, caching_map
        from gtau.parallel.dask_executor import shard_map_at
        from gtau.parallel.executor import in_order

        with progress_bar() as progress, shard_map_at(dask) as shard_map:
            result = run(
                experiment,
                method=None if method is None else method.value,
                ratio=ratio,
                as_paper=as_paper,
                consistent=consistent,
                progress=progress,
                mapper=in_order(shard_map if no_cache else caching_map(shard_map, cache_folder())),
            )
        if out is not None:
            from gtau.estimation.results.singularity_distances import write_distances

            result.save(folder_of(out) / "model.json")
            write_distances(result.distances, out / "singularities.parquet")
        if json_:
            print_json(to_document(result))
        else:
            typer.echo(result.summary())
            if out is not None:
                typer.echo(f"written: {out / 'model.json'}\nwritten: {out / 'singularities.parquet'}")
        outcomes = {gain.verdict.outcome.value for gain in result.drive_gains.values()}
        if outcomes.isdisjoint(("given", "good", "weak")):
            raise typer.Exit(3)  # a script is not to go on with such a model


def compare(experiment: ExperimentFile, json_: Json = False) -> None:
    """Identify with every estimator, and compare gains, deviations, residuals and verdicts."""
    with refusals(json_):
        from gtau.estimation.compare import compare as run
        from gtau.estimation.compare import table, to_document

        with progress_bar() as progress:
            found = run(experiment, progress)
        if json_:
            print_json(to_document(found))
        else:
            typer.echo(table(found))


def validate(
    model: ModelFile,
    experiment: ExperimentFile,
    out: Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Folder for a figure of each run.")] = None,
    json_: Json = False,
) -> None:
    """Torque errors of a model on the validation runs of an experiment; with DIR also figures."""
    with refusals(json_):
        from gtau.estimation.experiment_runs import experiment_of, read_runs
        from gtau.estimation.results.result import Result
        from gtau.report.validation_page import describe_validations, validate_run, validation_page, write_torques

        result = Result.load(model)
        described = experiment_of(result, experiment)
        if not described.validation:
            raise GtauError(f"{experiment} has no validation runs; list them under 'validation'.")
        with progress_bar() as progress:
            runs = read_runs(described, described.validation, progress)
            validations = []
            for k, run in enumerate(runs):
                progress("validation", k, len(runs))
                validations.append(validate_run(result, run))
        written = [] if out is None else write_torques(validations, folder_of(out))
        document = describe_validations(validations)
        if json_:
            print_json(document)
        else:
            typer.echo("\n".join([validation_page(document), *(f"written: {path}" for path in written)]))


def payload(
    model: ModelFile,
    experiment: ExperimentFile,
    gains: Annotated[Gains, typer.Option(help="The model's gains, or the file's prior_gains.")] = Gains.identified,
    json_: Json = False,
) -> None:
    """Weigh the unknown payloads of an experiment's loaded runs, beside a run without payload."""
    with refusals(json_):
        from gtau.estimation.results.model_file import payload_documents
        from gtau.estimation.results.result import Result
        from gtau.estimation.results.summary import payload_lines
        from gtau.estimation.weigh import weigh

        with progress_bar() as progress:
            found = weigh(Result.load(model), experiment, gains.value, progress)
        if json_:
            print_json({"payloads": payload_documents(found), "gains": gains.value})
            return
        for each in found:
            typer.echo("\n".join(payload_lines(each)))
        typer.echo(f"weighed with the {gains.value} drive gains")
