"""Write a page as ``report.html``, with the command, hashes of input files, versions, settings and time taken."""

from __future__ import annotations

import hashlib
import logging
import platform
import shlex
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from gtau.documents.files import write_atomically
from gtau.estimation.results.result import IdentifiedModel
from gtau.progress import Progress, silent
from gtau.report.evidence import gather, settings_of
from gtau.report.identification import report_page
from gtau.report.page import Column, Facts, Kind, Page, Section, Table, Text
from gtau.report.render.html import html
from gtau.signals.reading.experiment import Experiment, read_experiment
from gtau.signals.run import Run

Inputs = tuple[tuple[str, Path], ...]
"""Files with their purpose."""
REPORT = "report.html"
PACKAGES = ("numpy", "scipy", "polars", "casadi", "numba", "clarabel", "mujoco")
LISTED = 12  # inputs; longer lists are folded
LARGEST = 1 << 31  # bytes; larger inputs are not hashed


def write_report(
    page: Page, folder: Path, seconds: float, inputs: Inputs = (), settings: Mapping[str, str] | None = None
) -> Path:
    """Write a page to a folder, with the current command, its ``inputs``, ``settings`` and ``seconds`` taken."""
    command = shlex.join(["gtau", *sys.argv[1:]])
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # services without a home get no warning about its cache
    write_atomically(folder / REPORT, html(stamped(page, settings or {}, command, inputs, seconds)))
    return folder / REPORT


def write_identification(
    result: IdentifiedModel,
    validation: Sequence[Run],
    path: Path,
    experiment: Experiment,
    folder: Path,
    seconds: float,
    progress: Progress = silent,
) -> Path:
    """Write the report of an identification of the ``experiment`` in ``path``, with its ``validation`` runs."""
    page = report_page(result, gather(result, result.data, validation, progress), experiment.expected_gains)
    return write_report(page, folder, seconds, inputs_of(path, experiment), settings_of(result))


def inputs_of(path: Path, experiment: Experiment | None = None, runs: bool = True) -> Inputs:
    """List an experiment file, its robot file and its logs; without ``runs`` only the validation logs."""
    experiment = experiment or read_experiment(path)
    source = experiment.robot
    robot = Path(source if isinstance(source, str) else source.file)
    listed: Sequence = (*(experiment.runs if runs else ()), *experiment.validation)
    logs = tuple(("log", log) for run in listed for log in run.log)
    return (("experiment", path), *((("robot", robot),) if robot.exists() else ()), *logs)


def stamped(
    page: Page, settings: Mapping[str, str], command: str = "", inputs: Inputs = (), seconds: float | None = None
) -> Page:
    """Add date and version below the title of a page, and at its end the section on provenance."""
    made = datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z")
    packages = {"gtau": version("gtau")}
    packages["Python"] = f"{platform.python_version()}, {platform.system()} {platform.machine()}"
    for package in PACKAGES:
        with suppress(PackageNotFoundError):
            packages[package] = version(package)
    facts = {"made on": made, "time taken": None if seconds is None else f"{seconds:.1f} s", **packages}
    files = Table(
        (Column("input"), Column("file"), Column("size"), Column("SHA-256", Kind.NAME)),
        [(what, str(path), *_fingerprint(path)) for what, path in inputs],
    )
    listed = f"Inputs: {len(inputs)} files with their hashes"
    provenance = Section(
        "Provenance",
        Section("The command that reproduces this report", Text(command, style="command")) if command else None,
        Facts(facts),
        Section("Settings", Facts(settings)) if settings else None,
        Section(listed, files, folded=len(inputs) > LISTED) if inputs else None,
        id="provenance",
        folded=True,
    )
    lead = (*page.lead, f"Made on {made} by gtau {packages['gtau']}.")
    return Page(page.title, *page.sections, provenance, lead=lead)


def _fingerprint(path: Path) -> tuple[str, str]:
    """Return size and SHA-256 of a file or of the files in a folder."""
    if path.is_dir():
        parts = sorted(part for part in path.iterdir() if part.is_file())
        return f"{len(parts)} files", _digest(parts)
    return (_size(path.stat().st_size), _digest([path])) if path.is_file() else ("–", "no longer exists")


def _digest(paths: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for path in paths:
        if path.stat().st_size > LARGEST:
            return f"not computed: larger than {_size(LARGEST)}"
        with path.open("rb") as file:
            while part := file.read(1 << 20):
                digest.update(part)
    return digest.hexdigest()


def _size(size: float) -> str:
    for unit in ("B", "kB", "MB"):
        if size < 1000:
            return f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:.3g} GB"
