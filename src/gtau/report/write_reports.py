"""Write ``report.html`` for each command: the page, what it was made from, and how long that took."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from gtau.documents.files import write_atomically
from gtau.estimation.check_logs import ExperimentCheck
from gtau.estimation.compare import EstimatorComparison
from gtau.estimation.experiment_runs import read_runs
from gtau.estimation.results.estimate import PayloadEstimate
from gtau.estimation.results.result import Result
from gtau.excitation.design import Design
from gtau.fleet.gains import FleetTable
from gtau.model.home import load_robot
from gtau.progress import Progress, silent
from gtau.report.evidence import gather, settings_of
from gtau.report.page import Page
from gtau.report.provenance import Provenance, command_line, provenance_section
from gtau.report.validation_page import Validation
from gtau.robots.units import torque_unit
from gtau.signals.experiment import Experiment, read_experiment

REPORT = "report.html"


def write_identification(result: Result, path: Path, folder: Path, seconds: float, progress: Progress = silent) -> Path:
    """Write the report of an identification from the experiment file at ``path``, which took so many seconds.

    The runs kept for validation are read and predicted too; one that cannot be is listed with the reason.
    """
    from gtau.report.identification_report import identification_report

    experiment = read_experiment(path)
    validation = read_runs(experiment, experiment.validation, progress)
    evidence = gather(result, result.data, validation, experiment.expected_gains, progress)
    of = Provenance(command_line(), inputs_of(path, experiment), settings_of(result), seconds)
    return _write(identification_report(evidence, of), folder)


def write_validation(
    result: Result, validations: Sequence[Validation], model: Path, path: Path, folder: Path, seconds: float
) -> Path:
    """Write the report of a validation of the model file ``model`` on the experiment file at ``path``."""
    from gtau.report.validation_report import evidence_of, validation_report

    experiment = read_experiment(path)
    evidence = evidence_of(result, validations, experiment.expected_gains)
    inputs = (("model", model), *inputs_of(path, experiment, runs=False))
    notes = [f"Run '{each.run.name}': {note}." for each in validations for note in each.notes]
    of = Provenance(command_line(), inputs, settings_of(result), seconds)
    return _write(validation_report(evidence, of, notes), folder)


def write_weighing(
    result: Result,
    payloads: Sequence[PayloadEstimate],
    gains: str,
    model: Path,
    path: Path,
    folder: Path,
    seconds: float,
) -> Path:
    """Write the report of a weighing with the ``gains`` (identified or prior) of the model file ``model``."""
    from gtau.report.payload_report import payload_report

    experiment = read_experiment(path)
    inputs = (("model", model), *inputs_of(path, experiment))
    of = Provenance(command_line(), inputs, {**settings_of(result), "drive gains": gains}, seconds)
    return _write(payload_report(result, payloads, gains, experiment.expected_gains, of), folder)


def write_comparison(found: EstimatorComparison, path: Path, folder: Path, seconds: float) -> Path:
    """Write the report of a comparison of estimators on the experiment file at ``path``."""
    from gtau.report.comparison_report import comparison_report

    experiment = read_experiment(path)
    robot = load_robot(experiment.robot)
    units = {joint: f"{torque_unit(robot, joint)}/A" for joint in found.joints}
    of = Provenance(command_line(), inputs_of(path, experiment), {}, seconds)
    return _write(comparison_report(found, robot.name, units, experiment.expected_gains, of), folder)


def write_check_report(checked: ExperimentCheck, path: Path, folder: Path, seconds: float) -> Path:
    """Write the report of a check of the logs of the experiment file at ``path``."""
    from gtau.report.check import check_page

    of = Provenance(command_line(), inputs_of(path, read_experiment(path)), {}, seconds)
    return write_report(check_page(checked), of, folder)


def write_fleet_report(table: FleetTable, experiments: Sequence[Path], folder: Path, seconds: float) -> Path:
    """Write the report of a fleet identified from these experiment files."""
    from gtau.report.fleet_report import fleet_report

    inputs = tuple(("experiment", path) for path in experiments)
    return _write(fleet_report(table, Provenance(command_line(), inputs, {}, seconds)), folder)


def write_design_report(design: Design, document: dict[str, Any], path: Path, folder: Path, seconds: float) -> Path:
    """Write the report of a motion designed from the design file at ``path``."""
    from gtau.report.design_report import design_report

    of = Provenance(command_line(), (("design", path),), {}, seconds)
    return _write(design_report(design, document, of), folder)


def inputs_of(path: Path, experiment: Experiment, runs: bool = True) -> tuple[tuple[str, Path], ...]:
    """List an experiment file, the robot file and the logs that it names, those of the ``runs`` only where wanted."""
    source = experiment.robot
    robot = Path(source if isinstance(source, str) else source.file)
    listed = (*(experiment.runs if runs else ()), *experiment.validation)
    logs = tuple(("log", log) for run in listed for log in run.log)
    return (("experiment", path), *((("robot", robot),) if robot.exists() else ()), *logs)


def write_report(page: Page, of: Provenance, folder: Path) -> Path:
    """Write a page with its provenance as ``report.html``."""
    from gtau.report.render.html import html

    return _write(html(replace(page, sections=(*page.sections, provenance_section(of)))), folder)


def _write(text: str, folder: Path) -> Path:
    path = folder / REPORT
    write_atomically(path, text)
    return path
