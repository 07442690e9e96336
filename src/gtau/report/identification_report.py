"""The report of an identification: what was found, whether to believe it, and where it comes from."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from gtau.documents.files import write_atomically
from gtau.estimation.results.summary import METHODS
from gtau.report import provenance
from gtau.report.evidence import Evidence
from gtau.report.html.document import Page, Section, render
from gtau.report.html.series import Arrays
from gtau.report.provenance import Provenance
from gtau.report.result_sections import (
    alternatives_section,
    correlation_section,
    gains_section,
    notes_section,
    parameters_section,
    payloads_section,
    singular_values_section,
    verdict_section,
)
from gtau.report.run_sections import logs_section, motion_section, residuals_section, torques_section

REPORT = "report.html"


def identification_report(evidence: Evidence, of: Provenance) -> str:
    """Render the report of an identification as the text of one HTML file."""
    result, arrays = evidence.result, Arrays()
    preparation = result.preparation
    sections = (
        verdict_section(evidence),
        gains_section(evidence),
        payloads_section([each for each in result.payloads if set(each.parameters) - each.known]),
        torques_section(evidence, arrays),
        residuals_section(evidence),
        parameters_section(result),
        correlation_section(evidence),
        singular_values_section(evidence),
        motion_section(evidence, arrays),
        logs_section([each.run for each in evidence.runs], result.robot, preparation.bandwidth, preparation.cutoff),
        alternatives_section(evidence),
        notes_section(result.notes),
        provenance.section(of),
    )
    return page(
        f"Identification of {result.robot.name}",
        [f"Estimator: {METHODS.get(result.method, result.method)}. Runs: {', '.join(result.runs)}."],
        sections,
        arrays,
    )


def settings_of(evidence: Evidence) -> Mapping[str, str]:
    """Settings of an identification by name."""
    preparation = evidence.result.preparation
    cutoff = preparation.cutoff
    return {
        "estimator": evidence.result.method,
        "bandwidth of the motion": f"{preparation.bandwidth:.4g} Hz",
        "position filter": "none" if cutoff is None else f"{cutoff:.4g} Hz",
        "decimation": f"{preparation.decimator.factor} ({preparation.decimator.kind})",
        "rows masked below": f"{100 * preparation.speed_fraction:g} % of the rms speed",
        **{name.replace("_", " "): f"{value:.4g}" for name, value in evidence.result.statistics.items()},
    }


def page(title: str, lead: list[str], sections: tuple[Section | None, ...], arrays: Arrays) -> str:
    """Render the sections that are there, below a title."""
    footer = "Written by gtau. One file without links to the network: it can be sent, archived and printed as it is."
    return render(Page(title, lead, [each for each in sections if each is not None], arrays, footer))


def write_report(text: str, folder: Path) -> Path:
    """Write a report to ``report.html`` in a folder, atomically."""
    path = folder / REPORT
    write_atomically(path, text)
    return path
