"""Commands from logs to results: identify, compare, validate, payload."""

from __future__ import annotations

import textwrap
from enum import StrEnum
from pathlib import Path
from time import perf_counter
from typing import Annotated

import typer

from gtau.cli.console import ExperimentFile, Json, ModelFile, ReportFolder, print_json, progress_bar, refusals
from gtau.documents.files import folder_of, refuse_as_folder, write_atomically
from gtau.errors import GtauError
from gtau.estimation.estimators.registry import NAMES

METHODS = "|".join(NAMES)


class Gains(StrEnum):
    """Drive gains with which a payload is weighed."""

    identified = "identified"
    prior = "prior"


def identify(
    experiment: ExperimentFile,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Folder for report.html, model.json, summary.txt and singularities."),
    ] = None,
    method: Annotated[
        str | None,
        typer.Option(
            metavar=METHODS,
            help="Estimator; wls and ols take the file's prior_gains. Default: ml; tls with --as-paper; "
            "wls where the logs hold torques.",
            show_default=False,
        ),
    ] = None,
    ratio: Annotated[
        float | None,
        typer.Option(
            min=1.0,
            metavar="RATIO",
            help="The paper's ratio r_sigma (10 to 30) for selecting essential parameters; default: BIC.",
        ),
    ] = None,
    as_paper: Annotated[
        bool,
        typer.Option(
            "--as-paper",
            help="Follow the paper step by step: its TLS (or wls, ols), filter, friction and reduction; no delays.",
        ),
    ] = False,
    consistent: Annotated[
        bool, typer.Option("--consistent", help="Also find physically consistent standard parameters.")
    ] = False,
    accuracy: Annotated[
        float,
        typer.Option(
            min=0.01,
            max=50.0,
            metavar="PERCENT",
            help="A drive gain is good where its 95 % interval is within +- PERCENT of it.",
        ),
    ] = 3.0,
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="Print all parameters, the fit of each joint and all notes.")
    ] = False,
    json_: Json = False,
) -> None:
    """Identify drive gains and dynamic parameters, and write DIR/model.json.

    The exit code is 3 if every drive gain is contradictory or not identifiable.
    """
    with refusals(json_):
        refuse_as_folder(out)
        start = perf_counter()
        with progress_bar() as progress:
            from gtau.estimation.identify import identify as run
            from gtau.estimation.results.model_document import to_document

            result = run(
                experiment,
                method=method,
                ratio=ratio,
                as_paper=as_paper,
                consistent=consistent,
                accuracy=accuracy / 100,
                progress=progress,
            )
        written = []
        if out is not None:
            from gtau.estimation.results.singularity_distances import write_distances
            from gtau.report.write_reports import write_identification

            written = [folder_of(out) / name for name in ("model.json", "summary.txt", "singularities.parquet")]
            result.save(written[0])
            write_atomically(written[1], result.summary(True) + "\n")
            write_distances(result.distances, written[2])
            with progress_bar() as progress:
                report = write_identification(result, experiment, out, perf_counter() - start, progress)
            written.insert(0, report)
        if json_:
            print_json(to_document(result))
        else:
            typer.echo("\n".join([result.summary(verbose), *(f"written: {path}" for path in written)]))
        outcomes = {gain.verdict.outcome.value for gain in result.drive_gains.values()}
        if outcomes.isdisjoint(("given", "good", "weak")):
            raise typer.Exit(3)  # so that a script does not go on with such a model


def compare(experiment: ExperimentFile, out: ReportFolder = None, json_: Json = False) -> None:
    """Identify with every estimator; compare gains, standard deviations, residuals and verdicts."""
    with refusals(json_):
        refuse_as_folder(out)
        start = perf_counter()
        with progress_bar() as progress:
            from gtau.estimation.compare import compare as run
            from gtau.estimation.compare import table, to_document

            found = run(experiment, progress)
        written = []
        if out is not None:
            from gtau.report.write_reports import write_comparison

            written.append(write_comparison(found, experiment, folder_of(out), perf_counter() - start))
        if json_:
            print_json(to_document(found))
        else:
            typer.echo("\n".join([table(found), *(f"written: {path}" for path in written)]))


def validate(
    model: ModelFile,
    experiment: ExperimentFile,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Folder for report.html and a figure of each run.")
    ] = None,
    json_: Json = False,
) -> None:
    """Compare measured torques with those of a model on the validation runs; with DIR also as figures."""
    with refusals(json_):
        refuse_as_folder(out)
        start = perf_counter()
        with progress_bar() as progress:
            from gtau.estimation.experiment_runs import experiment_of, read_runs
            from gtau.estimation.results.remarks import without_temperature
            from gtau.estimation.results.result import Result
            from gtau.report.validation_page import describe_validations, validate_run, validation_page, write_torques

            result = Result.load(model)
            described = experiment_of(result, experiment)
            if not described.validation:
                raise GtauError(f"{experiment} has no validation runs; list them under 'validation'.")
            runs = read_runs(described, described.validation, progress)
            validations = []
            for k, run in enumerate(runs):
                progress("predicting torques", k, len(runs))
                validations.append(validate_run(result, run))
        written: list[Path] = []
        notes = [
            textwrap.fill(f"- {note}", 80, subsequent_indent="  ")
            for note in without_temperature(result, described.signals)
        ]
        if out is not None:
            from gtau.report.style import skipped_figures
            from gtau.report.write_reports import write_validation

            seconds = perf_counter() - start
            written.append(write_validation(result, validations, model, experiment, folder_of(out), seconds))
            written += write_torques(validations, out)
            notes += skipped_figures()
        document = describe_validations(validations)
        if json_:
            print_json(document)
        else:
            typer.echo("\n".join([validation_page(document), *(f"written: {path}" for path in written), *notes]))


def payload(
    model: ModelFile,
    experiment: ExperimentFile,
    gains: Annotated[
        Gains, typer.Option(metavar="identified|prior", help="The model's gains, or the file's prior_gains.")
    ] = Gains.identified,
    out: ReportFolder = None,
    json_: Json = False,
) -> None:
    """Weigh unknown payloads from loaded runs and a run without payload."""
    with refusals(json_):
        refuse_as_folder(out)
        start = perf_counter()
        with progress_bar() as progress:
            from gtau.estimation.results.model_document import payload_documents
            from gtau.estimation.results.result import Result
            from gtau.estimation.results.summary import payload_lines
            from gtau.estimation.weigh import weigh

            result = Result.load(model)
            found = weigh(result, experiment, gains.value, progress)
        written = []
        if out is not None:
            from gtau.report.write_reports import write_weighing

            seconds = perf_counter() - start
            written.append(write_weighing(result, found, gains.value, model, experiment, folder_of(out), seconds))
        if json_:
            print_json({"payloads": payload_documents(found), "gains": gains.value})
            return
        for each in found:
            typer.echo("\n".join(payload_lines(each)))
        typer.echo(
            "\n".join([f"weighed with the {gains.value} drive gains", *(f"written: {path}" for path in written)])
        )
