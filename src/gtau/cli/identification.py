"""Commands from logs to models: identify, compare, fleet, campaign."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gtau.cli.console import METHOD, Json, ReportFolder, answer, argument, hold, option, progress_bar, refusing, seconds
from gtau.cli.interruption import stop_request
from gtau.cli.logs import LogOptions, Sources, experiment_of, said_if_refused
from gtau.documents.files import folder_of, write_atomically

if TYPE_CHECKING:
    from gtau.estimation.results.result import IdentifiedModel

EXIT = {"play": 0, "done": 0, "stopped": 3, "blocked": 3}


def percent(text: str | float) -> float:
    """Read ``--accuracy``, with or without the per cent sign."""
    with suppress(ValueError):
        if 0.01 <= (value := float(str(text).removesuffix("%"))) <= 50.0:
            return value
    raise typer.BadParameter(f"'{text}' is not an accuracy; write a number of per cent from 0.01 to 50.")


@dataclass(frozen=True)
class EstimationOptions:
    """What is asked of an identification."""

    method: Annotated[
        str | None,
        option(
            METHOD,
            "Estimator ('gtau docs verdicts'). Default: ml; tls with --as-paper; wls for torques that nothing tests.",
        ),
    ] = None
    ratio: Annotated[
        float | None, option("RATIO", "The paper's ratio for essential parameters, 10 to 30; default: BIC.", min=1.0)
    ] = None
    as_paper: Annotated[
        bool,
        option("", "Follow the paper: its TLS (or wls, ols), filter, friction, reduction; no delays.", "--as-paper"),
    ] = False
    consistent: Annotated[bool, option("", "Also find physically consistent parameters.", "--consistent")] = False
    prior_inertias: Annotated[
        float | None,
        option(
            "STD",
            "Use the robot file's inertias as priors of this relative standard deviation, 0.3 for 30 %; they set the "
            "scale where nothing else does.",
        ),
    ] = None
    accuracy: Annotated[
        float,
        option("PERCENT", "A gain is good if its 95 % interval is within +- PERCENT, 0.01 to 50.", parser=percent),
    ] = 3.0


@refusing
def identify(
    sources: Sources,
    stated: LogOptions,
    out: Annotated[Path, option("DIR", "Folder for report.html, model.json and others.")] = Path("result"),
    *,
    estimation: EstimationOptions,
    verbose: Annotated[
        bool, option("", "Print all parameters, the fit of each joint and all notes.", "--verbose", "-v")
    ] = False,
    json_: Json = False,
) -> None:
    """Identify drive gains and dynamic parameters, and write DIR/model.json.

    From logs it drafts DIR/experiment.yaml, and lists its guesses: correct them by options, or in the draft.

    Exit code 3: a verdict is contradictory, no gain is identifiable, --consistent finds no parameters, or a
    requirement is not met.
    """
    hold(out)
    experiment, guessed = experiment_of(sources, stated, out)
    with said_if_refused(guessed), progress_bar() as progress:
        from gtau.signals.reading.experiment import read_experiment

        described = read_experiment(experiment)  # a file that cannot be read is refused at once
        from gtau.estimation.experiment_runs import Options, read, read_validation
        from gtau.estimation.results.model_file import to_document
        from gtau.report.identification import full_page, summary_page, write_identification
        from gtau.uses.identify import identify_subject, with_requirements

        options = Options(**vars(estimation) | {"accuracy": estimation.accuracy / 100})
        result = identify_subject(read(described, None, options, progress), progress)
        validation, unread = read_validation(described, progress)
    result = result.replaced(notes=(*guessed, *result.notes, *unread))
    result = with_requirements(result, described, (validation, unread))
    written = _write(result, out)
    with progress_bar() as progress:
        report = write_identification(result, validation, experiment, described, out, seconds(), progress)
    written = [*([experiment] if guessed else []), report, *written]
    answer(json_, lambda: to_document(result), lambda: (full_page if verbose else summary_page)(result), written)
    if not result.accepted:
        raise typer.Exit(3)  # so that scripts do not continue with this model


def _write(result: IdentifiedModel, out: Path) -> list[Path]:
    from gtau.estimation.results.conclusions import torque_scale_text, torque_scales
    from gtau.estimation.results.model_file import save
    from gtau.report.identification import text

    written = [folder_of(out) / name for name in ("model.json", "summary.txt")]
    save(result, written[0])
    write_atomically(written[1], text(result, verbose=True) + "\n")
    if torque_scales(result) and result.believable:
        written.append(out / "torque_scale.yaml")
        write_atomically(written[-1], torque_scale_text(result))
    return written


@refusing
def compare(sources: Sources, stated: LogOptions, out: ReportFolder = None, json_: Json = False) -> None:
    """Identify with every estimator; compare gains, standard deviations, residuals and verdicts.

    From logs it drafts DIR/experiment.yaml, or result/experiment.yaml.
    """
    hold(out)
    experiment, guessed = experiment_of(sources, stated, out)
    with said_if_refused(guessed), progress_bar() as progress:
        from gtau.estimation.identify import compare as run, comparison_document
        from gtau.report.gains import comparison_page
        from gtau.report.html import write_report
        from gtau.report.logs import inputs_of
        from gtau.signals.reading.experiment import read_experiment

        comparison = replace(run(experiment, progress=progress), notes=guessed)
    described = read_experiment(experiment)
    page, written = comparison_page(comparison, described.expected_gains), [experiment] if guessed else []
    if out is not None:
        written.append(write_report(page, folder_of(out), seconds(), inputs_of(experiment, described)))
    answer(json_, lambda: comparison_document(comparison), lambda: page, written)


Experiments = Annotated[
    list[str], argument("EXPERIMENT.yaml|FLEET.yaml", "Experiment files or patterns, or a fleet file.")
]


@refusing
def fleet(
    experiments: Experiments,
    out: Annotated[Path, option("DIR", "Folder for report.html, models and table.")] = Path("fleet"),
    method: Annotated[str, option(METHOD, "Estimator of drive gains.")] = "ml",
    jobs: Annotated[int | None, option("N", "Processes; default: one for each core.", min=1)] = None,
    dask: Annotated[str | None, option("ADDRESS", "Dask scheduler (tcp://host:8786), or 'local'.")] = None,
    json_: Json = False,
) -> None:
    """Identify many robots, and mark drive gains that are outliers.

    Run it again to identify only missing or changed robots.
    """
    hold(out)
    from gtau.fleets.fleet import fleet as run, read_fleet
    from gtau.fleets.table import fleet_document, fleet_page, write_fleet
    from gtau.report.html import write_report

    try:
        with progress_bar() as progress:
            table = run(experiments, out, method, jobs, dask, progress)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"finished robots stay in {out / 'models'}, and the same command continues with the others"
        ) from None
    files = tuple(("experiment", member.experiment) for member in read_fleet(experiments))
    report = write_report(fleet_page(table, full=True), out, seconds(), files)
    written = (report, *write_fleet(table, out))
    answer(json_, lambda: fleet_document(table), lambda: fleet_page(table), written)
    if not table.robots:
        raise typer.Exit(3)  # so that scripts do not continue with this fleet


@refusing
def campaign(
    folder: Annotated[Path, argument("DIR", "Folder of the campaign, its only state.")],
    robot: Annotated[str | None, option("ROBOT", "Robot of a new campaign.")] = None,
    payload_mass: Annotated[float | None, option("KG", "Payload of a new campaign.", min=0.0)] = None,
    accuracy: Annotated[
        float | None, option("PERCENT", "Half of the 95 % interval required of every gain, default 3.")
    ] = None,
    json_: Json = False,
) -> None:
    """Identify the robot from the motions played; then say what is next: nothing, a motion, or why none would help.

    Run it again to resume. Exit code 3: the campaign cannot go on.
    """
    hold(folder)
    with progress_bar() as progress:
        from gtau.campaigns.campaign import campaign as run
        from gtau.campaigns.page import campaign_page
        from gtau.report.html import write_report

        state = run(folder, robot, payload_mass, accuracy, progress, partial(stop_request, ""))
        report = write_report(campaign_page(state), folder, seconds())
    answer(json_, lambda: state.document, lambda: campaign_page(state), [report])
    if code := EXIT[state.next]:
        raise typer.Exit(code)
