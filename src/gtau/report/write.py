"""Write ``report.html``: a page, what it was made from, and how long that took."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from gtau.documents.files import write_atomically
from gtau.estimation.experiment_runs import read_runs
from gtau.estimation.results.result import Result
from gtau.progress import Progress, silent
from gtau.report.evidence import gather, settings_of
from gtau.report.identification import report_page
from gtau.report.page import Page
from gtau.report.provenance import Provenance, command_line, stamped
from gtau.report.render.html import html
from gtau.signals.experiment import Experiment, read_experiment

Inputs = tuple[tuple[str, Path], ...]
REPORT = "report.html"


def write_report(
    page: Page, folder: Path, seconds: float, inputs: Inputs = (), settings: Mapping[str, str] | None = None
) -> Path:
    """Write a page to a folder, with the command that runs now, its ``inputs`` and ``settings``, and its time, s."""
    of = Provenance(command_line(), inputs, settings or {}, seconds)
    path = folder / REPORT
    write_atomically(path, html(stamped(page, of)))
    return path


def write_identification(result: Result, path: Path, folder: Path, seconds: float, progress: Progress = silent) -> Path:
    """Write the report of an identification from the experiment file at ``path``, which took ``seconds``.

    The runs kept for validation are read and predicted too; one that cannot be is listed with the reason.
    """
    experiment = read_experiment(path)
    validation = read_runs(experiment, experiment.validation, progress)
    page = report_page(result, gather(result, result.data, validation, progress), experiment.expected_gains)
    return write_report(page, folder, seconds, inputs_of(path, experiment), settings_of(result))


def inputs_of(path: Path, experiment: Experiment | None = None, runs: bool = True) -> Inputs:
    """List an experiment file, the robot file and the logs that it names, those of the ``runs`` only where wanted."""
    experiment = experiment or read_experiment(path)
    source = experiment.robot
    robot = Path(source if isinstance(source, str) else source.file)
    listed: Sequence = (*(experiment.runs if runs else ()), *experiment.validation)
    logs = tuple(("log", log) for run in listed for log in run.log)
    return (("experiment", path), *((("robot", robot),) if robot.exists() else ()), *logs)
