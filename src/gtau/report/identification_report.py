"""The report of an identification: what was found, whether to believe it, and where it comes from."""

from __future__ import annotations

from gtau.estimation.estimators.registry import ESTIMATORS
from gtau.estimation.results.remarks import findings
from gtau.report import provenance
from gtau.report.evidence import Evidence
from gtau.report.findings_section import notes_section
from gtau.report.gain_sections import gains_section, payloads_section, verdict_section
from gtau.report.geometry_section import geometry_section
from gtau.report.html.document import Page, Section, render
from gtau.report.html.series import Arrays
from gtau.report.log_section import logs_section
from gtau.report.motion_section import motion_section
from gtau.report.parameter_sections import (
    alternatives_section,
    correlation_section,
    parameters_section,
    singular_values_section,
)
from gtau.report.provenance import Provenance
from gtau.report.residual_section import residuals_section
from gtau.report.torque_sections import torques_section


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
        geometry_section(result.geometry, arrays),
        logs_section([each.run for each in evidence.runs], result.robot, preparation.bandwidth, preparation.cutoff),
        alternatives_section(evidence),
        notes_section(findings(result)),
        provenance.section(of),
    )
    return page(
        f"Identification of {result.robot.name}",
        [f"Estimator: {ESTIMATORS[result.method].description}. Runs: {', '.join(result.runs)}."],
        sections,
        arrays,
    )


def page(title: str, lead: list[str], sections: tuple[Section | None, ...], arrays: Arrays) -> str:
    """Render the sections that are there, below a title."""
    footer = "Written by gtau. One file without links to the network: it can be sent, archived and printed as it is."
    return render(Page(title, lead, [each for each in sections if each is not None], arrays, footer))
